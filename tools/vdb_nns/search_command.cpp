// vdb_nns search: reads particles, finds neighbors, writes lists and attributes, reports.
#include "attribute_output.h"
#include "cli_options.h"
#include "command.h"
#include "device_options.h"
#include "exit_codes.h"
#include "machine.h"
#include "measure_options.h"
#include "numbers.h"
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
#include "vdb_nns/version.h"
#include "vdb_nns/write_points.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <tbb/combinable.h>

namespace vdb_nns::cli {
namespace {

struct SearchFlags {
    CommonFlags common;
    InputFlags input;
    QueryFlags query;
    MeasureFlags measure;
    EngineFlags engine;
    std::vector<std::string> outputs;
    std::string attributesOutput, voxelSize, keep = "all";
    bool givesKeep = false; // whether the flag is there
    DeviceFlags device;
    std::string encoding, lists = "connectivity";
    std::string repeat = "1", nonfinite = "skip";
    bool checksum = false;
};

// Flags after all that can be checked before reading.
struct SearchPlan {
    std::optional<double> radius; // else the file's suggestion
    JobOptions job;
    QueryPlan query;
    MeasurePlan measure;
    AttributeOutputs attributes;
    std::optional<double> voxelSize; // of a new .vdb; else the radius
    int threads = 0;

