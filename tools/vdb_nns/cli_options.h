// Flags that several subcommands share, and how their values are read.
#pragma once

#include "progress_printer.h"
#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search_options.h"

#include <CLI/CLI.hpp>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

// Readers of values. `flag` is named in the message of the InvalidInput that they throw.

/// Bytes: KB MB GB TB are powers of 1000; KiB MiB GiB TiB and bare K M G T powers of 1024; no unit is bytes.
std::uint64_t parseSize(const std::string& text, const std::string& flag);
/// A whole number; k M G are powers of 1000: "4M", "65.6M".
std::uint64_t parseCount(const std::string& text, const std::string& flag);
/// A whole number from `low` to `high`, digits alone.
std::uint64_t parseRange(const std::string& text, const std::string& flag, std::uint64_t low,
                         std::uint64_t high);
/// The double nearest to the text; positive and finite.
double parsePositive(const std::string& text, const std::string& flag);
/// The double nearest to the text; finite.
double parseNumber(const std::string& text, const std::string& flag);
/// SearchOptions::cellSize, from `auto` or a number.
double parseCellSize(const std::string& text);

/// Of a search: more are a typo, and their list would fill the memory.
constexpr std::uint64_t kMostTiles = 100'000;

/// Refuses an empty value: it is an unset variable in a script, not a wish for the default.
const CLI::Validator& notEmpty();

/// Flags of every subcommand.
struct CommonFlags {
    std::string threads = "0", progress = "auto", json;
    bool force = false, sync = false, quiet = false, verbose = false;
};
void addCommonFlags(CLI::App& app, CommonFlags& flags);
int threadCount(const CommonFlags& flags); ///< 0: all
ProgressMode progressMode(const CommonFlags& flags);
OutputOptions outputOptions(const CommonFlags& flags);
bool jsonToStdout(const CommonFlags& flags);

/// Which particles and which radius.
struct InputFlags {
    std::string path, grid, radius, columns, array;
};
void addInputFlags(CLI::App& app, InputFlags& flags, bool withRadius);
/// @throws InvalidInput for columns that are not three numbers
PointFileOptions pointFileOptions(const InputFlags& flags, std::uint64_t hostMemoryBytes, Progress* progress);
/// What the help says of an input.
constexpr const char* kInputHelp = "point file: .vdb .npy .npz .ply .vtk .bgeo .xyz .txt .csv .pts";

/// How the engine searches.
struct EngineFlags {
    std::string hostMemory, cellSize = "auto";
};
void addEngineFlags(CLI::App& app, EngineFlags& flags);
/// @throws InvalidInput; CapacityError for less memory than the program itself takes
SearchOptions searchOptions(const EngineFlags& flags, Progress* progress);

/// Parameters of a scene.
struct SceneFlags {
    std::string count, seed = "1", spacing, radiusFactor, voxelSize, offset, distance, fraction;
};
void addSceneFlags(CLI::App& app, SceneFlags& flags);
SceneOptions sceneOptions(const std::string& name, const SceneFlags& flags);

/// The radius asked for, or the one that the particles suggest, which is said on stderr.
/// @throws InvalidInput without either
double chooseRadius(const std::string& text, const std::optional<double>& suggested, const std::string& path,
                    bool quiet);

/// The extension in lower case with its dot, e.g. ".vdb".
std::string extensionOf(const std::string& path);

/// Refuses a file of ours in the place of an input.
/// @throws InvalidInput
void checkNotInput(const std::string& output, const std::vector<std::string>& inputs);

/// Refuses outputs that are one file, files that could not be written, a report in the place of an input, and one for a
/// standard output that is closed.
/// @param paths of outputs; the file of --json is added.
/// @throws InvalidInput, OutputExists, OutputError
void checkOutputs(std::vector<std::string> paths, const std::vector<std::string>& inputs,
                  const CommonFlags& flags);

} // namespace vdb_nns::cli
