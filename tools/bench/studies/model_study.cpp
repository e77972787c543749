#include "bench/studies/model_study.h"

#include "machine.h"
#include "numbers.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/search.h"

#include <algorithm>

namespace vdb_nns::cli {
namespace {

struct Samples {
    std::vector<double> grid, estimate, tree, schedule, search;
};

// The steps of makePlan(), each by itself.
struct TimedPlan {
    WorkEstimate estimate;
    WorkloadTree tree;
    Schedule schedule;
};

TimedPlan timedPlan(const SparseGrid& grid, const DeviceOptions& request, Encoding encoding, Samples& samples)
{
    TimedPlan result;
    EstimateOptions options = request.estimate;
    options.correctCrowding = encoding == Encoding::kIndex;
    const Stopwatch estimateWatch;
    result.estimate = estimateWork(grid, options);
    samples.estimate.push_back(estimateWatch.seconds());
    const Stopwatch treeWatch;
    WorkloadTreeOptions treeOptions;
    treeOptions.model = memoryModel(request, encoding, result.estimate);
    treeOptions.nodeBytes =
        nodeBytesFor(grid, result.estimate, treeOptions.model, request.devices, request.schedule);
    result.tree = buildWorkloadTree(grid, result.estimate, treeOptions);
    samples.tree.push_back(treeWatch.seconds());
    const Stopwatch scheduleWatch;
    result.schedule = makeSchedule(grid, result.tree, request.devices, request.schedule);
    samples.schedule.push_back(scheduleWatch.seconds());
    return result;
}

DeviceOptions outOfCore(const BenchPoints& points, const ModelStudyOptions& options, Encoding encoding,
                        const ProgressSpan& span)
{
    DeviceOptions request = options.setup.devices.request;
    request.devices.resize(1);
    request.schedule.useCpu = false;
    SearchOptions search = options.setup.options;
    search.wideCells = false; // as methods on devices have it
    const SparseGrid grid = SearchEngine().buildGrid(points.view, options.radius, search);
    request.devices[0].memoryBytes = std::uint64_t(1) << 60;
    const Plan whole = makePlan(grid, request, encoding, PlanDetail::kFull, &span.printer);
    request.devices[0].memoryBytes = std::max<std::uint64_t>(whole.everything.total() / 10, 1);
    return request;
}

void setMedians(const Samples& samples, ModelShare& share)
{
    const auto middle = [](const std::vector<double>& values) { return values.empty() ? 0 : median(values); };
    share.gridSeconds = middle(samples.grid);
    share.estimateSeconds = middle(samples.estimate);
    share.treeSeconds = middle(samples.tree);
    share.scheduleSeconds = middle(samples.schedule);
    share.searchSeconds = middle(samples.search);
}

// `request` is null in core.
ModelShare measureShare(const BenchPoints& points, const ModelStudyOptions& options, Encoding encoding,
                        const DeviceOptions* request)
{
    ModelShare share;
    share.scene = points.scene;
    share.encoding = encoding;
    share.inCore = request == nullptr;
    share.points = points.view.size();
    RunOptions run;
    run.search = options.setup.options;
    run.search.encoding = encoding;
    run.search.wideCells = share.inCore;
    Samples samples;
    SearchEngine engine;
    for (std::uint64_t r = 0; r <= options.repeat; ++r) {
        if (r == 1) samples = {}; // run 0 warms up
        const Stopwatch gridWatch;
        const SparseGrid grid = engine.buildGrid(points.view, options.radius, run.search);
        samples.grid.push_back(gridWatch.seconds());
        share.structureBytes = grid.bytes();
        NeighborLists lists;
        if (request) {
            const TimedPlan planned = timedPlan(grid, *request, encoding, samples);
            run.schedule = request->schedule;
            ScheduleRun report;
            const Stopwatch searchWatch;
            lists = engine.search(grid, planned.schedule, request->devices, run, report);
            samples.search.push_back(searchWatch.seconds());
            share.blocks = planned.schedule.blocks.size();
            share.estimateBytes = planned.estimate.leaves.size() * sizeof(Work);
            share.treeBytes = planned.tree.nodes.size() * sizeof(WorkloadNode);
            share.scheduleBytes = planned.schedule.blocks.size() * sizeof(Block);
        } else {
            const Stopwatch searchWatch;
            lists = engine.search(grid, run.search);
            samples.search.push_back(searchWatch.seconds());
        }
        share.listBytes = lists.bytes();
    }
    setMedians(samples, share);
    return share;
}

double secondsOf(const ModelShare& share)
{
    return share.gridSeconds + share.modelSeconds() + share.searchSeconds;
}

// Medians of two methods, interleaved.
struct Compared {
    double with = 0, without = 0;
};
Compared compare(const std::unique_ptr<Method>& with, const std::unique_ptr<Method>& without,
                 const BenchPoints& points, const ModelStudyOptions& options, const ProgressSpan& span)
{
    std::vector<double> seconds[2];
    const std::size_t steps = 2 * (options.repeat + 1);
    for (std::uint64_t run = 0; run <= options.repeat; ++run) {
        for (const std::size_t m : {0, 1}) {
            Method& method = m == 0 ? *with : *without;
            const double total =
                method.run(points.view, options.radius, span.part(2 * run + m, steps)).totalSeconds();
            method.discard();
            if (run > 0) seconds[m].push_back(total);
        }
    }
    return {median(seconds[0]), median(seconds[1])};
}

std::unique_ptr<Method> withCells(MethodSetup setup, double cellSize)
{
    setup.options.cellSize = cellSize;
    return makeMethod(parseMethod("ours-index"), setup);
}

} // namespace

ModelStudy studyModel(const BenchPoints& points, const ModelStudyOptions& options, const ProgressSpan& span)
{
    ModelStudy study;
    constexpr std::size_t kSteps =
        9; // of each encoding a run in core, a plan and a run of it; counts; two comparisons
    std::size_t step = 0;
    const auto next = [&] {
        const ProgressSpan part = span.part(step++, kSteps);
        part.printer.begin("model", part.begin, part.end);
        return part;
    };
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        next();
        study.shares.push_back(measureShare(points, options, encoding, nullptr));
        const DeviceOptions request = outOfCore(points, options, encoding, next());
        next();
        study.shares.push_back(measureShare(points, options, encoding, &request));
    }
    const ModelShare &index = study.shares[0], &planned = study.shares[1], &mask = study.shares[2];
    next();
    const ModelShare count = measureShare(points, options, Encoding::kNone, nullptr);
    const auto add = [&](const char* part, const char* unit, double with, double without) {
        study.savings.push_back({points.scene, part, unit, with, without});
    };
    add("no estimate, tree and schedule where everything fits", "seconds",
        secondsOf(index) + planned.modelSeconds(), secondsOf(index));
    add("no lists where only counts are asked", "seconds", secondsOf(index), secondsOf(count));
    add("no lists where only counts are asked", "bytes", static_cast<double>(index.listBytes),
        static_cast<double>(count.listBytes));
    add("masks where nobody asks for indices", "bytes", static_cast<double>(index.listBytes),
        static_cast<double>(mask.listBytes));
    const Compared tests =
        compare(makeMethod(parseMethod("world-double"), options.setup),
                makeMethod(parseMethod("certified"), options.setup), points, options, next());
    add("double and exact tests only near the radius", "seconds", tests.with, tests.without);
    const Compared cells =
        compare(withCells(options.setup, 1), withCells(options.setup, 0), points, options, next());
    add("cells as wide as the density asks", "seconds", cells.with, cells.without);
    return study;
}

} // namespace vdb_nns::cli
