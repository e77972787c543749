// vdb_nns search: reads particles, finds neighbors, writes lists and attributes, reports.
#include "command.h"
#include "exit_codes.h"
#include "search_flags.h"
#include "search_frames.h"
#include "search_run.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <memory>

namespace vdb_nns::cli {
namespace {

int searchFile(const SearchFlags& flags, const SearchPlan& plan, int threads, Session& session)
{
    ProgressPrinter progress(progressMode(flags.common));
    SearchEngine engine;
    SearchRun run(flags, plan, threads, session);
    run.read(progress);
    run.find(engine, progress);
    run.write(progress);
    progress.finish();
    const SearchReport& report = run.report();
    if (flags.common.verbose) {
        say(countText(static_cast<std::uint64_t>(threads)) + " threads, " + report.simd + "; " +
            countText(report.doublePairs) + " pairs went to the double test, " +
            countText(report.exactPairs) + " to exact arithmetic");
    }
    if (!flags.common.json.empty())
        deliverJson(flags.common.json, searchReportJson(report), outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(searchReportText(report));
    return kDone;
}

int runSearchCommand(const SearchFlags& flags, Session& session)
{
    if (!flags.frames.empty()) return searchFrames(flags, session);
    if (flags.skipExisting) throw InvalidInput("--skip-existing is about frames; give --frames RANGE");
    SearchPlan plan = checkSearchFlags(flags);
    ThreadLimit threads(plan.threads);
    const DeviceFlags device = deviceFor(flags.device, plan.query);
    plan.job.device = deviceOptions(device, threads.count());
    return threads.run([&] { return searchFile(flags, plan, threads.count(), session); });
}

} // namespace

Command addSearchCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("search", "find the neighbors of all particles of a file");
    const auto flags = std::make_shared<SearchFlags>();
    addSearchFlags(*command, *flags);
    return {command, [flags](Session& session) { return runSearchCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
