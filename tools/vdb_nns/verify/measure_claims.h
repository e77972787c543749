// The values of a file that are checked as measures.
#pragma once

#include "measure_check.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

enum class Measure {
    kCount,
    kDensity,
    kMeanDistance,
    kNearestDistance,
    kNearest,
    kAverage,
    kNormal,
    kEigenvalues,
    kPca,
    kCluster,
    kClusterSize,
    kIsolated,
    kNonfinite
};

// A measure and its values in the file.
struct Claim {
    Measure measure = Measure::kCount;
    std::size_t finding = 0;                   // the first of its findings
    PointAttribute attribute, xform, position; // the latter two of pca, whose `attribute` is the stretch
    PointGroup group;
    PointAttribute source; // of an average
};

// Finds them, and adds a finding for each attribute and group. Of no queries there need not be any.
// @throws InvalidInput for a measure that is not known and for values that are not there, InputError for values of another type or
//         number
std::vector<Claim> readClaims(const MeasureClaims& claims, std::uint64_t queries, std::uint64_t candidates,
                              std::vector<ValueFinding>& findings);

// A number of an attribute. The integers that measures have are exact.
double numberAt(const PointAttribute& attribute, std::uint64_t i, std::size_t component);

} // namespace vdb_nns::cli
