// vdb_nns search: reads particles, finds neighbors, writes lists and attributes, reports.
#include "cli_options.h"
#include "command.h"
#include "device_plan.h"
#include "exit_codes.h"
#include "host_memory.h"
#include "machine.h"
#include "numbers.h"
#include "point_input.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"
#include "vdb_nns/version.h"

#include <algorithm>
#include <cctype>
#include <memory>
#include <tbb/combinable.h>

namespace vdb_nns::cli {
namespace {

struct SearchFlags {
    CommonFlags common;
    InputFlags input;
    EngineFlags engine;
    std::vector<std::string> outputs;
    DeviceFlags device;
    std::string encoding, lists = "connectivity", attributes = "count", prefix = "nns_";
    std::string repeat = "1", nonfinite = "skip";
    bool checksum = false;
};

// Flags after all that can be checked before reading.
struct SearchPlan {
    std::optional<double> radius; // else the file's suggestion
    SearchOptions options;
    int threads = 0;
    std::uint64_t repeat = 1;
    OutputKinds outputs;
    DeviceRequest devices;
    bool straightToFile = false; // no lists are held: rows are made again and go to the .npz as they come
};

void addFlags(CLI::App& app, SearchFlags& flags)
{
    app.add_option("IN", flags.input.path, "point file: .vdb .npy .ply .xyz")->required()->check(notEmpty());
    app.add_option("-o,--output", flags.outputs,
                   "write neighbor lists (.npz) or the points with result attributes (.vdb); may be repeated")
        ->type_name("OUT")
        ->type_size(1)
        ->allow_extra_args(false)
        ->check(notEmpty());
    addInputFlags(app, flags.input, true);
    addDeviceFlags(app, flags.device);
    addEngineFlags(app, flags.engine);
    app.add_option("--encoding", flags.encoding,
                   "how lists are held: index, mask or none; default: what the outputs need, mask where "
                   "index lists do not fit. Where neither fits, the rows of an .npz go straight to the file")
        ->type_name("NAME")
        ->check(CLI::IsMember({"index", "mask", "none"}));
    app.add_option("--lists", flags.lists, "values of an .npz: connectivity (ones) or distance")
        ->type_name("VALUES")
        ->check(CLI::IsMember({"connectivity", "distance"}))
        ->capture_default_str();
    app.add_option("--attributes", flags.attributes,
                   "attributes of a .vdb output, separated by commas: count")
        ->type_name("LIST")
        ->capture_default_str();
    app.add_option("--prefix", flags.prefix, "prefix of attribute names")
        ->type_name("P")
        ->capture_default_str();
    app.add_flag("--checksum", flags.checksum, "report the checksum of all pairs");
    app.add_option("--repeat", flags.repeat, "search N times, report medians")
        ->type_name("N")
        ->capture_default_str();
    app.add_option("--nonfinite", flags.nonfinite, "what to do with NaN and infinite positions: skip or fail")
        ->type_name("HOW")
        ->check(CLI::IsMember({"skip", "fail"}))
        ->capture_default_str();
    addCommonFlags(app, flags.common);
}

void checkAttributes(const SearchFlags& flags)
{
    if (flags.attributes != "count") {
        throw InvalidInput("--attributes: '" + flags.attributes +
                           "' is not known; this version writes: count");
    }
    const auto allowed = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == ':' || c == '|'; };
    if (!std::all_of(flags.prefix.begin(), flags.prefix.end(), allowed)) {
        throw InvalidInput("--prefix: '" + flags.prefix +
                           "' has a character that attribute names may not have; use "
                           "letters, digits, _ : |");
    }
}

void checkOutputKinds(const SearchFlags& flags, SearchPlan& plan)
{
    const bool inputIsVdb = extensionOf(flags.input.path) == ".vdb";
    for (const std::string& path : flags.outputs) {
        const std::string extension = extensionOf(path);
        plan.outputs.npz |= extension == ".npz";
        plan.outputs.vdb |= extension == ".vdb";
        if (extension != ".npz" && extension != ".vdb") {
            throw InvalidInput(path + ": the extension '" + extension +
                               "' is not known; use .npz for lists or .vdb for "
                               "points with attributes");
        }
        if (extension == ".vdb" && !inputIsVdb) {
            throw InvalidInput(path + ": attributes can only be written when the input is a .vdb, and " +
                               flags.input.path + " is not; use -o x.npz");
        }
    }
    if (plan.outputs.npz && flags.encoding == "none") {
        throw InvalidInput(
            "--encoding none keeps no lists, and an .npz output needs them; use index or mask");
    }
}

Encoding chooseEncoding(const SearchFlags& flags, const SearchPlan& plan)
{
    if (flags.encoding == "index") return Encoding::kIndex;
    if (flags.encoding == "mask") return Encoding::kMask;
    if (flags.encoding == "none") return Encoding::kNone;
    if (plan.outputs.npz) return Encoding::kIndex;
    return flags.checksum ? Encoding::kMask : Encoding::kNone;
}

// Everything that can be wrong without reading a byte.
SearchPlan checkFlags(const SearchFlags& flags)
{
    SearchPlan plan;
    if (!flags.input.radius.empty()) plan.radius = parsePositive(flags.input.radius, "--radius");
    plan.options = searchOptions(flags.engine, nullptr);
    plan.threads = threadCount(flags.common);
    plan.repeat = parseCount(flags.repeat, "--repeat");
    if (plan.repeat == 0) throw InvalidInput("--repeat: 0 runs are none; give 1 or more");
    checkAttributes(flags);
    checkOutputKinds(flags, plan);
    plan.options.encoding = chooseEncoding(flags, plan);
    checkOutputs(flags.outputs, {flags.input.path}, flags.common);
    return plan;
}

// The attribute to be written must not exist.
void checkAttribute(const SearchFlags& flags, const SearchPlan& plan, const PointFile& file)
{
    if (!plan.outputs.vdb || flags.common.force) return;
    const std::string name = flags.prefix + "count";
    for (const AttributeInfo& attribute : file.info().attributes) {
        if (attribute.name == name) {
            throw InvalidInput("the attribute '" + name +
                               "' exists; use --force to replace it, or another --prefix");
        }
    }
}

// Whether particles that are near each other in space mostly have numbers that are near too, as those of a .vdb do.
bool isNumberedAlongSpace(const SparseGrid& grid)
{
    constexpr std::size_t kSamples = 1024;
    constexpr std::uint32_t kNear = 4096;
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    if (numbers.size() < 2) return true;
    std::size_t near = 0;
    for (std::size_t k = 0; k < kSamples; ++k) {
        const std::size_t slot = (numbers.size() - 1) * k / kSamples;
        const std::uint32_t a = numbers[slot], b = numbers[slot + 1];
        near += std::max(a, b) - std::min(a, b) < kNear;
    }
    return 2 * near > kSamples;
}

// What serves where lists of the plan's encoding do not fit, with the same output. Rows that go straight to an .npz are the
// fastest where their order is about that of the file; else masks, which take a quarter of the memory or less. False:
// nothing is left.
bool takeLess(const SparseGrid& grid, const SearchFlags& flags, SearchPlan& plan)
{
    const bool isFree = flags.encoding.empty() && plan.options.encoding == Encoding::kIndex;
    const bool mayStream =
        plan.outputs.npz && plan.options.encoding != Encoding::kNone && flags.encoding != "mask";
    if (isFree && !(mayStream && isNumberedAlongSpace(grid))) {
        plan.options.encoding = Encoding::kMask;
        return true;
    }
    if (!mayStream) return false;
    plan.options.encoding = Encoding::kNone;
    plan.straightToFile = true;
    return true;
}

// Whether masks would be smaller in cells of the radius.
bool hasWideCells(const SparseGrid& grid, const SearchPlan& plan)
{
    return plan.options.cellSize == 0 && grid.cellSize() > 1.01 * grid.radius();
}

// The grid once more, in cells of the radius.
void narrowCells(SearchEngine& engine, SparseGrid& grid, SearchPlan& plan)
{
    const ParticleView view = grid.view();
    const double radius = grid.radius();
    grid = SparseGrid();
    engine = SearchEngine(); // memory was short
    plan.options.cellSize = 1;
    grid = engine.buildGrid(view, radius, plan.options);
}

// Lists in the encoding of the plan, or in the one that fits.
NeighborLists searchGrid(SearchEngine& engine, SparseGrid grid, const SearchFlags& flags,
                         const HostMemory& memory, SearchPlan& plan, const ProgressSpan& span,
                         SearchReport& report)
{
    for (;;) {
        try {
            SearchOptions options = plan.options;
            options.hostMemoryBytes = memory.listBytes(grid, options.encoding);
            if (plan.devices.devices.empty()) return engine.search(grid, options);
            return searchOnDevices(engine, grid, plan.devices, options, span, report);
        } catch (const CapacityError& error) {
            const bool areLargeMasks = plan.options.encoding == Encoding::kMask && hasWideCells(grid, plan);
            if (!areLargeMasks && !takeLess(grid, flags, plan)) throw;
            if (!flags.common.quiet) {
                say(error.what() + std::string(areLargeMasks ? "; cells of the radius are taken instead"
                                               : plan.straightToFile
                                                   ? "; rows go straight to the file instead"
                                                   : "; they are held as masks instead"));
            }
            if (plan.options.encoding == Encoding::kMask && hasWideCells(grid, plan))
                narrowCells(engine, grid, plan);
        }
    }
}

// Grid and lists, `repeat` times with buffers kept; the last lists are returned.
NeighborLists runSearch(SearchEngine& engine, const ParticleView& view, double radius,
                        const SearchFlags& flags, HostMemory& memory, SearchPlan& plan,
                        ProgressPrinter& progress, SearchReport& report)
{
    constexpr double kReadShare = 0.2, kSearchShare = 0.6; // rough shares of a run, for progress only
    std::vector<double> gridSeconds, searchSeconds;
    NeighborLists lists;
    for (std::uint64_t run = 0; run < plan.repeat; ++run) {
        lists = NeighborLists();                         // frees what the engine may use again
        if (memory.isBounded()) engine = SearchEngine(); // the grid's sort needs the room of the last lists
        const double step = kSearchShare / static_cast<double>(plan.repeat);
        const double from = kReadShare + step * static_cast<double>(run);
        progress.begin("grid", from, from + step / 3);
        const Stopwatch gridWatch;
        plan.options.hostMemoryBytes = memory.gridBytes();
        SparseGrid grid = engine.buildGrid(view, radius, plan.options);
        if (memory.isBounded()) returnFreedMemory();
        gridSeconds.push_back(gridWatch.seconds());
        progress.begin("search", from + step / 3, from + step);
        const Stopwatch searchWatch;
        memory.beginLists(grid);
        lists = searchGrid(engine, std::move(grid), flags, memory, plan,
                           {progress, from + step / 3, from + step}, report);
        searchSeconds.push_back(searchWatch.seconds() - report.seconds.estimate.value_or(0) -
                                report.seconds.plan.value_or(0));
    }
    SecondsReport& seconds = report.seconds;
    seconds.firstGrid = gridSeconds.front();
    seconds.firstSearch = searchSeconds.front();
    seconds.grid = median(std::move(gridSeconds));
    seconds.search = median(std::move(searchSeconds));
    return lists;
}

// The checksum of NeighborLists::checksum() without stored lists.
std::uint64_t visitChecksum(SearchEngine& engine, const SparseGrid& grid, const SearchOptions& options)
{
    tbb::combinable<std::uint64_t> sums([] { return std::uint64_t{0}; });
    engine.visitRows(
        grid,
        [&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
            std::uint64_t sum = 0;
            for (const std::uint32_t neighbor : neighbors)
                sum += mix64((std::uint64_t{query} << 32) + neighbor);
            sums.local() += sum;
        },
        options);
    return sums.combine([](std::uint64_t a, std::uint64_t b) { return a + b; });
}

void makeChecksum(SearchEngine& engine, const SearchFlags& flags, const SearchPlan& plan,
                  const NeighborLists& lists, SearchReport& report)
{
    const bool stored = lists.encoding() != Encoding::kNone, wanted = stored || plan.straightToFile;
    if (!flags.checksum && (flags.common.json.empty() || !wanted)) return;
    const Stopwatch watch;
    report.checksum =
        stored ? lists.checksum(plan.options.progress) : visitChecksum(engine, lists.grid(), plan.options);
    report.seconds.checksum = watch.seconds();
}

void writeLists(const std::string& path, SearchEngine& engine, const NeighborLists& lists,
                const SearchFlags& flags, const SearchPlan& plan, const HostMemory& memory)
{
    const ListValues values = flags.lists == "distance" ? ListValues::kDistance : ListValues::kConnectivity;
    if (plan.straightToFile) {
        streamNpz(path, engine, lists, values, outputOptions(flags.common), memory.bufferBytes(lists.grid()),
                  plan.options);
    } else {
        writeNpz(path, lists, values, outputOptions(flags.common), plan.options.progress);
    }
}

void writeOutputs(SearchEngine& engine, const SearchFlags& flags, const SearchPlan& plan,
                  const HostMemory& memory, const PointFile& file, const NeighborLists& lists,
                  ProgressPrinter& progress, SearchReport& report)
{
    if (flags.outputs.empty()) return;
    const Stopwatch watch;
    const double share = 0.2 / static_cast<double>(flags.outputs.size());
    for (const std::string& path : flags.outputs) {
        const double from = 0.8 + share * static_cast<double>(report.written.size());
        progress.begin("write", from, from + share);
        if (extensionOf(path) == ".npz") {
            writeLists(path, engine, lists, flags, plan, memory);
        } else {
            const std::vector<std::uint32_t> counts = lists.counts();
            file.writeVdb(path, {counts.data(), counts.size()}, flags.prefix, outputOptions(flags.common),
                          &progress);
        }
        report.written.push_back(path);
    }
    report.seconds.write = watch.seconds();
}

void fillReport(const SearchEngine& engine, const SearchPlan& plan, const HostMemory& memory,
                const NeighborLists& lists, SearchReport& report)
{
    const SparseGrid& grid = lists.grid();
    fillGridReport(grid, plan.options, report);
    if (memory.isBounded()) report.device.budgetBytes = memory.boundBytes();
    report.listBytes = lists.bytes();
    report.encoding = plan.straightToFile ? Encoding::kIndex : lists.encoding();
    report.straightToFile = plan.straightToFile;
    report.candidateTests = countCandidateTests(grid);
    report.doublePairs = engine.statistics().doublePairs;
    report.exactPairs = engine.statistics().exactPairs;
    report.simd = simdLevelName(engine.statistics().simd);
    report.result = lists.statistics();
}

int searchFile(const SearchFlags& flags, SearchPlan plan, int threads, Session& session)
{
    const Stopwatch total;
    ProgressPrinter progress(progressMode(flags.common));
    HostMemory memory(plan.options.hostMemoryBytes, threads, plan.outputs);
    plan.options.progress = &progress;
    SearchReport report;
    report.device.threads = threads;
    const PointNeeds needs{!flags.common.json.empty(), flags.nonfinite == "fail", flags.common.quiet,
                           memory.readBytes()};
    const PointFile file = readPoints(flags.input, needs, {progress, 0, 0.2}, session, report);
    checkAttribute(flags, plan, file);

    SearchEngine engine;
    memory.beginSearch();
    const NeighborLists lists = memory.explained(
        [&] { return runSearch(engine, file.view(), report.radius, flags, memory, plan, progress, report); });
    fillReport(engine, plan, memory, lists, report);
    makeChecksum(engine, flags, plan, lists, report);
    writeOutputs(engine, flags, plan, memory, file, lists, progress, report);
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
    plan.devices = deviceRequest(flags.device, threads.count());
    plan.options.wideCells = plan.devices.devices.empty(); // masks are sent over the link
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
