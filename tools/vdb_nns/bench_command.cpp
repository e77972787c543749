// vdb_nns bench: speed and accuracy of every method side by side, on the same points in the same run.
#include "bench/accuracy.h"
#include "bench/bench_points.h"
#include "bench/bench_report.h"
#include "bench/device_methods.h"
#include "bench/device_report.h"
#include "bench/estimators.h"
#include "bench/link.h"
#include "bench/methods.h"
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "numbers.h"
#include "report.h"
#include "text_file.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstdio>
#include <memory>

namespace vdb_nns::cli {
namespace {

struct BenchFlags {
    CommonFlags common;
    InputFlags input;
    EngineFlags engine;
    SceneFlags scene;
    DeviceFlags device;
    std::string sceneName, methods, estimators, csv, pointsOut, shuffleSeed;
    std::string repeat = "5", sample = "1000";
};

struct BenchPlan {
    std::vector<MethodSpec> methods;
    std::vector<std::string> estimators;
    SearchOptions options;
    BenchDevices devices;
    std::optional<SceneOptions> scene;
    std::optional<double> radius;
    std::optional<std::uint64_t> shuffleSeed;
    std::uint64_t repeat = 5, sample = 1000, seed = 1;
    int threads = 0;
};

struct MethodTimes {
    std::vector<double> grid, search, total;
    std::vector<DeviceMeasures> device; // empty for a method of the CPU
    MethodRun last;
    double first = 0;
    std::uint64_t peakBytes = 0;
};

void addFlags(CLI::App& app, BenchFlags& flags)
{
    app.add_option("IN", flags.input.path, "point file; or use --scene")->check(notEmpty());
    app.add_option("--scene", flags.sceneName, "make this scene instead of reading a file")
        ->type_name("NAME")
        ->check(notEmpty());
    addSceneFlags(app, flags.scene);
    addInputFlags(app, flags.input, true);
    app.add_option("--method", flags.methods, methodHelp())->type_name("LIST")->check(notEmpty());
    addDeviceTargetFlags(app, flags.device);
    app.add_option("--estimator", flags.estimators,
                   "estimators of the work, separated by commas, against a full count: "
                   "paper,uncorrected,expected,sampled,counted,fixed,mask or all; default: none")
        ->type_name("LIST")
        ->check(notEmpty());
    app.add_option("--repeat", flags.repeat, "timed runs of each method, interleaved, after one warm-up")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--sample", flags.sample,
                   "queries checked against all points by the independent search; 0: none")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--shuffle", flags.shuffleSeed, "put the particles in random order first")
        ->type_name("SEED")
        ->check(notEmpty());
    app.add_option("--points-out", flags.pointsOut, "write the points searched as raw float32 x y z triples")
        ->type_name("FILE")
        ->check(notEmpty());
    app.add_option("--csv", flags.csv, "write the results as CSV")->type_name("FILE")->check(notEmpty());
    addEngineFlags(app, flags.engine);
    addCommonFlags(app, flags.common);
}

BenchPlan checkFlags(const BenchFlags& flags)
{
    BenchPlan plan;
    if (flags.input.path.empty() == flags.sceneName.empty()) {
        throw InvalidInput("bench needs a point file or --scene NAME, one of them");
    }
    if (!flags.sceneName.empty()) {
        if (!flags.input.grid.empty())
            throw InvalidInput("--grid is for a .vdb file, and --scene makes no grid");
        plan.scene = sceneOptions(flags.sceneName, flags.scene);
    } else if (!flags.scene.count.empty()) {
        throw InvalidInput("-n is for --scene; a file has the points it has");
    }
    if (!flags.input.radius.empty()) plan.radius = parsePositive(flags.input.radius, "--radius");
    const bool namesDevice = flags.device.device != "auto" && flags.device.device != "cpu";
    plan.methods = parseMethods(flags.methods, namesDevice ? flags.device.device : "");
    checkDeviceFlags(flags.device, plan.methods);
    plan.estimators = parseEstimators(flags.estimators);
    plan.options = searchOptions(flags.engine, nullptr);
    plan.repeat = parseCount(flags.repeat, "--repeat");
    if (plan.repeat == 0) throw InvalidInput("--repeat: 0 runs are none; give 1 or more");
    plan.sample = parseCount(flags.sample, "--sample");
    plan.seed = parseCount(flags.scene.seed, "--seed");
    if (!flags.shuffleSeed.empty()) plan.shuffleSeed = parseCount(flags.shuffleSeed, "--shuffle");
    plan.threads = threadCount(flags.common);
    std::vector<std::string> outputs, inputs;
    if (!flags.csv.empty()) outputs.push_back(flags.csv);
    if (!flags.pointsOut.empty()) outputs.push_back(flags.pointsOut);
    if (!flags.input.path.empty()) inputs.push_back(flags.input.path);
    for (const std::string& output : outputs) checkNotInput(output, inputs);
    checkOutputs(outputs, inputs, flags.common);
    return plan;
}

BenchPoints loadPoints(const BenchFlags& flags, const BenchPlan& plan, ProgressPrinter& progress)
{
    const bool asFloats = plan.shuffleSeed || !flags.pointsOut.empty();
    BenchPoints points = plan.scene
                             ? sceneBenchPoints(*plan.scene, &progress)
                             : fileBenchPoints(flags.input.path, flags.input.grid, asFloats, &progress);
    if (plan.shuffleSeed) shuffle(points, *plan.shuffleSeed);
    if (!flags.pointsOut.empty()) {
        const std::vector<float>& xyz = *points.positions;
        writeWholeFile(flags.pointsOut, xyz.data(), xyz.size() * sizeof(float), flags.common.force);
    }
    return points;
}

std::unique_ptr<Method> makeMethod(const MethodSpec& spec, const BenchPlan& plan)
{
    return spec.onDevice() ? makeDeviceMethod(spec, plan.options, plan.devices)
                           : makeCpuMethod(spec, plan.options);
}

// One cold run of a method by itself: its first time and its peak of memory.
void measureCold(const MethodSpec& spec, const BenchPlan& plan, const ParticleView& view, double radius,
                 const ProgressSpan& span, MethodTimes& times)
{
    resetPeakMemory();
    const std::unique_ptr<Method> method = makeMethod(spec, plan);
    const MethodRun run = method->run(view, radius, span);
    times.first = run.totalSeconds();
    times.peakBytes = peakMemoryBytes();
}

// Interleaved, so that a change of the machine's speed meets all methods; run 0 warms up and is not counted.
void measureWarm(const std::vector<std::unique_ptr<Method>>& methods, const BenchPlan& plan,
                 const ParticleView& view, double radius, ProgressPrinter& progress,
                 std::vector<MethodTimes>& times)
{
    for (std::uint64_t run = 0; run <= plan.repeat; ++run) {
        for (std::size_t m = 0; m < methods.size(); ++m) {
            const double step = 0.5 / static_cast<double>((plan.repeat + 1) * methods.size());
            const double from = 0.3 + step * static_cast<double>(run * methods.size() + m);
            const MethodRun result = methods[m]->run(view, radius, {progress, from, from + step});
            if (run < plan.repeat) methods[m]->discard(); // the last one is checked
            times[m].last = result;
            if (run == 0) continue;
            times[m].grid.push_back(result.gridSeconds);
            times[m].search.push_back(result.searchSeconds);
            times[m].total.push_back(result.totalSeconds());
            if (result.device) times[m].device.push_back(*result.device);
        }
    }
}

BenchResult summarize(const BenchPoints& points, const std::string& method, double radius, int threads,
                      const MethodTimes& times)
{
    BenchResult result;
    result.scene = points.scene;
    result.method = method;
    result.threads = threads;
    result.points = points.view.size();
    result.pairs = times.last.pairs;
    result.radius = radius;
    result.runs = times.total.size();
    result.gridSeconds = median(times.grid);
    result.searchSeconds = median(times.search);
    result.totalSeconds = median(times.total);
    result.minSeconds = *std::min_element(times.total.begin(), times.total.end());
    result.maxSeconds = *std::max_element(times.total.begin(), times.total.end());
    result.firstSeconds = times.first;
    result.peakBytes = times.peakBytes;
    result.structureBytes = times.last.structureBytes;
    result.listBytes = times.last.listBytes;
    if (!times.device.empty()) result.device = medianOf(times.device);
    return result;
}

std::vector<BenchResult> measure(const BenchPoints& points, const BenchPlan& plan, double radius, int threads,
                                 ProgressPrinter& progress)
{
    const std::size_t count = plan.methods.size();
    std::vector<MethodTimes> times(count);
    for (std::size_t m = 0; m < count; ++m)
        measureCold(plan.methods[m], plan, points.view, radius, {progress, 0.2, 0.3}, times[m]);
    std::vector<std::unique_ptr<Method>> methods;
    for (const MethodSpec& spec : plan.methods) methods.push_back(makeMethod(spec, plan));
    measureWarm(methods, plan, points.view, radius, progress, times);

    progress.begin("check", 0.8, 1);
    const TrueNeighbors truth = findTrueNeighbors(points.view, radius, plan.sample, plan.seed, &progress);
    std::vector<BenchResult> results;
    for (std::size_t m = 0; m < count; ++m) {
        const NeighborLists& lists = methods[m]->lists();
        results.push_back(summarize(points, plan.methods[m].name, radius, threads, times[m]));
        results.back().accuracy = checkAccuracy(lists, points.view, radius, truth);
        if (lists.encoding() != Encoding::kNone) results.back().checksum = lists.checksum();
        methods[m].reset();
    }
    setLowerBounds(results);
    return results;
}

void deliver(const BenchFlags& flags, const std::vector<BenchResult>& results,
             const std::optional<LinkRates>& link, const std::vector<EstimatorResult>& estimators)
{
    if (!flags.csv.empty()) {
        const std::string csv = benchCsv(results);
        writeWholeFile(flags.csv, csv.data(), csv.size(), flags.common.force);
    }
    deliverJson(flags.common.json, benchJson(results, link, estimators), flags.common.force);
    if (!flags.common.quiet && !jsonToStdout(flags.common))
        writeStdout(benchText(results) + devicesText(results, link) + estimatorsText(estimators));
}

void requireExact(const std::vector<BenchResult>& results)
{
    for (const BenchResult& result : results) {
        if (!result.isExact()) {
            throw CheckFailed(result.method + " is wrong: " + std::to_string(result.accuracy.missing) +
                              " missing, " + std::to_string(result.accuracy.extra) + " extra, " +
                              std::to_string(result.accuracy.asymmetric.value_or(0)) +
                              " asymmetric pairs in " + std::to_string(result.accuracy.checkedQueries) +
                              " queries; please report it");
        }
    }
    if (const BenchResult* const other = firstThatDiffers(results)) {
        throw CheckFailed(other->method + " and " + results.front().method +
                          " do not find the same pairs; please report it");
    }
}

int runBench(const BenchFlags& flags, BenchPlan plan, int threads, Session& session)
{
    ProgressPrinter progress(progressMode(flags.common));
    plan.options.progress = &progress;
    progress.begin("points", 0, 0.2);
    const BenchPoints points = loadPoints(flags, plan, progress);
    session.path = plan.scene ? "scene " + points.scene : flags.input.path;
    const double radius =
        chooseRadius(flags.input.radius, points.suggestedRadius, session.path, flags.common.quiet);
    const std::optional<LinkRates> link = measureLink(plan.devices.request.devices);
    const std::vector<BenchResult> results = measure(points, plan, radius, threads, progress);
    std::vector<EstimatorResult> estimators;
    if (!plan.estimators.empty()) {
        const SparseGrid grid = SearchEngine().buildGrid(points.view, radius, plan.options);
        estimators = measureEstimators(points.scene, plan.estimators, grid, plan.repeat, &progress);
    }
    throwIfStopped();
    progress.finish();
    deliver(flags, results, link, estimators);
    requireExact(results);
    return kDone;
}

int runBenchCommand(const BenchFlags& flags, Session& session)
{
    BenchPlan plan = checkFlags(flags);
    ThreadLimit threads(plan.threads);
    plan.devices = benchDevices(flags.device, plan.methods, threads.count());
    return threads.run([&] { return runBench(flags, plan, threads.count(), session); });
}

} // namespace

Command addBenchCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("bench", "speed and accuracy of every method side by side");
    const auto flags = std::make_shared<BenchFlags>();
    addFlags(*command, *flags);
    return {command, [flags](Session& session) { return runBenchCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
