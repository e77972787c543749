// vdb_nns bench: speed and accuracy of every method side by side, on the same points in the same run.
#include "bench/bench_points.h"
#include "bench/bench_verdict.h"
#include "bench/chart.h"
#include "bench/method_names.h"
#include "bench/report/bench_report.h"
#include "bench/report/device_report.h"
#include "bench/report/measure_report.h"
#include "bench/report/set_report.h"
#include "bench/stability/matrix.h"
#include "bench/studies/method_study.h"
#include "bench/study_flags.h"
#include "bench/truth.h"
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "numbers.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <exception>
#include <memory>
#include <set>
#include <sstream>

namespace vdb_nns::cli {
namespace {

// What a benchmark can look at, in the order in which it does.
constexpr const char* kStudies[] = {"methods", "estimators", "budgets", "resolution", "scaling",
                                    "model",   "files",      "radii",   "nearest",    "measures"};

// What makes a scene. --seed is also that of samples.
constexpr const char* kSceneFlags[] = {"--count",  "--spacing",  "--radius-factor", "--voxel-size",
                                       "--offset", "--distance", "--fraction"};

struct BenchFlags {
    CommonFlags common;
    InputFlags input;
    EngineFlags engine;
    SceneFlags scene;
    DeviceFlags device;
    std::string sceneName, methods, studies, estimators, csv, chart, pointsOut, shuffleSeed;
    std::string repeat = "5", sample = "auto";
    bool stability = false;
    std::set<std::string> given; // the flags of the command line, as `--name`
};

struct BenchPlan {
    std::set<std::string> studies;
    std::string methods; // names; which suit is known once the points are read
    std::vector<std::string> estimators;
    SearchOptions options;
    BenchDevices devices;      // of the methods
    BenchDevices modelDevices; // of the studies of budgets and model: the methods', else a simulated one
    std::optional<SceneOptions> scene;
    std::optional<double> radius;
    std::optional<std::uint64_t> shuffleSeed;
    TruthOptions truth;
    std::uint64_t repeat = 5;
    int threads = 0;

