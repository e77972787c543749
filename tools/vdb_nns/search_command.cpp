// vdb_nns search: reads particles, finds neighbors, writes lists and attributes, reports.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "numbers.h"
#include "report.h"
#include "text_file.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"
#include "vdb_nns/version.h"

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <memory>
#include <tbb/combinable.h>

namespace vdb_nns::cli {
namespace {

struct SearchFlags {
    CommonFlags common;
    InputFlags input;
    EngineFlags engine;
    std::vector<std::string> outputs;
    std::string device = "auto", encoding, lists = "connectivity", attributes = "count", prefix = "nns_";
    std::string repeat = "1", nonfinite = "skip";
    bool checksum = false;
};

// Flags after all that can be checked before reading.
struct SearchPlan {
    std::optional<double> radius; // else the file's suggestion
    SearchOptions options;
    int threads = 0;
    std::uint64_t repeat = 1;
    bool writesNpz = false, writesVdb = false;
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
    app.add_option("--device", flags.device, "what searches: auto, cpu, cuda or cuda:N")
        ->type_name("DEVICE")
        ->capture_default_str();
    addEngineFlags(app, flags.engine);
    app.add_option("--encoding", flags.encoding,
                   "how lists are held: index, mask or none; default: what the outputs need, "
                   "mask where index lists do not fit")
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

// The CPU is all there is; a device that is asked for by name and is not there stops the run.
void checkDevice(const std::string& device)
{
    if (device == "auto" || device == "cpu") return;
    const bool cuda = device.compare(0, 4, "cuda") == 0;
    const std::string number = cuda && device.size() > 5 && device[4] == ':' ? device.substr(5) : "";
    const bool numbered =
        !number.empty() && number.size() < 10 &&
        std::all_of(number.begin(), number.end(), [](unsigned char c) { return std::isdigit(c); });
    if (device != "cuda" && !numbered) {
        throw InvalidInput("--device: '" + device + "' is not a device; use auto, cpu, cuda or cuda:N");
    }
    throw DeviceError("--device " + device + ": this build cannot search on CUDA devices (CUDA: " +
                      std::string(cudaBuild()) + "); use --device cpu");
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
        plan.writesNpz |= extension == ".npz";
        plan.writesVdb |= extension == ".vdb";
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
    if (plan.writesNpz && flags.encoding == "none") {
        throw InvalidInput(
            "--encoding none keeps no lists, and an .npz output needs them; use index or mask");
    }
}

Encoding chooseEncoding(const SearchFlags& flags, const SearchPlan& plan)
{
    if (flags.encoding == "index") return Encoding::kIndex;
    if (flags.encoding == "mask") return Encoding::kMask;
    if (flags.encoding == "none") return Encoding::kNone;
    if (plan.writesNpz) return Encoding::kIndex;
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
    checkDevice(flags.device);
    checkOutputs(flags.outputs, {flags.input.path}, flags.common);
    return plan;
}

// Checks that need the file but not the search.
void checkFile(const SearchFlags& flags, const SearchPlan& plan, const PointFile& file)
{
    if (flags.nonfinite == "fail" && file.info().nonfinite > 0) {
        throw CheckFailed(std::to_string(file.info().nonfinite) + " of " +
                          std::to_string(file.info().points) +
                          " points have a NaN or infinite coordinate; --nonfinite skip leaves them out");
    }
    if (!plan.writesVdb || flags.common.force) return;
    const std::string name = flags.prefix + "count";
    for (const AttributeInfo& attribute : file.info().attributes) {
        if (attribute.name == name) {
            throw InvalidInput("the attribute '" + name +
                               "' exists; use --force to replace it, or another --prefix");
        }
    }
}

// Lists in the encoding of the plan. Where nobody asked for index lists and they do not fit, masks serve: the output is the
// same, and they take a quarter of the memory or less.
NeighborLists searchGrid(SearchEngine& engine, const SparseGrid& grid, const SearchFlags& flags,
                         SearchPlan& plan)
{
    try {
        return engine.search(grid, plan.options);
    } catch (const CapacityError& error) {
        if (!flags.encoding.empty() || plan.options.encoding != Encoding::kIndex) throw;
        if (!flags.common.quiet) {
            std::fprintf(stderr, "vdb_nns: %s; they are held as masks instead\n", error.what());
        }
    }
    plan.options.encoding = Encoding::kMask;
    return engine.search(grid, plan.options);
}

// Grid and lists, `repeat` times with buffers kept; the last lists are returned.
NeighborLists runSearch(SearchEngine& engine, const ParticleView& view, double radius,
                        const SearchFlags& flags, SearchPlan& plan, ProgressPrinter& progress,
                        SecondsReport& seconds)
{
    constexpr double kReadShare = 0.2, kSearchShare = 0.6; // rough shares of a run, for progress only
    std::vector<double> gridSeconds, searchSeconds;
    NeighborLists lists;
    for (std::uint64_t run = 0; run < plan.repeat; ++run) {
        lists = NeighborLists(); // frees what the engine may use again
        const double step = kSearchShare / static_cast<double>(plan.repeat);
        const double from = kReadShare + step * static_cast<double>(run);
        progress.begin("grid", from, from + step / 3);
        const Stopwatch gridWatch;
        const SparseGrid grid = engine.buildGrid(view, radius, plan.options);
        gridSeconds.push_back(gridWatch.seconds());
        progress.begin("search", from + step / 3, from + step);
        const Stopwatch searchWatch;
        lists = searchGrid(engine, grid, flags, plan);
        searchSeconds.push_back(searchWatch.seconds());
    }
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
    engine.visit(
        grid,
        [&](std::uint32_t query, Span<const std::uint32_t> neighbors, Span<const double>) {
            std::uint64_t sum = 0;
            for (const std::uint32_t neighbor : neighbors)
                sum += mix64((std::uint64_t{query} << 32) + neighbor);
            sums.local() += sum;
        },
        options);
    return sums.combine([](std::uint64_t a, std::uint64_t b) { return a + b; });
}

void makeChecksum(SearchEngine& engine, const SearchFlags& flags, const SearchOptions& options,
                  const NeighborLists& lists, SearchReport& report)
{
    const bool stored = lists.encoding() != Encoding::kNone;
    if (!flags.checksum && (flags.common.json.empty() || !stored)) return;
    const Stopwatch watch;
    report.checksum = stored ? lists.checksum() : visitChecksum(engine, lists.grid(), options);
    report.seconds.checksum = watch.seconds();
}

void writeOutputs(const SearchFlags& flags, const PointFile& file, const NeighborLists& lists,
                  ProgressPrinter& progress, SearchReport& report)
{
    if (flags.outputs.empty()) return;
    const Stopwatch watch;
    const double share = 0.2 / static_cast<double>(flags.outputs.size());
    for (const std::string& path : flags.outputs) {
        const double from = 0.8 + share * static_cast<double>(report.written.size());
        progress.begin("write", from, from + share);
        if (extensionOf(path) == ".npz") {
            const ListValues values =
                flags.lists == "distance" ? ListValues::kDistance : ListValues::kConnectivity;
            writeNpz(path, lists, values, flags.common.force, &progress);
        } else {
            const std::vector<std::uint32_t> counts = lists.counts();
            file.writeVdb(path, {counts.data(), counts.size()}, flags.prefix, flags.common.force, &progress);
        }
        report.written.push_back(path);
    }
    report.seconds.write = watch.seconds();
}

void fillReport(const SearchEngine& engine, const SearchOptions& options, const NeighborLists& lists,
                SearchReport& report)
{
    const SparseGrid& grid = lists.grid();
    fillGridReport(grid, options, report);
    report.listBytes = lists.bytes();
    report.encoding = lists.encoding();
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
    plan.options.progress = &progress;
    SearchReport report;
    report.path = flags.input.path;
    report.device.threads = threads;

    progress.begin("read", 0, 0.2);
    const Stopwatch readWatch;
    const PointFile file = PointFile::read(flags.input.path, flags.input.grid, &progress);
    report.seconds.read = readWatch.seconds();
    session.path = flags.input.path;
    checkFile(flags, plan, file);
    if (!flags.common.json.empty() || !plan.radius) report.info = file.info();
    session.grid = report.info ? report.info->grid : flags.input.grid;
    const std::optional<double> suggested = plan.radius ? std::nullopt : report.info->suggestedRadius;
    report.radius = chooseRadius(flags.input.radius, suggested, flags.input.path, flags.common.quiet);
    if (extensionOf(flags.input.path) == ".vdb") {
        report.radiusVoxels = radiusInVoxels(file.view().linear(), report.radius);
    }

    SearchEngine engine;
    const NeighborLists lists =
        runSearch(engine, file.view(), report.radius, flags, plan, progress, report.seconds);
    fillReport(engine, plan.options, lists, report);
    makeChecksum(engine, flags, plan.options, lists, report);
    writeOutputs(flags, file, lists, progress, report);
    throwIfStopped();
    progress.finish();
    report.peakBytes = peakMemoryBytes();
    report.seconds.total = total.seconds();

    if (flags.common.verbose) {
        std::fprintf(
            stderr, "vdb_nns: %d threads, %s; %llu pairs went to the double test, %llu to exact arithmetic\n",
            threads, report.simd.c_str(), static_cast<unsigned long long>(report.doublePairs),
            static_cast<unsigned long long>(report.exactPairs));
    }
    if (!flags.common.json.empty())
        deliverJson(flags.common.json, searchReportJson(report), flags.common.force);
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeStdout(searchReportText(report));
    return kDone;
}

int runSearchCommand(const SearchFlags& flags, Session& session)
{
    const SearchPlan plan = checkFlags(flags);
    ThreadLimit threads(plan.threads);
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
