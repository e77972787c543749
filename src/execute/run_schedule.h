// Runs a schedule: blocks on devices, the rest on TBB workers, rows into lists.
#pragma once

#include "execute/engine_state.h"
#include "shared/block_device.h"
#include "vdb_nns/executor.h"

#include <functional>
#include <memory>
#include <vector>

namespace vdb_nns {

// Opens a device of `limits`; `run` and `states` outlive it. Throws DeviceError when it is not there.
using DeviceMaker = std::function<std::unique_ptr<BlockDevice>(const DeviceLimits& limits,
                                                               const SearchRun& run, ThreadStates& states)>;

// The device that `limits` mean.
std::unique_ptr<BlockDevice> openDevice(const DeviceLimits& limits, const SearchRun& run,
                                        ThreadStates& states);

// Throws as SearchEngine::search() with a schedule.
NeighborLists runSchedule(EngineState& engine, const SparseGrid& grid, const Schedule& schedule,
                          const std::vector<DeviceLimits>& devices, const RunOptions& options,
                          ScheduleRun& report, const DeviceMaker& makeDevice = openDevice);

} // namespace vdb_nns
