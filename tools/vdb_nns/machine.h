// What this process runs on, for reports; what it has used is in vdb_nns/memory.h.
#pragma once

#include "vdb_nns/memory.h"

#include <chrono>
#include <cstdint>
#include <string>

namespace vdb_nns::cli {

/// Model name of the processor; "unknown" where the system does not tell.
std::string cpuName();

/// Main memory of the machine in bytes; 0 where the system does not tell.
std::uint64_t machineMemoryBytes();

/// Starts vdb_nns::peakMemoryBytes() anew where the system allows it.
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
