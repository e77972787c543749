// How fast bytes travel between host and device.
#pragma once

#include "vdb_nns/planning/schedule.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// 10^9 bytes a second from and to pinned host memory, by the device's own clock; medians.
struct LinkRates {
    std::string name;                      ///< of the device
    std::uint64_t bytes = 0;               ///< of each transfer
    double upGbs = 0, downGbs = 0;         ///< one direction at a time
    double bothUpGbs = 0, bothDownGbs = 0; ///< both at once
};

/// Of the first CUDA device; nothing without one.
/// @throws DeviceError
std::optional<LinkRates> measureLink(const std::vector<DeviceLimits>& devices);

} // namespace vdb_nns::cli
