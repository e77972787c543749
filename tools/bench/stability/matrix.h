// `bench --stability`: every case against every method, each trial in a process of its own.
#pragma once

#include "bench/stability/trial.h"

#include <nlohmann/json_fwd.hpp>

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct StabilityOptions {
    std::vector<MethodSpec> methods; ///< e.g. stabilityMethods()
    std::vector<std::string> cases;  ///< names or groups; empty: all
    double secondsPerTrial = 120;
    std::uint64_t bytesPerTrial = std::uint64_t(4) << 30;
    int threads = 0;                     ///< 0: all
    ProgressPrinter* progress = nullptr; ///< may be null
};

/// The engine in all its ways, on a simulated device too, and what others do: those peers that this program was built with.
std::vector<MethodSpec> stabilityMethods();

/// By case, then by method. To be called before this process starts threads: before anything is searched, read or made.
/// @throws InvalidInput for a case that there is not; as runTrial()
std::vector<StabilityTrial> runStability(const StabilityOptions& options);

/// Whether a method that promises exact pairs keeps its word: it answers exactly, or refuses clearly where that is right. True for
/// methods that promise nothing.
bool oursHolds(const StabilityTrial& trial);

/// An array of objects with the keys case, group, what, method, verdict, missing, extra, duplicates, wrong_values, asymmetric,
/// seconds, peak_rss_bytes, message, holds.
nlohmann::ordered_json stabilityJson(const std::vector<StabilityTrial>& trials);

/// A table of cases by methods, its legend, and a line for each trial that died, refused or fails its promise.
std::string stabilityText(const std::vector<StabilityTrial>& trials);

} // namespace vdb_nns::cli
