// How much memory there is.
#pragma once

#include <cstdint>

namespace vdb_nns {

/// Bytes that this process may still take, what `hostMemoryBytes = 0` stands for: what the machine has
/// available, the limits of control groups (every level, version 1 and 2) and of the address space respected,
/// less a reserve of 1/16 for everything else. Measured anew by each call; a number beyond any machine's
/// where the system tells nothing.
std::uint64_t availableMemoryBytes();

} // namespace vdb_nns
