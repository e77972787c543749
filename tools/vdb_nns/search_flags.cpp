#include "search_flags.h"

#include "frame_numbers.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <filesystem>

namespace vdb_nns::cli {
namespace {

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

TileChoice parseTile(const std::string& text)
{
    const std::size_t slash = text.find('/');
    if (slash == std::string::npos)
        throw InvalidInput("--tile: '" + text + "' is no tile; give e.g. 3/7, the third of seven");
    TileChoice choice;
    choice.tiles = static_cast<std::uint32_t>(parseRange(text.substr(slash + 1), "--tile", 1, kMostTiles));
    choice.tile = static_cast<std::uint32_t>(parseRange(text.substr(0, slash), "--tile", 1, choice.tiles));
    return choice;
}

// A tile has rows alone, in one file.
void checkTile(const SearchFlags& flags, SearchPlan& plan)
{
    if (flags.tile.empty()) return;
    plan.tile = parseTile(flags.tile);
    if (!plan.measure.isCountAlone() || plan.writesAttributes())
        throw InvalidInput("--tile makes lists, in an .npz, and no attributes of points; leave --attributes, "
                           "--attributes-output and outputs that are no .npz out");
    if (flags.outputs.size() > 1) throw InvalidInput("--tile writes one part; give one -o PART.npz");
    // What is asked of all points, or of another file, takes all of them.
    const QueryFlags& query = flags.query;
    plan.readsTileAlone = extensionOf(flags.input.path) == ".vdb" && !plan.query.hasQueries &&
                          !plan.query.hasRadii && query.queryGroup.empty() && query.candidateGroup.empty() &&
                          flags.nonfinite != "fail";
    plan.query.hasRoles = true; // the rows are those of some points
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

} // namespace

void addSearchFlags(CLI::App& app, SearchFlags& flags)
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
    app.add_option(
           "--frames", flags.frames,
           "search one file after the other: numbers for the places of IN and of all outputs that are "
           "written as a row of #, as %04d or as $F4, e.g. 1-240, or 1-240x2 for every second one")
        ->type_name("RANGE")
        ->check(notEmpty());
    app.add_flag("--skip-existing", flags.skipExisting,
                 "with --frames: make only the outputs that are not there");
    app.add_option("--tile", flags.tile,
                   "find the rows of one of N ranges of leaves of equal work alone, from 1: a part, for "
                   "`vdb_nns merge`")
        ->type_name("K/N")
        ->check(notEmpty());
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

ListForm listForm(const SearchFlags& flags, const SearchPlan& plan)
{
    return {flags.lists == "distance" ? ListValues::kDistance : ListValues::kConnectivity,
            plan.query.byDistance ? RowOrder::kDistance : RowOrder::kNumber};
}

SearchPlan checkSearchFlags(const SearchFlags& flags, const OutputChecks& checks)
{
    SearchPlan plan;
    std::error_code error; // such a file is not there either, or its reader says what is wrong
    if (flags.frames.empty() && isFramePattern(flags.input.path) &&
        !std::filesystem::exists(flags.input.path, error))
        throw InputError(flags.input.path + ": is not there; for the files of a sequence give --frames, e.g. "
                                            "--frames 1-240");
    if (!flags.input.radius.empty()) parsePositive(flags.input.radius, "--radius");
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
    checkTile(flags, plan);
    plan.job.search.encoding = chooseEncoding(flags, plan);
    plan.job.mayUseMasks = flags.encoding.empty();
    plan.job.mayStream = plan.job.written.npz && flags.encoding != "mask" && !plan.tile;
    if (!plan.tile) plan.job.npz = targetOf(flags, plan);
    std::vector<std::string> inputs = queryFiles(flags.query);
    inputs.push_back(flags.input.path);
    std::vector<std::string> outputs = flags.outputs;
    if (!flags.attributesOutput.empty()) outputs.push_back(flags.attributesOutput);
    // With --force, too: only a .vdb keeps all that was there.
    for (const std::string& path : outputs) {
        if (extensionOf(path) != ".vdb") checkNotInput(path, inputs);
    }
    CommonFlags common = flags.common;
    if (!checks.existing) common.force = true;
    if (!checks.report) common.json.clear();
    checkOutputs(outputs, inputs, common);
    return plan;
}

} // namespace vdb_nns::cli
