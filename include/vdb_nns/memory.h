// How much memory this process may still take.
#pragma once

#include <cstdint>

namespace vdb_nns {

/// Bytes that this process may still take; what `hostMemoryBytes = 0` stands for. That is what the machine
/// has available, within the limits of all control groups (every level, versions 1 and 2) and of the address
/// space, less a reserve of 1/16 for everything else. If the system tells nothing, more than any machine has.
/// Measured anew by each call. Thread-safe.
std::uint64_t availableMemoryBytes();

} // namespace vdb_nns
