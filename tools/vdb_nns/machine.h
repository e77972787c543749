// What this process runs on and what it has used, for reports.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace vdb_nns::cli {

/// Model name of the processor; "unknown" where the system does not tell.
std::string cpuName();

/// Main memory of the machine in bytes; 0 where the system does not tell.
std::uint64_t machineMemoryBytes();

/// Most memory this process has had resident, since it began or since resetPeakMemory().
std::uint64_t peakMemoryBytes();

/// Memory of this process that is resident now.
std::uint64_t residentMemoryBytes();

/// Gives freed memory back to the system, and large blocks from now on as soon as they are freed.
void returnFreedMemory();

/// Starts the peak anew where the system allows it.
void resetPeakMemory();

class Stopwatch {
public:
    double seconds() const
    {
        return std::chrono::duration<double>(std::chrono::steady_clock::now() - mStart).count();
    }

private:
    std::chrono::steady_clock::time_point mStart = std::chrono::steady_clock::now();
};

} // namespace vdb_nns::cli
