// vdb_nns plan: a dry run of a search: grid, estimate, workload tree and schedule, drawn and reported.
#include "cli_options.h"
#include "command.h"
#include "device_options.h"
#include "exit_codes.h"
#include "machine.h"
#include "plan_svg.h"
#include "point_input.h"
#include "report.h"
#include "search_progress.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"
#include "vdb_nns/search_job.h"

#include <algorithm>
#include <filesystem>
#include <memory>
#include <utility>

namespace vdb_nns::cli {
namespace {

struct PlanFlags {
    CommonFlags common;
    InputFlags input;
    EngineFlags engine;
    DeviceFlags device;
    std::string encoding = "mask", nonfinite = "skip", svg;
};

void addFlags(CLI::App& app, PlanFlags& flags)
{
    app.add_option("IN", flags.input.path, kInputHelp)->required()->check(notEmpty());
    addInputFlags(app, flags.input, true);
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
    app.add_option("--svg", flags.svg, "draw the blocks as a projection, colored by who would run them")
        ->type_name("FILE")
        ->check(notEmpty());
    addCommonFlags(app, flags.common);
    app.get_option("--threads")
        ->description(
            "threads that make the plan; 0: all. The plan itself is for all threads of the machine");
}

// Everything that can be wrong without reading a byte.
SearchOptions checkFlags(const PlanFlags& flags)
{
    if (!flags.input.radius.empty()) parsePositive(flags.input.radius, "--radius");
    SearchOptions options = searchOptions(flags.engine, nullptr);
    options.encoding = flags.encoding == "index" ? Encoding::kIndex : Encoding::kMask;
    if (!flags.svg.empty()) checkNotInput(flags.svg, {flags.input.path});
    std::vector<std::string> outputs;
    if (!flags.svg.empty()) outputs.push_back(flags.svg);
    checkOutputs(outputs, {flags.input.path}, flags.common);
    return options;
}

void fillReport(const SparseGrid& grid, const SearchOptions& options, SearchReport& report)
{
    fillGridReport(grid, options, report);
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

int planFile(const PlanFlags& flags, JobOptions options, int threads, Session& session)
{
    const Stopwatch total;
    ProgressPrinter progress(progressMode(flags.common));
    SearchReport report;
    report.command = "plan";
    report.device.threads = threads;
    const PointNeeds needs{!flags.common.json.empty(), flags.nonfinite == "fail", flags.common.quiet,
                           options.search.hostMemoryBytes};
    const PointFile file = readPoints(flags.input, needs, {progress, 0, 0.4}, session, report);

    SearchEngine engine;
    SearchProgress steps({progress, 0.4, 1});
    options.search.progress = &steps;
    JobPlan planned = engine.planJob(file.view(), report.radius, options);
    const SparseGrid& grid = planned.grid;
    report.seconds.grid = report.seconds.firstGrid = planned.gridSeconds;
    report.seconds.estimate = planned.plan.estimateSeconds;
    report.seconds.plan = planned.plan.planSeconds;
    report.plan = std::move(planned.plan);
    fillReport(grid, options.search, report);
    throwIfStopped();
    deliver(flags, grid, report);
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
    JobOptions options;
    options.search = checkFlags(flags);
    ThreadLimit threads(wanted);
    options.device = deviceOptions(flags.device, plannedThreads());
    return threads.run([&] { return planFile(flags, options, threads.count(), session); });
}

} // namespace

Command addPlanCommand(CLI::App& app)
{
    CLI::App* command =
        app.add_subcommand("plan", "show how a search would be cut into blocks, and who would run them");
    const auto flags = std::make_shared<PlanFlags>();
    addFlags(*command, *flags);
    return {command, [flags](Session& session) { return runPlanCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
