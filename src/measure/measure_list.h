// The measures by name.
#pragma once

#include "vdb_nns/measure.h"

#include <string>
#include <vector>

namespace vdb_nns {

enum class MeasureKind {
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

struct Measure {
    MeasureKind kind;
    std::string attribute; // of an average
};

// Throws InvalidInput for a name that is none, or that is there twice.
std::vector<Measure> measuresOf(const std::vector<std::string>& names);

// Throws InvalidInput for a bad option.
void checkMeasureOptions(const MeasureOptions& options);

// Name of the result in a file; of pca's the first.
std::string resultName(const Measure& measure, const std::string& prefix);

// The attribute that is averaged. Throws InvalidInput where the options do not have it.
const PointAttribute& averagedAttribute(const Measure& measure, const MeasureOptions& options);

// Of an average of such an attribute. Throws InvalidInput for one that has none.
AttributeType averageType(const PointAttribute& attribute);

} // namespace vdb_nns
