// How much memory there is, and how much of it this process has.
#pragma once

#include <cstdint>

namespace vdb_nns {

/// Bytes that this process may still take, what `hostMemoryBytes = 0` stands for: what the machine has
/// available, the limits of control groups (every level, version 1 and 2) and of the address space respected,
/// less a reserve of 1/16 for everything else. Measured anew by each call; a number beyond any machine's
/// where the system tells nothing.
std::uint64_t availableMemoryBytes();

/// Memory of this process that is resident now.
std::uint64_t residentMemoryBytes();

/// The most that it has had resident since it began.
std::uint64_t peakMemoryBytes();

/// Gives memory that the process has freed back to the system, and large blocks from now on as soon as they are freed (glibc;
/// elsewhere nothing). A bound on resident memory that is taken over from earlier work needs it.
void returnFreedMemory();

} // namespace vdb_nns