    bool writesAttributes() const { return !attributes.points.empty() || !attributes.arrays.empty(); }
    std::uint64_t repeat = 1;
};

void addFlags(CLI::App& app, SearchFlags& flags)
{
    app.add_option("IN", flags.input.path, kInputHelp)->required()->check(notEmpty());
    app.add_option("-o,--output", flags.outputs,
                   "write neighbor lists (.npz) or the points with result attributes (.vdb, .ply); may be "
                   "repeated")
        ->type_name("OUT")
        ->type_size(1)
        ->allow_extra_args(false)
        ->check(notEmpty());
    addInputFlags(app, flags.input, true);
    addQueryFlags(app, flags.query);
    flags.measure.attributes = "count";
    addMeasureFlags(app, flags.measure);
    app.add_option("--attributes-output", flags.attributesOutput,
                   "write the result attributes alone as named arrays (.npz)")
        ->type_name("FILE")
        ->check(notEmpty());
    app.add_option("--voxel-size", flags.voxelSize,
                   "voxel edge of a .vdb of points that were none, in world units; default: the radius")
        ->type_name("SIZE")
        ->check(notEmpty());
    app.add_option(
           "--keep", flags.keep,
           "attributes and groups of a .vdb, properties of a .ply, arrays of an .npz to copy into a .ply or "
           "a new .vdb: all, none, or names separated by commas")
        ->type_name("LIST")
        ->check(notEmpty())
        ->capture_default_str()
        ->each([&flags](const std::string&) { flags.givesKeep = true; });
    addDeviceFlags(app, flags.device);
    addEngineFlags(app, flags.engine);
    app.add_option("--encoding", flags.encoding,
                   "how lists are held: index, mask or none; default: what the outputs need, or mask if "
                   "index lists do not fit. Rows that only one .npz wants go straight to the file if "
                   "particles are numbered along space, or if neither fits")
        ->type_name("NAME")
        ->check(CLI::IsMember({"index", "mask", "none"}));
    app.add_option("--lists", flags.lists, "values of an .npz: connectivity (ones) or distance")
        ->type_name("VALUES")
        ->check(CLI::IsMember({"connectivity", "distance"}))
        ->capture_default_str();
    app.add_flag("--checksum", flags.checksum, "report the checksum of all pairs");
    app.add_option("--repeat", flags.repeat, "search N times and report medians")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--nonfinite", flags.nonfinite,
                   "what to do with points that have a NaN or infinite coordinate: skip or fail")
        ->type_name("HOW")
        ->check(CLI::IsMember({"skip", "fail"}))
        ->capture_default_str();
    addCommonFlags(app, flags.common);
}

void checkOutputKinds(const SearchFlags& flags, SearchPlan& plan)
{
    const std::string& rows = flags.query.queries.empty() ? flags.input.path : flags.query.queries;
    plan.job.written = writtenKinds(flags.outputs, rows);
    const bool hasNewGrid = plan.job.written.newGrid;
    for (const std::string& path : flags.outputs) {
        if (extensionOf(path) != ".npz") plan.attributes.points.push_back(path);
    }
    plan.attributes.arrays = flags.attributesOutput;
    if (!flags.attributesOutput.empty() && extensionOf(flags.attributesOutput) != ".npz")
        throw InvalidInput("--attributes-output: " + flags.attributesOutput +
                           " has another extension than .npz, the format of named arrays");
    if (!flags.voxelSize.empty()) {
        plan.voxelSize = parsePositive(flags.voxelSize, "--voxel-size");
        if (!hasNewGrid)
            throw InvalidInput(
                "--voxel-size is that of a new .vdb: there is none where the points come from a "
                ".vdb, whose voxels stay, or no .vdb is written; leave it out");
    }
    const auto isPly = [](const std::string& path) { return extensionOf(path) == ".ply"; };
    const bool hasPly = std::any_of(flags.outputs.begin(), flags.outputs.end(), isPly);
    if (flags.givesKeep && !hasPly && !hasNewGrid)
        throw InvalidInput(
            "--keep is about a .ply or a new .vdb of the points, and there is none; a .vdb that the "
            "points come from is copied with all that it has; leave it out");
    if (plan.job.written.npz && flags.encoding == "none") {
        throw InvalidInput(
            "--encoding none keeps no lists, and an .npz output needs them; use index or mask");
    }
}

// Counts come from the lists; other measures take a pass that makes them.
void checkMeasures(const SearchFlags& flags, SearchPlan& plan)
{
    plan.measure = checkMeasureFlags(flags.measure, plan.query);
    if (plan.measure.names.empty()) throw InvalidInput("--attributes: '' names none; leave it out for count");
    if (plan.measure.isCountAlone()) return;
    if (!plan.writesAttributes())
        throw InvalidInput("--attributes: nothing is written that could hold " + flags.measure.attributes +
                           "; add -o FILE.vdb, -o FILE.ply or --attributes-output FILE.npz");
    plan.job.measures = plan.measure.names;
}

Encoding chooseEncoding(const SearchFlags& flags, const SearchPlan& plan)
{
    if (flags.encoding == "index") return Encoding::kIndex;
    if (flags.encoding == "mask") return Encoding::kMask;
    if (flags.encoding == "none") return Encoding::kNone;
    if (plan.job.written.npz) return Encoding::kIndex;
    if (!flags.checksum) return Encoding::kNone;
    return plan.query.nearest > 0 ? Encoding::kIndex : Encoding::kMask;
}

ListForm listForm(const SearchFlags& flags, const SearchPlan& plan)
{
    return {flags.lists == "distance" ? ListValues::kDistance : ListValues::kConnectivity,
            plan.query.byDistance ? RowOrder::kDistance : RowOrder::kNumber};
}

// The file that is written while its rows are found: where nobody else wants the lists, and no search is repeated to be timed.
std::optional<NpzTarget> targetOf(const SearchFlags& flags, const SearchPlan& plan)
{
    const auto isNpz = [](const std::string& path) { return extensionOf(path) == ".npz"; };
    const auto count = std::count_if(flags.outputs.begin(), flags.outputs.end(), isNpz);
    if (count != 1 || plan.repeat > 1 || !flags.encoding.empty()) return std::nullopt;
    NpzTarget target;
    target.path = *std::find_if(flags.outputs.begin(), flags.outputs.end(), isNpz);
    target.form = listForm(flags, plan);
    target.output = outputOptions(flags.common);
    target.checksum = flags.checksum || !flags.common.json.empty();
    return target;
}

// Everything that can be wrong without reading a byte.
SearchPlan checkFlags(const SearchFlags& flags)
{
    SearchPlan plan;
    if (!flags.input.radius.empty()) plan.radius = parsePositive(flags.input.radius, "--radius");
    plan.query = checkQueryFlags(flags.query, flags.input);
    plan.job.search = searchOptions(flags.engine, nullptr);
    plan.job.search.nearest = plan.query.nearest;
    plan.job.search.includeSelf = plan.query.includeSelf;
    if (plan.query.nearest > 0 && flags.encoding == "mask") {
        throw InvalidInput("--encoding mask and --nearest do not go together: masks hold whole lists; use "
                           "--encoding index");
    }
    plan.threads = threadCount(flags.common);
    plan.repeat = parseCount(flags.repeat, "--repeat");
    if (plan.repeat == 0) throw InvalidInput("--repeat: 0 runs are none; give 1 or more");
    checkOutputKinds(flags, plan);
    checkMeasures(flags, plan);
    plan.job.search.encoding = chooseEncoding(flags, plan);
    plan.job.mayUseMasks = flags.encoding.empty();
    plan.job.mayStream = plan.job.written.npz && flags.encoding != "mask";
    plan.job.npz = targetOf(flags, plan);
    std::vector<std::string> inputs = queryFiles(flags.query);
    inputs.push_back(flags.input.path);
    std::vector<std::string> outputs = flags.outputs;
    if (!flags.attributesOutput.empty()) outputs.push_back(flags.attributesOutput);
    // With --force, too: only a .vdb keeps all that was there.
    for (const std::string& path : outputs) {
        if (extensionOf(path) != ".vdb") checkNotInput(path, inputs);
    }
    checkOutputs(outputs, inputs, flags.common);
    return plan;
}

// Voxels of a new .vdb are as large as the radius, or the largest, if they are not said to be otherwise. A radius that served all
// points is what the file suggests.
NewGridOptions newGridOptions(const SearchPlan& plan, const QueryInput& input, double radius)
{
    NewGridOptions grid;
    if (!plan.query.hasRadii) grid.suggestedRadius = radius;
    double largest = plan.query.hasRadii ? 0 : radius;
    for (const std::vector<double>* radii : {&input.queryRadii, &input.candidateRadii}) {
        for (const double r : *radii) {
            if (std::isfinite(r)) largest = std::max(largest, r);
        }
    }
    grid.voxelSize = plan.voxelSize.value_or(largest);
    return grid;
}

// The result attributes by name and type alone.
PointValues namesOf(const MeasurePlan& plan, const MeasureOptions& options)
{
    PointValues values;
    const MeasuredNames names = checkMeasures(plan.names, options); // which knows the types of averages now
    for (const MeasuredNames::Value& value : names.attributes)
        values.attributes.push_back({value.name, value.type, 0, nullptr});
    for (const std::string& group : names.groups) values.groups.push_back({group, 0, nullptr});
    return values;
}

// The job, `repeat` times with buffers kept; the last lists are returned.
NeighborLists runJobs(SearchEngine& engine, const QueryInput& input, const SearchFlags& flags,
                      JobOptions options, std::uint64_t repeat, ProgressPrinter& progress,
                      SearchReport& report, JobReport& job)
{
    constexpr double kReadShare = 0.2, kSearchShare = 0.6; // rough shares of a run, for progress only
    std::vector<double> gridSeconds, searchSeconds;
    NeighborLists lists;
    for (std::uint64_t run = 0; run < repeat; ++run) {
        lists = NeighborLists(); // frees what the engine may use again
        const double step = kSearchShare / static_cast<double>(repeat);
        SearchProgress steps({progress, kReadShare + step * static_cast<double>(run),
                              kReadShare + step * static_cast<double>(run + 1)});
        options.search.progress = &steps;
        const auto tell = [&] {
            for (const std::string& note : job.notes) {
                if (!flags.common.quiet) say(note);
            }
        };
        try {
            lists = engine.findNeighbors(input.candidateSet(), input.querySet(), input.radius(report.radius),
                                         options, job);
        } catch (const CapacityError&) {
            tell();
            throw;
        }
        tell();
        options = job.settled;
        gridSeconds.push_back(job.gridSeconds);
        searchSeconds.push_back(job.searchSeconds);
    }
    job.settled.search.progress = &progress;
    SecondsReport& seconds = report.seconds;
    seconds.firstGrid = gridSeconds.front();
    seconds.firstSearch = searchSeconds.front();
    seconds.grid = median(std::move(gridSeconds));
    seconds.search = median(std::move(searchSeconds));
    seconds.measure = job.measureSeconds;
    if (job.plan) {
        seconds.estimate = job.plan->estimateSeconds;
        seconds.plan = job.plan->planSeconds;
    }
    return lists;
}

// The checksum of NeighborLists::checksum() without stored lists.
std::uint64_t visitChecksum(SearchEngine& engine, const SearchSets& sets, const SearchOptions& options)
{
    tbb::combinable<std::uint64_t> sums([] { return std::uint64_t{0}; });
    engine.visitRows(
        sets,
        [&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
            std::uint64_t sum = 0;
            for (const std::uint32_t neighbor : neighbors)
                sum += mix64((std::uint64_t{query} << 32) + neighbor);
            sums.local() += sum;
        },
        options);
    return sums.combine([](std::uint64_t a, std::uint64_t b) { return a + b; });
}

void makeChecksum(SearchEngine& engine, const SearchFlags& flags, const JobReport& job,
                  const NeighborLists& lists, SearchReport& report)
{
    const bool stored = lists.encoding() != Encoding::kNone, wanted = stored || job.streamed;
    report.checksum = job.checksum;
    if (job.checksum || (!flags.checksum && (flags.common.json.empty() || !wanted))) return;
    const Stopwatch watch;
    const SearchOptions& search = job.settled.search;
    report.checksum = stored ? lists.checksum(search.progress) : visitChecksum(engine, lists.sets(), search);
    report.seconds.checksum = watch.seconds();
}

// The result attributes. `counts` must stay where it is.
PointValues valuesOf(const SearchPlan& plan, const JobReport& job, const NeighborLists& lists,
                     std::vector<std::uint32_t>& counts)
{
    if (!plan.job.measures.empty()) return job.measured;
    counts = lists.counts();
    PointValues values;
    values.attributes.push_back(viewAttribute(plan.measure.results.attributes.at(0).name,
                                              AttributeType::kInt32, counts.data(), counts.size()));
    return values;
}

void reportValues(const PointValues& values, const JobReport& job, SearchReport& report)
{
    report.measures.emplace();
    for (const PointAttribute& attribute : values.attributes)
        report.measures->attributes.push_back({attribute.name, attributeTypeName(attribute.type)});
    for (const PointGroup& group : values.groups) report.measures->groups.push_back(group.name);
    report.measures->skipped = job.measureSkipped;
}

// What is written beside lists.
struct PointOutputs {
    const PointFile& points;
    NewGridOptions grid;
    KeptOutputs kept;
};

void writeOutputs(SearchEngine& engine, const SearchFlags& flags, const SearchPlan& plan,
                  const JobReport& job, const PointOutputs& outputs, const NeighborLists& lists,
                  ProgressPrinter& progress, SearchReport& report)
{
    std::vector<std::string> paths = flags.outputs;
    if (!plan.attributes.arrays.empty()) paths.push_back(plan.attributes.arrays);
    if (paths.empty()) return;
    const Stopwatch watch;
    const OutputOptions output = outputOptions(flags.common);
    std::vector<std::uint32_t> counts;
    PointValues values;
    if (plan.writesAttributes()) {
        values = valuesOf(plan, job, lists, counts);
        reportValues(values, job, report);
        report.measures->kept = outputs.kept.kept();
        report.measures->leftOut = outputs.kept.leftOut;
    }
    const double share = 0.2 / static_cast<double>(paths.size());
    for (std::size_t i = 0; i < paths.size(); ++i) {
        const std::string& path = paths[i];
        const double from = 0.8 + share * static_cast<double>(i);
        progress.begin("write", from, from + share);
        if (i == flags.outputs.size()) {
            writeArraysNpz(path, values, output, &progress);
        } else if (extensionOf(path) == ".npz") {
            if (!job.written) writeJobNpz(path, engine, lists, job, listForm(flags, plan), output);
        } else if (const auto written = writePoints(path, outputs.points, outputs.kept.before(path, values),
                                                    outputs.grid, output, &progress)) {
            report.measures->voxelSize = written->voxelSize;
            report.measures->largestRounding = written->largestRounding;
            for (const std::string& warning : warningsOf(path, *written)) {
                if (!flags.common.quiet) say("warning: " + warning);
            }
        }
        report.written.push_back(path);
    }
    report.seconds.write = job.writeSeconds + watch.seconds();
}

void fillReport(const SearchEngine& engine, const SearchFlags& flags, const JobReport& job,
                const NeighborLists& lists, SearchReport& report)
{
    fillGridReport(lists.sets(), job.settled.search, report);
    report.listBytes = lists.bytes();
    report.encoding = job.streamed ? Encoding::kIndex : lists.encoding();
    report.straightToFile = job.streamed;
    if (!flags.common.json.empty()) report.candidateTests = countCandidateTests(lists.sets());
    report.doublePairs = engine.statistics().doublePairs;
    report.exactPairs = engine.statistics().exactPairs;
    report.simd = simdLevelName(engine.statistics().simd);
    report.result = lists.statistics();
    report.plan = job.plan;
    report.run = job.run;
}

int searchFile(const SearchFlags& flags, const SearchPlan& plan, int threads, Session& session)
{
    const Stopwatch total;
    ProgressPrinter progress(progressMode(flags.common));
    SearchReport report;
    report.device.threads = threads;
    const PointNeeds needs{!flags.common.json.empty(), flags.nonfinite == "fail", flags.common.quiet,
                           plan.job.search.hostMemoryBytes, plan.query.hasRadii};
    const QueryInput input =
        readQuerySets(flags.input, flags.query, plan.query, needs, {progress, 0, 0.2}, session, report);
    const PointFile& rows = input.queries ? *input.queries : input.candidates;
    MeasureInput measured;
    JobOptions options = plan.job;
    options.measure = plan.measure.options;
    if (!plan.job.measures.empty()) {
        measured = readMeasureInput(input.candidates, plan.measure, &progress);
        options.measure = optionsOf(plan.measure, measured);
    }
    PointOutputs outputs{rows, newGridOptions(plan, input, report.radius), {}};
    if (plan.writesAttributes()) {
        const PointValues names = namesOf(plan.measure, options.measure);
        checkAttributeOutputs(plan.attributes, rows, names, outputs.grid, flags.common.force, &progress);
        outputs.kept = readKept(plan.attributes, rows, flags.keep, names, flags.common.force, &progress);
        options.written.keptBytes = outputs.kept.bytesEach();
        if (!flags.common.quiet) warnOfLeftOut(outputs.kept.leftOut);
    }
    checkReadingPeak(options.search.hostMemoryBytes, "the points and the values that come along",
                     ", or leave values out with --keep none");

    SearchEngine engine;
    JobReport job;
    const NeighborLists lists = runJobs(engine, input, flags, options, plan.repeat, progress, report, job);
    if (plan.query.hasRadii) report.radius = lists.sets().radius();
    fillReport(engine, flags, job, lists, report);
    makeChecksum(engine, flags, job, lists, report);
    writeOutputs(engine, flags, plan, job, outputs, lists, progress, report);
    throwIfStopped();
    progress.finish();
    report.peakBytes = peakMemoryBytes();
    report.seconds.total = total.seconds();

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
    SearchPlan plan = checkFlags(flags);
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
    addFlags(*command, *flags);
    return {command, [flags](Session& session) { return runSearchCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
