// The study of growth: how time and error grow with the particles, the threads, the radius and the clustering.
#pragma once

#include "bench/studies/method_study.h"

#include <string>
#include <vector>

namespace vdb_nns::cli {

struct ScalingResult {
    std::string vary; ///< points, threads, radius or clustering
    double value =
        0; ///< of what is varied: particles, threads, radius in world units, share of clustered particles
    BenchResult result;
};

/// Of the finite particles, their world positions rounded to float32: an eighth to all of them, each a part of space with as many neighbors; one thread to all; half the
/// radius to 1.5 times; none to 90 % of them moved into clusters of 256 about others. The truth is found anew each time, by the
/// rules of TruthOptions with `sample`.
/// @throws as studyMethods() and findTruth()
std::vector<ScalingResult> studyScaling(const BenchPoints& points, const MethodStudyOptions& options,
                                        const TruthOptions& truth, const ProgressSpan& span);

} // namespace vdb_nns::cli
