#include "io/group_list.h"

#include "util/nearest_name.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns {

namespace {

std::string trimmed(const std::string& text)
{
    const std::size_t first = text.find_first_not_of(" \t");
    if (first == std::string::npos) return {};
    return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

} // namespace

GroupList parseGroupList(const std::string& list, const std::vector<std::string>& groups,
                         const std::string& file)
{
    GroupList result;
    for (std::size_t begin = 0; begin <= list.size();) {
        const std::size_t end = std::min(list.find(',', begin), list.size());
        std::string name = trimmed(list.substr(begin, end - begin));
        begin = end + 1;
        const bool isLeftOut = !name.empty() && name[0] == '^';
        if (isLeftOut) name = trimmed(name.substr(1));
        if (name.empty()) {
            throw InvalidInput(file + ": the groups '" + shownText(list) +
                               "' have an empty name; give names with commas between, and a ^ before those "
                               "to be left out, e.g. fluid,^boundary");
        }
        if (std::find(groups.begin(), groups.end(), name) == groups.end()) {
            throw InvalidInput(file + ": has no point group '" + shownText(name) + "'" +
                               insteadText(name, groups, "groups"));
        }
        (isLeftOut ? result.leftOut : result.wanted).push_back(name);
    }
    return result;
}

} // namespace vdb_nns
