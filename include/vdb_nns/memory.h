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

/// Returns freed memory to the system, and makes later large blocks go back as soon as they are freed (glibc
/// only). Call it before measuring resident memory; otherwise memory that earlier work has freed still counts.
void returnFreedMemory();

} // namespace vdb_nns
