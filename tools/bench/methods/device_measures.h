// What a run on devices took: plain data, and the figures that follow from it.
#pragma once

#include "vdb_nns/planning/executor.h"
#include "vdb_nns/planning/schedule.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Of all devices together, but for `budgetBytes` and `peakBytes`: those of the device with the largest peak. Bytes and seconds
/// of transfers are measured by the devices; simulated ones measure none, and their other seconds are virtual.
struct DeviceMeasures {
    std::string kind, name; ///< of the first device
    bool isVirtual = false; ///< simulated devices alone
    bool inCore = false;
    BoundaryMode boundary = BoundaryMode::kHalo;
    std::uint64_t budgetBytes = 0, peakBytes = 0, peakSumBytes = 0;
    std::uint64_t blocks = 0, overflows = 0, retries = 0, splits = 0, halvings = 0;
    std::uint64_t particles = 0, cpuParticles = 0; ///< queries, by who ran them
    std::uint64_t pairs = 0, candidateTests = 0;   ///< of all queries
    std::uint64_t bytesUp = 0, bytesDown = 0;
    double estimateSeconds = 0, planSeconds = 0;
    double uploadSeconds = 0, searchSeconds = 0,
           downloadSeconds = 0;       ///< each summed over blocks; they overlap
    double collectSeconds = 0;        ///< of all threads together
    double makespanSeconds = 0;       ///< of the run: from the plan to the lists
    double modelTestsPerSecond = 0;   ///< of the devices, before anything was measured
    double modelCpuSeconds = 0;       ///< what the CPU alone is taken to need; where all is virtual
    std::optional<double> lowerBound; ///< seconds of CPU and devices together; see setLowerBounds()

    // Nothing where nothing was measured.
    std::optional<double> upGbs() const;
    std::optional<double> downGbs() const;
    /// Of bytes in both directions over the time of the kernels: what kernels on mapped memory move at least.
    std::optional<double> kernelGbs() const;
    std::optional<double> neighborsPerSecond() const; ///< of the kernels; none where the CPU had a part
    std::optional<double> testsPerSecond() const;     ///< the same
    std::optional<double> particlesPerGib() const;    ///< of all particles, on the devices' peaks together
    std::optional<double> overLowerBound() const;     ///< the makespan
};

/// The counts of the last run, and of each time the median.
DeviceMeasures medianOf(const std::vector<DeviceMeasures>& runs);

/// CPU and devices together can at best work as long as both rates add up: 1 / (1/T_cpu + 1/T_devices).
double togetherSeconds(double cpuSeconds, double deviceSeconds);

} // namespace vdb_nns::cli
