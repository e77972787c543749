// Which flags of `bench` which studies heed.
#pragma once

#include <set>
#include <string>

namespace vdb_nns::cli {

/// `given`: the flags that were given, as `--name`. `studies`: what is looked at; "stability" is one of them.
/// @throws InvalidInput for a flag that none of them heeds: it says which do
void checkStudyFlags(const std::set<std::string>& given, const std::set<std::string>& studies);

} // namespace vdb_nns::cli
