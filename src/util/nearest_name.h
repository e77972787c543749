// Which of some names one that is not among them was meant to be, for messages.
#pragma once

#include <string>
#include <vector>

namespace vdb_nns {

// One that the name begins, or the one at most two edits away; empty if there is none.
std::string nearestName(const std::string& name, const std::vector<std::string>& names);

// What a message says of a name that is not there: "; did you mean 'a'? The attributes are 'a', 'b'", or
// "; it has no attributes". `what` is their plural. Long lists are cut.
std::string insteadText(const std::string& name, const std::vector<std::string>& names,
                        const std::string& what);

} // namespace vdb_nns
