#include "util/nearest_name.h"

#include "util/shown_text.h"

#include <algorithm>
#include <cstddef>

namespace vdb_nns {

namespace {

constexpr std::size_t kMostListed = 40;

// Letters to be changed, left out, put in or exchanged with the next one until a word is another.
std::size_t editDistance(const std::string& a, const std::string& b)
{
    std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
    for (std::size_t i = 0; i <= a.size(); ++i) {
        for (std::size_t j = 0; j <= b.size(); ++j) {
            if (i == 0 || j == 0) {
                d[i][j] = i + j;
                continue;
            }
            const std::size_t changed = d[i - 1][j - 1] + (a[i - 1] != b[j - 1]);
            d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, changed});
            const bool isExchanged = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
            if (isExchanged) d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
        }
    }
    return d[a.size()][b.size()];
}

} // namespace

std::string nearestName(const std::string& name, const std::vector<std::string>& names)
{
    constexpr std::size_t kShortestName = 3, kMostEdits = 2, kLongestName = 200;
    std::string nearest;
    std::size_t least = kMostEdits + 1;
    if (name.size() < kShortestName || name.size() > kLongestName) return nearest;
    for (const std::string& other : names) {
        if (other.size() > kLongestName) continue;
        const std::size_t edits = other.rfind(name, 0) == 0 ? 0 : editDistance(name, other);
        // Of a short name two edits leave nothing.
        if (edits < least && edits < other.size()) nearest = other, least = edits;
    }
    return nearest;
}

std::string insteadText(const std::string& name, const std::vector<std::string>& names,
                        const std::string& what)
{
    if (names.empty()) return "; it has no " + what;
    const std::string nearest = nearestName(name, names);
    std::string text = nearest.empty() ? "; its " : "; did you mean '" + shownText(nearest) + "'? Its ";
    text += what + " are ";
    for (std::size_t i = 0; i < std::min(names.size(), kMostListed); ++i)
        text += (i ? ", '" : "'") + shownText(names[i]) + "'";
    return text + (names.size() > kMostListed ? ", ..." : "");
}

} // namespace vdb_nns
