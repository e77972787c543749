// What a stability case asks to be measured of its particles: every measure, in a few passes with other options.
#pragma once

#include "bench/stability/cases.h"
#include "vdb_nns/measure.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// What the candidates carry beside their positions, in arrays that it owns.
struct MeasureTask {
    std::vector<float> floats, floatVectors;    ///< the attributes f and v (vec3s)
    std::vector<double> doubles, doubleVectors; ///< d and w (vec3d)
    std::vector<std::int32_t> integers;         ///< i
    std::vector<double> masses;                 ///< empty: 1 for all
    /// Densities, distances and eigenvalues may be beyond the range of floats: infinite.
    bool mayPassRange = false;
};

/// A number of an attribute, where `largest` is the largest that its type holds; vectors take three in a row.
using AttributeNumber = std::function<double(std::size_t i, double largest)>;

/// About 1000, and no two the same.
double ordinaryNumber(std::size_t i, double largest);

/// @param number its integers have to be finite; what is not gives them another number
MeasureTask makeMeasureTask(std::size_t candidates, const AttributeNumber& number = ordinaryNumber);

/// The particles of a case, or the search of sets that it is about.
SetSearch searchOf(const CaseParticles& particles);

/// All measures; without clusters where the search has none.
std::vector<std::string> measuredNames(const SetSearch& search);

/// One pass for each kernel, with other options of pca and DBSCAN. They view what the task owns.
std::vector<MeasureOptions> measurePasses(const MeasureTask& task);

} // namespace vdb_nns::cli
