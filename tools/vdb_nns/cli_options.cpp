#include "cli_options.h"

#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <cctype>
#include <cmath>
#include <filesystem>
#include <sstream>

namespace vdb_nns::cli {
namespace {

// Two names of one file: the same path once links and dots are resolved, or the same file by another name.
bool sameFile(const std::string& a, const std::string& b)
{
    namespace fs = std::filesystem;
    std::error_code error;
    if (fs::equivalent(a, b, error) && !error) return true;
    const fs::path left = fs::weakly_canonical(fs::absolute(a, error), error);
    const fs::path right = fs::weakly_canonical(fs::absolute(b, error), error);
    return left.lexically_normal() == right.lexically_normal();
}

// A bound that the program passes before it has read a point is mostly a number whose unit was forgotten.
void checkHostMemory(const std::string& text, std::uint64_t bytes)
{
    const std::uint64_t own = residentMemoryBytes();
    if (bytes > own) return;
    throw CapacityError("--host-memory: '" + text + "' is " + countText(bytes) +
                            " bytes, and the program itself takes " + bytesText(own) +
                            " before it has read a point; give more, e.g. 4G",
                        own, bytes);
}

void setIfGiven(std::optional<double>& target, const std::string& text, const char* flag)
{
    if (!text.empty()) target = parseNumber(text, flag);
}

} // namespace

const CLI::Validator& notEmpty()
{
    static const CLI::Validator validator(
        [](std::string& text) { return text.empty() ? std::string("the value is empty") : std::string(); },
        "");
    return validator;
}

void addCommonFlags(CLI::App& app, CommonFlags& flags)
{
    app.add_option("-T,--threads", flags.threads, "threads to use; 0: all")
        ->type_name("N")
        ->check(notEmpty())
        ->capture_default_str();
    app.add_option("--progress", flags.progress,
                   "show progress on stderr; `always` prints `PROGRESS nn%` lines off a terminal")
        ->type_name("WHEN")
        ->check(notEmpty())
        ->check(CLI::IsMember({"auto", "always", "never"}))
        ->capture_default_str();
    app.add_option("--json", flags.json, "write the report as JSON; `-`: to stdout, instead of the summary")
        ->type_name("FILE")
        ->check(notEmpty());
    app.add_flag("-f,--force", flags.force, "overwrite files and attributes that exist");
    app.add_flag("--sync", flags.sync,
                 "flush written files and their folders to the disk, so that they survive a power loss");
    CLI::Option* quiet = app.add_flag("-q,--quiet", flags.quiet, "no summary, no messages");
    app.add_flag("-v,--verbose", flags.verbose, "print more messages on stderr")->excludes(quiet);
}

int threadCount(const CommonFlags& flags)
{
    return static_cast<int>(parseRange(flags.threads, "--threads", 0, kMostThreads));
}

ProgressMode progressMode(const CommonFlags& flags)
{
    if (flags.progress == "always") return ProgressMode::kAlways;
    if (flags.progress == "never" || flags.quiet) return ProgressMode::kNever;
    return ProgressMode::kAuto;
}

OutputOptions outputOptions(const CommonFlags& flags)
{
    return {flags.force, flags.sync};
}

bool jsonToStdout(const CommonFlags& flags)
{
    return flags.json == "-";
}

void addInputFlags(CLI::App& app, InputFlags& flags, bool withRadius)
{
    app.add_option("-g,--grid", flags.grid, "point grid of a .vdb; default: the only one")
        ->type_name("NAME")
        ->check(notEmpty());
    app.add_option("--columns", flags.columns,
                   "columns of a text, an .npy or an .npz that are x, y and z, from 0, e.g. 1,2,3; default: "
                   "what the file "
                   "says, else the first three")
        ->type_name("LIST")
        ->check(notEmpty());
    app.add_option(
           "--array", flags.array,
           "array of an .npz that holds the positions; default: the only one, else the one named positions")
        ->type_name("NAME")
        ->check(notEmpty());
    if (withRadius) {
        app.add_option("-r,--radius", flags.radius,
                       "radius in world units; default: the one the file suggests")
            ->type_name("RADIUS")
            ->check(notEmpty());
    }
}

PointFileOptions pointFileOptions(const InputFlags& flags, std::uint64_t hostMemoryBytes, Progress* progress)
{
    PointFileOptions options{flags.grid, hostMemoryBytes, progress, {}, flags.array};
    if (flags.columns.empty()) return options;
    std::istringstream parts(flags.columns);
    for (std::string part; std::getline(parts, part, ',');)
        options.columns.push_back(static_cast<std::uint32_t>(parseRange(part, "--columns", 0, 65535)));
    if (options.columns.size() != 3 || flags.columns.back() == ',')
        throw InvalidInput("--columns: '" + flags.columns + "' are not three numbers; give e.g. 0,1,2");
    return options;
}

void addEngineFlags(CLI::App& app, EngineFlags& flags)
{
    app.add_option("--host-memory", flags.hostMemory,
                   "most memory the program may use, including the points (KB MB GB: powers of 1000; "
                   "K M G T KiB MiB GiB: powers of 1024); default: what is free, less a reserve")
        ->type_name("SIZE")
        ->check(notEmpty());
    app.add_option("--cell-size", flags.cellSize, "cell edge in radii: auto, or 0.333 to 4")
        ->type_name("RATIO")
        ->check(notEmpty())
        ->capture_default_str();
}

SearchOptions searchOptions(const EngineFlags& flags, Progress* progress)
{
    SearchOptions options;
    options.cellSize = parseCellSize(flags.cellSize);
    if (!flags.hostMemory.empty()) {
        options.hostMemoryBytes = parseSize(flags.hostMemory, "--host-memory");
        checkHostMemory(flags.hostMemory, options.hostMemoryBytes);
    }
    options.progress = progress;
    return options;
}

void addSceneFlags(CLI::App& app, SceneFlags& flags)
{
    app.add_option("-n,--count", flags.count, "particles; k, M and G are powers of 1000")
        ->type_name("COUNT")
        ->check(notEmpty());
    app.add_option("--seed", flags.seed, "seed of everything random")
        ->type_name("N")
        ->check(notEmpty())
        ->capture_default_str();
    app.add_option("--spacing", flags.spacing, "particle spacing h in world units")
        ->type_name("H")
        ->check(notEmpty());
    app.add_option("--radius-factor", flags.radiusFactor, "suggested radius / h")
        ->type_name("K")
        ->check(notEmpty());
    app.add_option("--voxel-size", flags.voxelSize, "voxel edge in world units; default 2 h (lattice: h)")
        ->type_name("SIZE")
        ->check(notEmpty());
    app.add_option("--offset", flags.offset, "far: voxels from the origin")
        ->type_name("VOXELS")
        ->check(notEmpty());
    app.add_option("--distance", flags.distance, "outlier: voxels to the lone particle")
        ->type_name("VOXELS")
        ->check(notEmpty());
    app.add_option("--fraction", flags.fraction, "coincident: share of the particles at one point")
        ->type_name("F")
        ->check(notEmpty());
}

SceneOptions sceneOptions(const std::string& name, const SceneFlags& flags)
{
    if (flags.count.empty())
        throw InvalidInput("-n is missing: say how many particles the scene has, e.g. -n 1M");
    SceneOptions options;
    options.name = name;
    options.count = parseCount(flags.count, "-n");
    options.seed = parseCount(flags.seed, "--seed");
    setIfGiven(options.spacing, flags.spacing, "--spacing");
    setIfGiven(options.radiusFactor, flags.radiusFactor, "--radius-factor");
    setIfGiven(options.voxelSize, flags.voxelSize, "--voxel-size");
    setIfGiven(options.offset, flags.offset, "--offset");
    setIfGiven(options.distance, flags.distance, "--distance");
    setIfGiven(options.fraction, flags.fraction, "--fraction");
    return options;
}

double chooseRadius(const std::string& text, const std::optional<double>& suggested, const std::string& path,
                    bool quiet)
{
    if (!text.empty()) return parsePositive(text, "--radius");
    if (!suggested) {
        throw InvalidInput(path + ": no radius: give -r RADIUS (the file has no suggested_radius)");
    }
    if (!(*suggested > 0) || !std::isfinite(*suggested)) {
        throw InvalidInput(path + ": the file's suggested_radius is " + shortest(*suggested) +
                           ", which is no radius; give -r RADIUS");
    }
    if (!quiet) say(path + " suggests the radius " + shortest(*suggested));
    return *suggested;
}

std::string extensionOf(const std::string& path)
{
    std::string extension = std::filesystem::path(path).extension().string();
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return extension;
}

void checkNotInput(const std::string& output, const std::vector<std::string>& inputs)
{
    for (const std::string& input : inputs) {
        if (sameFile(output, input)) {
            throw InvalidInput(output + ": is an input and would be lost; give the output another file");
        }
    }
}

void checkOutputs(std::vector<std::string> paths, const std::vector<std::string>& inputs,
                  const CommonFlags& flags)
{
    if (jsonToStdout(flags)) {
        requireStdout();
    } else if (!flags.json.empty()) {
        checkNotInput(flags.json, inputs);
        paths.push_back(flags.json);
    }
    for (std::size_t i = 0; i < paths.size(); ++i) {
        for (std::size_t j = 0; j < i; ++j) {
            if (sameFile(paths[i], paths[j])) {
                throw InvalidInput(paths[i] + ": is the target of two outputs; give each its own file");
            }
        }
        checkOutput(paths[i], flags.force);
    }
}

} // namespace vdb_nns::cli
