// How much memory the control groups of this process leave it: cgroup v1, v2 and both at once, at every level up to what
// is mounted. Knows only the files of the kernel (Documentation/admin-guide/cgroup-v1/memory.rst and cgroup-v2.rst).
#pragma once

#include <cstdint>
#include <string>

namespace vdb_nns {

// The least that a level leaves: its limit less what is used there and could not be reclaimed. The largest number where
// nothing limits the process, or the files are missing.
// `root` stands before every path that is read, those that the files name included.
std::uint64_t cgroupFreeBytes(const std::string& root = {});

} // namespace vdb_nns
