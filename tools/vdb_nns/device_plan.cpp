#include "device_plan.h"

#include "machine.h"

#include <algorithm>
#include <utility>

namespace vdb_nns::cli {
namespace {

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

void findBounds(const SparseGrid& grid, PlanReport& plan)
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
WorkEstimate estimateFor(const SparseGrid& grid, const DeviceRequest& request, Encoding encoding,
                         PlanDetail detail)
{
    const bool mayBeOne = request.devices.size() == 1 && request.schedule.blockLog2Cells == 0;
    if (detail == PlanDetail::kAsNeeded && mayBeOne && request.estimate.estimator == Estimator::kExpected) {
        EstimateOptions rough;
        rough.estimator = Estimator::kProbed;
        const WorkEstimate probed = estimateWork(grid, rough);
        const BlockBytes needed = bytesAtOnce(grid, probed, memoryModel(request, encoding, probed));
        if (needed.total() <= request.devices[0].memoryBytes) return probed;
    }
    EstimateOptions options = request.estimate;
    // Only the room for index lists rests on the number of pairs.
    options.correctCrowding = detail == PlanDetail::kFull || encoding == Encoding::kIndex;
    return estimateWork(grid, options);
}

} // namespace

PlanReport makePlan(const SparseGrid& grid, DeviceRequest request, Encoding encoding, PlanDetail detail,
                    const ProgressSpan& span, SecondsReport& seconds)
{
    ProgressPrinter& progress = span.printer;
    const double middle = 0.5 * (span.begin + span.end);
    progress.begin("estimate", span.begin, middle);
    const Stopwatch estimateWatch;
    request.estimate.progress = &progress;
    const WorkEstimate estimate = estimateFor(grid, request, encoding, detail);
    seconds.estimate = estimateWatch.seconds();

    progress.begin("plan", middle, span.end);
    const Stopwatch planWatch;
    PlanReport plan;
    WorkloadTreeOptions treeOptions;
    treeOptions.model = memoryModel(request, encoding, estimate);
    plan.everything = bytesAtOnce(grid, estimate, treeOptions.model);
    treeOptions.nodeBytes =
        nodeBytesFor(grid, estimate, treeOptions.model, request.devices, request.schedule);
    treeOptions.blockLog2Cells = request.devices.empty() ? 0 : request.schedule.blockLog2Cells;
    treeOptions.progress = &progress;
    const WorkloadTree tree = buildWorkloadTree(grid, estimate, treeOptions);
    plan.schedule = makeSchedule(grid, tree, request.devices, request.schedule);
    seconds.plan = planWatch.seconds();

    plan.devices = std::move(request.devices);
    plan.estimator = estimate.estimator;
    plan.total = estimate.total;
    plan.correction = estimate.correction;
    plan.countedQueries = estimate.countedQueries;
    plan.treeNodes = tree.nodes.size();
    plan.treeLevels = levelCount(tree);
    findBounds(grid, plan);
    return plan;
}

NeighborLists searchOnDevices(SearchEngine& engine, const SparseGrid& grid, const DeviceRequest& request,
                              const SearchOptions& options, const ProgressSpan& span, SearchReport& report)
{
    const double planned = span.begin + 0.2 * (span.end - span.begin);
    report.plan = makePlan(grid, request, options.encoding, PlanDetail::kAsNeeded,
                           {span.printer, span.begin, planned}, report.seconds);
    span.printer.begin("search", planned, span.end);
    RunOptions run;
    run.search = options;
    run.schedule = request.schedule;
    run.onFailure = request.onFailure;
    report.run.emplace();
    return engine.search(grid, report.plan->schedule, report.plan->devices, run, *report.run);
}

} // namespace vdb_nns::cli
