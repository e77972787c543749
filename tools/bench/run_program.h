// Runs another program.
#pragma once

#include <array>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Runs a program on these descriptors as its standard streams, in this folder. Returns its exit status, 128 and the number of
/// the signal that ended it, or 127 where it cannot be run.
int runProgram(const std::vector<std::string>& command, const std::array<int, 3>& streams,
               const char* folder = ".");

} // namespace vdb_nns::cli
