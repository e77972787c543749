// A choice of points by their groups, as a caller writes it: "a,b,^c". Knows no file.
#pragma once

#include <string>
#include <vector>

namespace vdb_nns {

// The points of any of `wanted` (all points if that is empty), but for those of any of `left out`.
struct GroupList {
    std::vector<std::string> wanted, leftOut;
};

// Names with commas between them, in any order, those to be left out behind a '^'; blanks around names do not count.
// @throws InvalidInput for an empty name, and for one that `groups` does not have; `file` begins the message
GroupList parseGroupList(const std::string& list, const std::vector<std::string>& groups,
                         const std::string& file);

} // namespace vdb_nns
