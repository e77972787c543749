// How much memory this process has, and how much it may still take.
#pragma once

#include <cstdint>

namespace vdb_nns {

/// Bytes that this process may still take; what `hostMemoryBytes = 0` stands for. That is what the machine
/// has available, within the limits of all control groups (every level, versions 1 and 2) and of the address
/// space, less a reserve of 1/16 for everything else. If the system tells nothing, more than any machine has.
/// Measured anew by each call. Thread-safe.
std::uint64_t availableMemoryBytes();

/// Memory of this process that is resident now.
std::uint64_t residentMemoryBytes();

/// The most that it has had resident since it began.
std::uint64_t peakMemoryBytes();

/// Gives memory that the process has freed back to the system, and large blocks from now on as soon as they are freed (glibc;
/// elsewhere nothing). A bound on resident memory that is taken over from earlier work needs it.
void returnFreedMemory();

} // namespace vdb_nns