    bool hasPoints() const { return !studies.empty(); }
    bool has(const char* study) const { return studies.count(study) > 0; }
};

void addFlags(CLI::App& app, BenchFlags& flags)
{
    app.add_option("IN", flags.input.path, "point file; or use --scene")->check(notEmpty());
    app.add_option("--scene", flags.sceneName, "make this scene instead of reading a file")
        ->type_name("NAME")
        ->check(notEmpty());
    addSceneFlags(app, flags.scene);
    addInputFlags(app, flags.input, true);
    app.add_option("--method", flags.methods,
                   "methods, separated by commas; default: those that suit. " + methodHelp())
        ->type_name("LIST")
        ->check(notEmpty());
    addDeviceTargetFlags(app, flags.device);
    app.add_option(
           "--study", flags.studies,
           "what to look at, separated by commas: methods, estimators, budgets (memory of a device), "
           "resolution "
           "(cell sizes), scaling (particles, threads, radius, clustering), model (what planning takes and "
           "saves), files (reading, writing and whole commands), "
           "radii (of particles, against the largest one, octaves and K nearest), nearest (K within the "
           "radius, against full lists cut afterwards), measures (density, normal and pca made in several "
           "ways: error against time), or all; default: methods, with --chart all")
        ->type_name("LIST")
        ->check(notEmpty());
    app.add_flag(
        "--stability", flags.stability,
        "every method against cases where methods fail, each in a process of its own; needs no points");
    app.add_option(
           "--estimator", flags.estimators,
           "estimators of the work, separated by commas, against a full count: "
           "paper,uncorrected,expected,sampled,counted,fixed,mask, paper:SAMPLES, sampled:PERCENT or all; "
           "default: none, with --study estimators all")
        ->type_name("LIST")
        ->check(notEmpty());
    app.add_option("--repeat", flags.repeat, "timed runs of each method, interleaved, after one warm-up")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--sample", flags.sample,
                   "queries compared with the truth; auto: all where that takes seconds, else 1000; 0: none")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--shuffle", flags.shuffleSeed, "put the particles in random order first")
        ->type_name("SEED")
        ->check(notEmpty());
    app.add_option("--points-out", flags.pointsOut, "write the points searched as raw float32 x y z triples")
        ->type_name("FILE")
        ->check(notEmpty());
    app.add_option("--csv", flags.csv,
                   "write the results of the methods, of --study radii,nearest or of --study measures as CSV")
        ->type_name("FILE")
        ->check(notEmpty());
    app.add_option("--chart", flags.chart, "write charts as a page of HTML; needs Python with matplotlib")
        ->type_name("FILE")
        ->check(notEmpty());
    addEngineFlags(app, flags.engine);
    app.get_option("--host-memory")
        ->description(
            "memory for the points when they are read, and for grid and lists of each method (KB MB "
            "GB: powers of 1000; K M G T KiB MiB GiB: of 1024); default: what is free, less a reserve");
    addCommonFlags(app, flags.common);
}

std::set<std::string> parseStudies(const BenchFlags& flags)
{
    const std::set<std::string> all(std::begin(kStudies), std::end(kStudies));
    const bool hasPoints = !flags.input.path.empty() || !flags.sceneName.empty();
    if (flags.studies.empty()) {
        if (!hasPoints) return {};
        std::set<std::string> studies{"methods"};
        if (!flags.estimators.empty()) studies.insert("estimators");
        return flags.chart.empty() ? studies : all;
    }
    if (flags.studies == "all") return all;
    std::set<std::string> studies;
    std::istringstream parts(flags.studies);
    for (std::string name; std::getline(parts, name, ',');) {
        if (!all.count(name)) {
            std::string known;
            for (const char* each : kStudies) known += std::string(each) + ", ";
            throw InvalidInput("--study: '" + name + "' is none; there are " + known + "or all");
        }
        studies.insert(name);
    }
    return studies;
}

void checkInput(const BenchFlags& flags, BenchPlan& plan)
{
    const bool hasFile = !flags.input.path.empty(), hasScene = !flags.sceneName.empty();
    if (hasFile && hasScene) throw InvalidInput("bench needs a point file or --scene NAME, one of them");
    if (!hasFile && !hasScene && (plan.hasPoints() || !flags.stability)) {
        throw InvalidInput(
            "bench needs a point file or --scene NAME; or --stability, which brings its own points");
    }
    if (hasScene) {
        if (!flags.input.grid.empty())
            throw InvalidInput("--grid is for a .vdb file, and --scene makes no grid");
        plan.scene = sceneOptions(flags.sceneName, flags.scene);
    } else {
        for (const char* flag : kSceneFlags) {
            if (flags.given.count(flag))
                throw InvalidInput(std::string(flag) + " is for --scene; a file has the points it has");
        }
    }
    std::set<std::string> studies = plan.studies;
    if (flags.stability) studies.insert("stability");
    checkStudyFlags(flags.given, studies);
    const bool hasSets = studies.count("radii") + studies.count("nearest") > 0;
    if (!flags.csv.empty() && studies.count("methods") + hasSets + studies.count("measures") > 1) {
        throw InvalidInput(
            "--csv is one table, that of --study methods, that of radii and nearest or that of measures: ask "
            "for them one after the other, or take --json");
    }
}

void checkFiles(const BenchFlags& flags)
{
    std::vector<std::string> outputs, inputs;
    for (const std::string& path : {flags.csv, flags.chart, flags.pointsOut}) {
        if (!path.empty()) outputs.push_back(path);
    }
    if (!flags.input.path.empty()) inputs.push_back(flags.input.path);
    for (const std::string& output : outputs) checkNotInput(output, inputs);
    checkOutputs(outputs, inputs, flags.common);
}

// The device that --device names, or nothing.
std::string namedDevice(const BenchFlags& flags)
{
    const bool isNamed = flags.device.device != "auto" && flags.device.device != "cpu";
    return isNamed ? flags.device.device : "";
}

// The same, and CUDA devices where they are and nothing was named.
std::string suitingDevice(const BenchFlags& flags, int threads)
{
    if (flags.device.device != "auto" || !flags.methods.empty()) return namedDevice(flags);
    return deviceOptions(flags.device, threads).devices.empty() ? "" : "cuda";
}

BenchPlan checkFlags(const BenchFlags& flags)
{
    BenchPlan plan;
    plan.studies = parseStudies(flags);
    checkInput(flags, plan);
    if (!flags.input.radius.empty()) plan.radius = parsePositive(flags.input.radius, "--radius");
    plan.methods = flags.methods;
    const std::vector<MethodSpec> methods = parseMethods(flags.methods, {namedDevice(flags), 0});
    if (plan.has("methods")) checkDeviceFlags(flags.device, methods);
    plan.estimators = parseEstimators(flags.estimators.empty() ? "all" : flags.estimators);
    plan.options = searchOptions(flags.engine, nullptr);
    plan.repeat = parseCount(flags.repeat, "--repeat");
    if (plan.repeat == 0) throw InvalidInput("--repeat: 0 runs are none; give 1 or more");
    if (flags.sample != "auto") plan.truth.sample = parseCount(flags.sample, "--sample");
    plan.truth.seed = parseCount(flags.scene.seed, "--seed");
    if (!flags.shuffleSeed.empty()) plan.shuffleSeed = parseCount(flags.shuffleSeed, "--shuffle");
    plan.threads = threadCount(flags.common);
    checkFiles(flags);
    return plan;
}

BenchPoints loadPoints(const BenchFlags& flags, const BenchPlan& plan, ProgressPrinter& progress)
{
    const bool asFloats = plan.shuffleSeed || !flags.pointsOut.empty();
    const PointFileOptions file = pointFileOptions(flags.input, plan.options.hostMemoryBytes, &progress);
    BenchPoints points = plan.scene ? sceneBenchPoints(*plan.scene, &progress)
                                    : fileBenchPoints(flags.input.path, file, asFloats);
    if (plan.shuffleSeed) shuffle(points, *plan.shuffleSeed);
    if (!flags.pointsOut.empty()) {
        const std::vector<float>& xyz = *points.positions;
        writeFile(flags.pointsOut, xyz.data(), xyz.size() * sizeof(float), outputOptions(flags.common));
    }
    return points;
}

void deliver(const BenchFlags& flags, const BenchReport& report)
{
    if (!flags.csv.empty()) {
        std::vector<SetResult> sets = report.radii;
        sets.insert(sets.end(), report.nearest.begin(), report.nearest.end());
        const std::string csv = !report.measures.empty() ? measureResultsCsv(report.measures)
                                : sets.empty()           ? benchCsv(report.results)
                                                         : setResultsCsv(sets);
        writeFile(flags.csv, csv.data(), csv.size(), outputOptions(flags.common));
    }
    const std::string json = benchJson(report);
    deliverJson(flags.common.json, json, outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(benchText(report));
    std::exception_ptr noChart; // a wrong answer of ours matters more
    try {
        if (!flags.chart.empty()) writeChart(flags.chart, json, outputOptions(flags.common));
    } catch (const OutputError&) {
        noChart = std::current_exception();
    }
    requireRight(report);
    if (noChart) std::rethrow_exception(noChart);
}

// Methods whose growth is charted: ours, what float32 in world coordinates does, and a peer of grids.
std::vector<MethodSpec> growingMethods(const MethodSuits& suits)
{
    std::vector<MethodSpec> specs = parseMethods("ours-index,ours-mask,world-float", suits);
    for (const MethodSpec& peer : parseMethods("peers", suits)) {
        if (peer.family == "openvdb") specs.push_back(peer);
    }
    return specs;
}

// Runs the studies, each in its share of the progress.
class Bench {
public:
    Bench(const BenchFlags& flags, const BenchPlan& plan, const BenchPoints& points, double radius,
          int threads, ProgressPrinter& progress)
        : mFlags(flags),
          mPlan(plan),
          mPoints(points),
          mRadius(radius),
          mThreads(threads),
          mProgress(progress),
          mSuits{suitingDevice(flags, threads), points.view.size()},
          mSetup{plan.options, plan.devices, points.voxelSize.value_or(radius)}
    {
        mSetup.options.progress = &progress;
        mModelSetup = mSetup;
        mModelSetup.devices = plan.modelDevices;
    }

    void run(BenchReport& report)
    {
        double from = 0.1;
        const double share = 0.9 / static_cast<double>(mPlan.studies.size());
        for (const char* study : kStudies) {
            if (!mPlan.has(study)) continue;
            runStudy(study, {mProgress, from, from + share}, report);
            from += share;
        }
    }

private:
    void runStudy(const std::string& study, const ProgressSpan& span, BenchReport& report)
    {
        span.printer.begin(study.c_str(), span.begin, span.end);
        if (study == "methods") {
            const ProgressSpan first = span.part(0, 10);
            span.printer.begin("truth", first.begin, first.end);
            const Truth truth = findTruth(mPoints.view, mRadius, truthOptions());
            report.results = studyMethods(mPoints, truth, methodOptions(parseMethods(mPlan.methods, mSuits)),
                                          {span.printer, first.end, span.end});
            setLowerBounds(report.results);
        } else if (study == "estimators") {
            SearchOptions options = mSetup.options;
            options.wideCells = false; // estimates are for devices
            const SparseGrid grid = SearchEngine().buildGrid(mPoints.view, mRadius, options);
            report.estimators =
                measureEstimators(mPoints.scene, mPlan.estimators, grid, mPlan.repeat, &mProgress);
        } else if (study == "budgets") {
            report.budgets = studyBudgets(mPoints, {mModelSetup, mRadius, mPlan.repeat}, span);
        } else if (study == "resolution") {
            report.resolution = studyResolution(mPoints, {mSetup.options, mRadius, mPlan.repeat}, span);
        } else if (study == "scaling") {
            report.scaling =
                studyScaling(mPoints, methodOptions(growingMethods(mSuits)), truthOptions(), span);
        } else if (study == "radii") {
            report.radii = studyRadii(mPoints, setOptions(), span);
        } else if (study == "nearest") {
            report.nearest = studyNearest(mPoints, setOptions(), span);
        } else if (study == "measures") {
            report.measures = studyMeasures(
                mPoints, {mSetup.options, mRadius, mSetup.voxelSize, mPlan.repeat, truthOptions()}, span);
        } else if (study == "files") {
            report.files = {studyFiles(mPoints.scene, fileOptions(), span)};
        } else {
            report.model = studyModel(mPoints, {mModelSetup, mRadius, mPlan.repeat}, span);
        }
    }

    TruthOptions truthOptions() const
    {
        TruthOptions options = mPlan.truth;
        options.progress = &mProgress;
        return options;
    }

    SetStudyOptions setOptions() const
    {
        SetStudyOptions options;
        options.search = mSetup.options;
        options.radius = mRadius;
        options.repeat = mPlan.repeat;
        options.seed = mPlan.truth.seed;
        options.truth = truthOptions();
        return options;
    }

    // Of the file, or of a scene in one.
    FileStudyOptions fileOptions()
    {
        FileStudyOptions options;
        options.path = mFlags.input.path;
        options.input = pointFileOptions(mFlags.input, mSetup.options.hostMemoryBytes, &mProgress);
        for (const auto& [flag, value] : {std::pair<const char*, std::string>("-g", mFlags.input.grid),
                                          {"--columns", mFlags.input.columns},
                                          {"--array", mFlags.input.array}}) {
            if (!value.empty()) options.inputFlags.insert(options.inputFlags.end(), {flag, value});
        }
        options.search = mSetup.options;
        options.radius = mRadius;
        options.threads = mThreads;
        options.repeat = mPlan.repeat;
        if (!mPlan.scene) return options;
        mFolder.emplace();
        options.path = mFolder->file(mPlan.scene->name + ".vdb");
        writeScene(options.path, makeScene(*mPlan.scene, &mProgress), *mPlan.scene, {}, &mProgress);
        return options;
    }

    MethodStudyOptions methodOptions(std::vector<MethodSpec> methods) const
    {
        return {std::move(methods), mSetup, mRadius, mThreads, mPlan.repeat};
    }

    const BenchFlags& mFlags;
    const BenchPlan& mPlan;
    const BenchPoints& mPoints;
    double mRadius;
    int mThreads;
    ProgressPrinter& mProgress;
    MethodSuits mSuits;
    MethodSetup mSetup, mModelSetup;
    std::optional<TemporaryFolder> mFolder;
};

void runStudies(const BenchFlags& flags, const BenchPlan& plan, int threads, ProgressPrinter& progress,
                Session& session, BenchReport& report)
{
    progress.begin("points", 0, 0.1);
    const BenchPoints points = loadPoints(flags, plan, progress);
    session.path = plan.scene ? "scene " + points.scene : flags.input.path;
    const double radius =
        chooseRadius(flags.input.radius, points.suggestedRadius, session.path, flags.common.quiet);
    report.link = measureLink(plan.devices.request.devices);
    Bench(flags, plan, points, radius, threads, progress).run(report);
}

// Of studies that plan for a device where no method runs on one.
BenchDevices modelDevices(const BenchFlags& flags, const BenchPlan& plan, int threads)
{
    if (!plan.has("budgets") && !plan.has("model")) return {};
    if (!plan.devices.request.devices.empty()) return plan.devices;
    DeviceFlags device = flags.device;
    if (namedDevice(flags).empty()) device.device = "sim";
    return benchDevices(device, parseMethods("blocks-mask", {}), threads);
}

int runBenchCommand(const BenchFlags& flags, Session& session)
{
    BenchPlan plan = checkFlags(flags);
    if (!flags.chart.empty()) {
        const std::string missing = missingForCharts();
        if (!missing.empty()) say("no charts: " + missing);
    }
    ProgressPrinter progress(progressMode(flags.common));
    BenchReport report;
    if (flags.stability) { // before there are threads: it forks
        StabilityOptions options;
        options.methods = flags.methods.empty() ? stabilityMethods() : parseMethods(flags.methods, {});
        options.threads = plan.threads;
        options.progress = &progress;
        report.stability = runStability(options);
    }
    ThreadLimit threads(plan.threads);
    report.threads = threads.count();
    if (plan.hasPoints()) {
        if (plan.has("methods"))
            plan.devices = benchDevices(
                flags.device, parseMethods(plan.methods, {suitingDevice(flags, threads.count()), 0}),
                threads.count());
        plan.modelDevices = modelDevices(flags, plan, threads.count());
        threads.run([&] { runStudies(flags, plan, threads.count(), progress, session, report); });
    }
    throwIfStopped();
    progress.finish();
    deliver(flags, report);
    return kDone;
}

} // namespace

Command addBenchCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("bench", "speed and accuracy of every method side by side");
    const auto flags = std::make_shared<BenchFlags>();
    addFlags(*command, *flags);
    return {command, [command, flags](Session& session) {
                for (const CLI::Option* option : command->get_options()) {
                    if (option->count() > 0) flags->given.insert(option->get_name());
                }
                return runBenchCommand(*flags, session);
            }};
}

} // namespace vdb_nns::cli
