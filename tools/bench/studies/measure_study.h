// The study of measures: density, normals and ellipsoids made in several ways: error against time.
#pragma once

#include "bench/bench_points.h"
#include "bench/measure_truth.h"
#include "bench/truth.h"
#include "progress_printer.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <exception>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// A measure by a method.
struct MeasureResult {
    std::string scene, measure, method;
    bool isOurs = false; ///< promises what vdb_nns/measure.h says
    std::uint64_t points = 0, runs = 0;
    /// Medians; total is grid and pass.
    double gridSeconds = 0, passSeconds = 0, totalSeconds = 0, minSeconds = 0, maxSeconds = 0;
    double countingSeconds = 0; ///< pass of the engine that counts neighbors and measures nothing
    double ratio = 0;           ///< of the pass to that; 0 where that took no time
    bool isComplete = false;    ///< the truth has all particles
    std::uint64_t checkedQueries = 0;
    MeasureErrors errors;
    std::string message; ///< of a refusal; then there are no figures
    std::exception_ptr refusal;
};

struct MeasureStudyOptions {
    SearchOptions search;
    double radius = 0;
    double voxelSize = 1;     ///< world edge; for codecs
    std::uint64_t repeat = 5; ///< timed runs of each, interleaved, after one that warms up
    TruthOptions truth;
};

/// density, normal and pca by: ours; float32, what a plain program does with the exact neighbors; half, the same of every second
/// neighbor; nearest32, ours of the 32 nearest; fxpt16 and fxpt8, ours on positions that a .vdb holds in so many bits. Sorted by
/// measure.
/// @throws Cancelled, and InputError of the truth
std::vector<MeasureResult> studyMeasures(const BenchPoints& points, const MeasureStudyOptions& options,
                                         const ProgressSpan& span);

} // namespace vdb_nns::cli
