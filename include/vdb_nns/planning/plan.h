// The plan of a search on devices in one call: estimate, workload tree, schedule. Plain data; nothing runs.
#pragma once

#include "vdb_nns/planning/devices.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/planning/workload_tree.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

/// Who would run what, and why.
struct Plan {
    std::vector<DeviceLimits> devices;
    Schedule schedule;
    Estimator estimator = Estimator::kExpected;
    Work total; ///< with Estimator::kProbed all of it is extrapolated from 32 leaves, tests and masks too
    double correction = 1;            ///< WorkEstimate::correction
    std::uint64_t countedQueries = 0; ///< WorkEstimate::countedQueries
    BlockBytes everything;            ///< of all particles as one block
    std::uint64_t treeNodes = 0, treeLevels = 0;
    Vec3i lowCell{}, endCell{}; ///< box of the occupied leaves, in cells
    double estimateSeconds = 0, planSeconds = 0;
};

/// How much of a plan is made.
enum class PlanDetail {
    kAsNeeded, ///< no more than a run asks for: a rough estimate where that shows that everything fits the one device
    kFull ///< for a reader: every leaf is estimated
};

/// Plans a search of `grid`.
/// @param options `estimate.progress` is not read. Where everything fits one device by a rough estimate with room to spare, and
///        no margin is given, that estimate is taken, and only as much of the rest as a run needs.
/// @param progress told of the steps "estimate" and "plan"; may be null
/// Cost: see estimateWork(), buildWorkloadTree() and makeSchedule(), whose options say what each step does.
/// @throws as those; Cancelled
Plan makePlan(const SparseGrid& grid, const DeviceOptions& options, Encoding encoding,
              PlanDetail detail = PlanDetail::kAsNeeded, Progress* progress = nullptr);

/// How bytes of a block follow from its work: the one place that decides how much room index lists are given beyond their
/// estimate.
MemoryModel memoryModel(const DeviceOptions& options, Encoding encoding, const WorkEstimate& estimate);

} // namespace vdb_nns
