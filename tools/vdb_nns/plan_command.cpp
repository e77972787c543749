// vdb_nns plan: a dry run of a search: grid, estimate, workload tree and schedule, drawn and reported.
#include "attribute_output.h"
#include "cli_options.h"
#include "command.h"
#include "device_options.h"
#include "exit_codes.h"
#include "machine.h"
#include "measure_options.h"
#include "plan_svg.h"
#include "point_input.h"
#include "query_options.h"
#include "report.h"
#include "search_progress.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"
#include "vdb_nns/search_job.h"
#include "vdb_nns/tiles.h"

#include <algorithm>
#include <filesystem>
#include <memory>
#include <utility>

namespace vdb_nns::cli {
namespace {

struct PlanFlags {
    CommonFlags common;
    InputFlags input;
    QueryFlags query;
    MeasureFlags measure;
    EngineFlags engine;
    DeviceFlags device;
    std::vector<std::string> outputs;
    std::string encoding = "mask", nonfinite = "skip", svg, tiles;
    bool givesEncoding = false; // whether the flag is there
};

// Flags after all that can be checked before reading.
struct PlannedSearch {
    JobOptions job;
    QueryPlan query;
    MeasurePlan measure;
    std::uint32_t tiles = 0; // 0: not asked for
};

void addFlags(CLI::App& app, PlanFlags& flags)
{
    app.add_option("IN", flags.input.path, kInputHelp)->required()->check(notEmpty());
    addInputFlags(app, flags.input, true);
    addQueryFlags(app, flags.query);
    addMeasureFlags(app, flags.measure, "none");
    app.add_option(
           "-o,--output", flags.outputs,
           "an output of the search (.npz, .vdb, .ply), for the memory that a .vdb of the measures takes to "
           "be written; nothing is written; may be repeated")
        ->type_name("OUT")
        ->type_size(1)
        ->allow_extra_args(false)
        ->check(notEmpty());
    addDeviceFlags(app, flags.device);
    addEngineFlags(app, flags.engine);
    app.add_option("--encoding", flags.encoding, "how lists would be held: index or mask")
        ->type_name("NAME")
        ->check(CLI::IsMember({"index", "mask"}))
        ->capture_default_str();
    app.add_option("--nonfinite", flags.nonfinite,
                   "what to do with points that have a NaN or infinite coordinate: skip or fail")
        ->type_name("HOW")
        ->check(CLI::IsMember({"skip", "fail"}))
        ->capture_default_str();
    app.add_option("--tiles", flags.tiles,
                   "show N ranges of leaves of equal work, which `search --tile K/N` finds the rows of")
        ->type_name("N")
        ->check(notEmpty());
    app.add_option("--svg", flags.svg, "draw the blocks as a projection, colored by who would run them")
        ->type_name("FILE")
        ->check(notEmpty());
    addCommonFlags(app, flags.common);
    app.get_option("--threads")
        ->description(
            "threads that make the plan; 0: all. The plan itself is for all threads of the machine");
}

// As a search takes them: counts come from the lists.
void checkMeasures(const PlanFlags& flags, PlannedSearch& plan)
{
    plan.measure = checkMeasureFlags(flags.measure, plan.query);
    const std::string& rows = flags.query.queries.empty() ? flags.input.path : flags.query.queries;
    plan.job.written = writtenKinds(flags.outputs, rows);
    if (plan.measure.names.empty()) {
        checkMeasureUse(flags.measure, {});
        if (!flags.outputs.empty())
            throw InvalidInput(
                "-o says where measures would go, and there are none: name some by --attributes");
    }
    if (!plan.measure.isCountAlone()) plan.job.measures = plan.measure.names;
}

// Everything that can be wrong without reading a byte.
PlannedSearch checkFlags(const PlanFlags& flags)
{
    PlannedSearch plan;
    if (!flags.input.radius.empty()) parsePositive(flags.input.radius, "--radius");
    if (!flags.tiles.empty())
        plan.tiles = static_cast<std::uint32_t>(parseRange(flags.tiles, "--tiles", 1, kMostTiles));
    const QueryPlan& query = plan.query = checkQueryFlags(flags.query, flags.input);
    checkMeasures(flags, plan);
    SearchOptions& options = plan.job.search = searchOptions(flags.engine, nullptr);
    options.nearest = query.nearest;
    options.includeSelf = query.includeSelf;
    options.encoding = flags.encoding == "index" ? Encoding::kIndex : Encoding::kMask;
    if (query.nearest > 0 && flags.encoding == "mask" && flags.givesEncoding) {
        throw InvalidInput("--encoding mask and --nearest do not go together: masks hold whole lists; use "
                           "--encoding index");
    }
    if (query.nearest > 0) options.encoding = Encoding::kIndex;
    if (!flags.svg.empty() && !query.isPlain()) {
        throw InvalidInput(
            "--svg draws blocks, and searches of queries, groups, radii of points or the nearest "
            "have none: leave it out");
    }
    std::vector<std::string> inputs = queryFiles(flags.query), outputs;
    inputs.push_back(flags.input.path);
    if (!flags.svg.empty()) checkNotInput(flags.svg, inputs);
    if (!flags.svg.empty()) outputs.push_back(flags.svg);
    checkOutputs(outputs, inputs, flags.common);
    return plan;
}

void fillReport(const SearchSets& sets, const SearchOptions& options, SearchReport& report)
{
    fillGridReport(sets, options, report);
    report.encoding = options.encoding;
    report.simd = simdLevelName(bestSimdLevel());
    report.candidateTests = report.plan->total.candidateTests;
}

void deliver(const PlanFlags& flags, const SparseGrid& grid, SearchReport& report)
{
    if (!flags.svg.empty()) {
        const Stopwatch watch;
        const std::string scene = std::filesystem::path(flags.input.path).filename().string();
        const std::string svg = planSvg(grid, *report.plan, scene);
        writeFile(flags.svg, svg.data(), svg.size(), outputOptions(flags.common));
        report.written.push_back(flags.svg);
        report.seconds.write = watch.seconds();
    }
}

// A plan is the same whatever --threads it is made with.
int plannedThreads()
{
    return tbb::info::default_concurrency();
}

int planFile(const PlanFlags& flags, const PlannedSearch& plan, int threads, Session& session)
{
    const QueryPlan& query = plan.query;
    JobOptions options = plan.job;
    const Stopwatch total;
    ProgressPrinter progress(progressMode(flags.common));
    SearchReport report;
    report.command = "plan";
    report.device.threads = threads;
    const PointNeeds needs{!flags.common.json.empty(), flags.nonfinite == "fail", flags.common.quiet,
                           options.search.hostMemoryBytes, query.hasRadii};
    const QueryInput input =
        readQuerySets(flags.input, flags.query, query, needs, {progress, 0, 0.4}, session, report);
    const MeasureInput measured = readMeasureInput(input.candidates, plan.measure, &progress);
    options.measure = optionsOf(plan.measure, measured);

    SearchEngine engine;
    SearchProgress steps({progress, 0.4, 1});
    options.search.progress = &steps;
    JobPlan planned =
        engine.planJob(input.candidateSet(), input.querySet(), input.radius(report.radius), options);
    if (query.hasRadii) report.radius = planned.sets.radius();
    report.seconds.grid = report.seconds.firstGrid = planned.gridSeconds;
    report.seconds.estimate = planned.plan.estimateSeconds;
    report.seconds.plan = planned.plan.planSeconds;
    report.plan = std::move(planned.plan);
    if (plan.tiles > 0) {
        const ParticleView& rows = (input.queries ? *input.queries : input.candidates).view();
        report.tiles = TileCut(rows, input.largestRadius(report.radius), plan.tiles, &progress).tiles();
    }
    if (!plan.measure.names.empty()) report.measureBytes = planned.measureBytes;
    fillReport(planned.sets, options.search, report);
    throwIfStopped();
    deliver(flags, planned.grid, report);
    progress.finish();
    report.peakBytes = peakMemoryBytes();
    report.seconds.total = total.seconds();

    if (flags.common.verbose) {
        say(format(
            "made with --threads %d, %s; the plan is for all %d threads that there are, taken to make %.3g "
            "tests a second together; index lists get %.1f %% and %.2g neighbors a particle beyond their "
            "estimate",
            threads, report.simd.c_str(), plannedThreads(), options.device.schedule.cpuTestsPerSecond,
            100 * report.plan->schedule.model.margin, report.plan->schedule.model.auxNeighbors));
    }
    if (!flags.common.json.empty())
        deliverJson(flags.common.json, searchReportJson(report), outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(planReportText(report));
    return kDone;
}

int runPlanCommand(const PlanFlags& flags, Session& session)
{
    const int wanted = threadCount(flags.common);
    PlannedSearch plan = checkFlags(flags);
    ThreadLimit threads(wanted);
    plan.job.device = deviceOptions(deviceFor(flags.device, plan.query), plannedThreads());
    return threads.run([&] { return planFile(flags, plan, threads.count(), session); });
}

} // namespace

Command addPlanCommand(CLI::App& app)
{
    CLI::App* command =
        app.add_subcommand("plan", "show how a search would be cut into blocks, and who would run them");
    const auto flags = std::make_shared<PlanFlags>();
    addFlags(*command, *flags);
    return {command, [command, flags](Session& session) {
                flags->givesEncoding = command->count("--encoding") > 0;
                return runPlanCommand(*flags, session);
            }};
}

} // namespace vdb_nns::cli
