// Measures by definition, and how far others are from them.
#pragma once

#include "bench/methods/measure_methods.h"
#include "bench/truth.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Of a query, by the formulas of docs/measures.md in long double over its true neighbors: those of `verify`, which share nothing
/// with the engine. Rounded to double in the end. Each bound is what double arithmetic may change.
struct TrueMeasures {
    std::uint32_t query = 0;
    double density = 0, densityBound = 0;
    Vec3d normal{}; ///< 0 where it has none
    double normalBound = 0;
    bool hasNormal =
        false; ///< the direction is determined: it is not what rounding leaves of a sum of nothing
    bool isEllipsoid = false, hasStretch = false;
    Vec3d stretch{}, axis{}; ///< axis: of the largest eigenvalue
    double stretchBound = 0, axisBound = 0;
    /// The second axis is at most kMostSecond of the first: else its direction says little.
    bool hasAxis = false;

    static constexpr double kMostSecond = 0.9;
};

/// Of the truth's queries that are finite.
std::vector<TrueMeasures> trueMeasures(const ParticleView& view, double radius, const Truth& truth);

/// Errors of many values.
struct ErrorSummary {
    std::uint64_t compared = 0;
    double rms = 0, p99 = 0, max = 0;
};

/// @param errors are reordered
ErrorSummary summarizeErrors(std::vector<double>& errors);

/// Density: relative. Normal: angle in degrees. Pca: of the stretch, the largest difference of a component over the largest
/// component.
struct MeasureErrors {
    ErrorSummary value;
    std::optional<ErrorSummary> axis; ///< pca: angle of the longest axis in degrees, where that is determined
    /// Values that are there in one of the two alone: of normals those that are not 0, of pca ellipsoids. What is not finite is not
    /// there.
    std::uint64_t oneSided = 0;
    /// Values that are farther off than the rounding of doubles and of a float can explain.
    std::uint64_t wrong = 0;
};

/// @param measure "density", "normal" or "pca", which `values` must have
MeasureErrors findMeasureErrors(const std::string& measure, const MeasureValues& values,
                                const std::vector<TrueMeasures>& truth);

} // namespace vdb_nns::cli
