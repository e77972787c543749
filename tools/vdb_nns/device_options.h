// Flags that say on which devices a search runs, how its work is estimated and how it is cut into blocks.
#pragma once

#include "vdb_nns/planning/devices.h"

#include <CLI/CLI.hpp>

#include <string>

namespace vdb_nns::cli {

struct DeviceFlags {
    std::string device = "auto", deviceMemory, boundary = "auto", estimator = "expected", blockSize, sim;
};
void addDeviceFlags(CLI::App& app, DeviceFlags& flags);
/// Only those that say which devices there are: --device, --device-memory and --sim.
void addDeviceTargetFlags(CLI::App& app, DeviceFlags& flags);

/// What the flags ask for, ready for the library.
/// @param threads that the search will use beside the devices
/// @throws InvalidInput for a value or a combination that is not possible, DeviceError for a device that is not there
DeviceOptions deviceOptions(const DeviceFlags& flags, int threads);

} // namespace vdb_nns::cli
