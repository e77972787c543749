// Flags that say on which devices a search runs, how its work is estimated and how it is cut into blocks.
#pragma once

#include "vdb_nns/planning/executor.h"

#include <CLI/CLI.hpp>

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct DeviceFlags {
    std::string device = "auto", deviceMemory, boundary = "auto", estimator = "expected", blockSize, sim;
};
void addDeviceFlags(CLI::App& app, DeviceFlags& flags);
/// Only those that say which devices there are: --device, --device-memory and --sim.
void addDeviceTargetFlags(CLI::App& app, DeviceFlags& flags);

/// What the flags ask for, ready for the library.
struct DeviceRequest {
    std::vector<DeviceLimits> devices; ///< none: the CPU alone
    EstimateOptions estimate;
    ScheduleOptions schedule;
    DeviceFailure onFailure =
        DeviceFailure::kStop;     ///< only where nobody asked for the device may the CPU take over
    double auxNeighbors = 0;      ///< MemoryModel::auxNeighbors
    std::optional<double> margin; ///< MemoryModel::margin; none: from the error that the estimate measured
};

/// @param threads that the search will use: they set the rate of the CPU
/// @throws InvalidInput for a value or a combination that is not possible, DeviceError for a device that is not there
DeviceRequest deviceRequest(const DeviceFlags& flags, int threads);

/// How bytes of a block follow from its work. The one place that decides how much room index lists are given beyond
/// their estimate.
MemoryModel memoryModel(const DeviceRequest& request, Encoding encoding, const WorkEstimate& estimate);

} // namespace vdb_nns::cli
