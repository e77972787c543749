// The study of resolution: which cell size a scene needs, and what --cell-size auto takes.
#pragma once

#include "bench/bench_points.h"
#include "bench/method.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct ResolutionResult {
    std::string scene;
    Encoding encoding = Encoding::kIndex;
    bool isAuto = false; ///< what auto takes; else a size that was asked for
    double cellSize = 0; ///< edge in radii
    int reach = 1;
    std::uint64_t particles = 0, cells = 0, leaves = 0, candidateTests = 0, structureBytes = 0, listBytes = 0;
    double gridSeconds = 0, searchSeconds = 0, totalSeconds = 0; ///< medians
};

struct ResolutionStudyOptions {
    SearchOptions search;
    double radius = 0;
    std::uint64_t repeat = 5;
};

/// Sizes of a third of the radius to four of it, and auto, for lists of both encodings and counts; interleaved.
/// @throws Cancelled, CapacityError
std::vector<ResolutionResult>
studyResolution(const BenchPoints& points, const ResolutionStudyOptions& options, const ProgressSpan& span);

} // namespace vdb_nns::cli
