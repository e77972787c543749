// `bench --stability`: every case against every method, each cell in a process of its own.
#pragma once

#include "bench/stability/cell.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct StabilityOptions {
    std::vector<MethodSpec> methods; ///< e.g. stabilityMethods()
    std::vector<std::string> cases;  ///< names or groups; empty: all
    double secondsPerCell = 120;
    std::uint64_t bytesPerCell = std::uint64_t(4) << 30;
    int threads = 0;                     ///< 0: all
    ProgressPrinter* progress = nullptr; ///< may be null
};

/// The engine in all its ways, on a simulated device too, and what others do: those peers that this program was built with.
std::vector<MethodSpec> stabilityMethods();

/// By case, then by method. To be called before this process starts threads: before anything is searched, read or made.
/// @throws InvalidInput for a case that there is not; as runCell()
std::vector<StabilityCell> runStability(const StabilityOptions& options);

/// Whether a method that promises exact pairs keeps its word: it answers exactly, or refuses clearly where that is right. True for
/// methods that promise nothing.
bool oursHolds(const StabilityCell& cell);

/// An array of objects with the keys case, group, what, method, verdict, missing, extra, duplicates, asymmetric, seconds,
/// peak_rss_bytes, message, holds.
nlohmann::ordered_json stabilityJson(const std::vector<StabilityCell>& cells);

/// A table of cases by methods, its legend, and a line for each cell that died, refused or fails its promise.
std::string stabilityText(const std::vector<StabilityCell>& cells);

} // namespace vdb_nns::cli
