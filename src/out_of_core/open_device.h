// Which BlockDevice a DeviceLimits means: the one place that knows all kinds.
#pragma once

#include "search/engine_state.h"
#include "shared/block_device.h"
#include "vdb_nns/planning/schedule.h"

#include <functional>
#include <memory>

namespace vdb_nns {

// Opens a device of `limits`; `run` and `states` outlive it. Throws DeviceError when it is not there.
using DeviceMaker = std::function<std::unique_ptr<BlockDevice>(const DeviceLimits& limits,
                                                               const SearchRun& run, ThreadStates& states)>;

// The device that `limits` mean. Throws InvalidInput for the CPU.
std::unique_ptr<BlockDevice> openDevice(const DeviceLimits& limits, const SearchRun& run,
                                        ThreadStates& states);

} // namespace vdb_nns
