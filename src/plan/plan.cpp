// The steps of a plan, one after the other, and how much room a block is given beyond its estimate.
#include "vdb_nns/planning/plan.h"

#include "util/wall_clock.h"

#include <algorithm>

namespace vdb_nns {
namespace {

// Steps that tell a caller's Progress nothing of their own names.
class NamedStep final : public Progress {
public:
    NamedStep(Progress* progress, const char* name) : mProgress(progress), mName(name) {}
    void update(const char*, double fraction) override
    {
        if (mProgress) mProgress->update(mName, fraction);
    }
    bool cancelled() const override { return mProgress && mProgress->cancelled(); }

private:
    Progress* mProgress;
    const char* mName;
};

BlockBytes bytesAtOnce(const SparseGrid& grid, const WorkEstimate& estimate, const MemoryModel& model)
{
    WorkloadNode everything;
    everything.endLeaf = static_cast<std::uint32_t>(grid.leafCount());
    everything.occupiedCells = grid.cellCount();
    everything.work = estimate.total;
    return blockBytes(everything, model);
}

std::uint64_t levelCount(const WorkloadTree& tree)
{
    std::uint64_t levels = 0; // bit k: there are nodes of 2^k cells
    for (const WorkloadNode& node : tree.nodes) levels |= std::uint64_t(1) << node.log2Cells;
    return static_cast<std::uint64_t>(__builtin_popcountll(levels));
}

void findBounds(const SparseGrid& grid, Plan& plan)
{
    constexpr std::int32_t kLeafCells = 8;
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        const Vec3i origin = grid.leaf(l).origin;
        for (std::size_t k = 0; k < 3; ++k) {
            plan.lowCell[k] = l == 0 ? origin[k] : std::min(plan.lowCell[k], origin[k]);
            plan.endCell[k] =
                l == 0 ? origin[k] + kLeafCells : std::max(plan.endCell[k], origin[k] + kLeafCells);
        }
    }
}

// Where a few leaves say that everything fits the one device with room to spare, nothing more has to be known: a block that
// is larger after all is split and redone.
WorkEstimate estimateFor(const SparseGrid& grid, const DeviceOptions& options, Encoding encoding,
                         PlanDetail detail, Progress& progress)
{
    const bool mayBeOne =
        options.devices.size() == 1 && options.schedule.blockLog2Cells == 0 && !options.margin;
    if (detail == PlanDetail::kAsNeeded && mayBeOne && options.estimate.estimator == Estimator::kExpected) {
        EstimateOptions rough;
        rough.estimator = Estimator::kProbed;
        rough.radius = options.estimate.radius;
        const WorkEstimate probed = estimateWork(grid, rough);
        const BlockBytes needed = bytesAtOnce(grid, probed, memoryModel(options, encoding, probed));
        if (needed.total() <= options.devices[0].memoryBytes) return probed;
    }
    EstimateOptions estimate = options.estimate;
    estimate.progress = &progress;
    // Only the room for index lists rests on the number of pairs.
    estimate.correctCrowding &= detail == PlanDetail::kFull || encoding == Encoding::kIndex;
    return estimateWork(grid, estimate);
}

} // namespace

MemoryModel memoryModel(const DeviceOptions& options, Encoding encoding, const WorkEstimate& estimate)
{
    // Twice the spread holds 95 % of blocks if errors are normal; below 2 % the sample cannot tell.
    constexpr double kSpreads = 2, kLeastMargin = 0.02;
    MemoryModel model;
    model.encoding = encoding;
    if (estimate.estimator == Estimator::kProbed) {
        model.margin = estimate.margin;
        model.masksAreExact = false;
        return model;
    }
    model.auxNeighbors = options.auxNeighbors;
    model.margin = options.margin ? *options.margin : std::max(kLeastMargin, kSpreads * estimate.margin);
    return model;
}

Plan makePlan(const SparseGrid& grid, const DeviceOptions& options, Encoding encoding, PlanDetail detail,
              Progress* progress)
{
    Plan plan;
    const double start = wallSeconds();
    NamedStep estimating(progress, "estimate"), planning(progress, "plan");
    estimating.update("", 0);
    const WorkEstimate estimate = estimateFor(grid, options, encoding, detail, estimating);
    const double estimated = wallSeconds();
    plan.estimateSeconds = estimated - start;

    planning.update("", 0);
    WorkloadTreeOptions tree;
    tree.model = memoryModel(options, encoding, estimate);
    plan.everything = bytesAtOnce(grid, estimate, tree.model);
    tree.nodeBytes = nodeBytesFor(grid, estimate, tree.model, options.devices, options.schedule);
    tree.blockLog2Cells = options.devices.empty() ? 0 : options.schedule.blockLog2Cells;
    tree.progress = &planning;
    const WorkloadTree divided = buildWorkloadTree(grid, estimate, tree);
    plan.schedule = makeSchedule(grid, divided, options.devices, options.schedule);
    plan.planSeconds = wallSeconds() - estimated;

    plan.devices = options.devices;
    plan.estimator = estimate.estimator;
    plan.total = estimate.total;
    plan.correction = estimate.correction;
    plan.countedQueries = estimate.countedQueries;
    plan.treeNodes = divided.nodes.size();
    plan.treeLevels = levelCount(divided);
    findBounds(grid, plan);
    return plan;
}

} // namespace vdb_nns
