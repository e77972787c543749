// Runs a schedule: blocks on devices, the rest on TBB workers, rows into lists.
#pragma once

#include "out_of_core/open_device.h"
#include "search/engine_state.h"
#include "vdb_nns/planning/executor.h"

#include <vector>

namespace vdb_nns {

// Throws as SearchEngine::search() with a schedule.
NeighborLists runSchedule(EngineState& engine, const SparseGrid& grid, const Schedule& schedule,
                          const std::vector<DeviceLimits>& devices, const RunOptions& options,
                          ScheduleRun& report, const DeviceMaker& makeDevice = openDevice);

} // namespace vdb_nns
