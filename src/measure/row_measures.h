// What all threads of a pass over rows of neighbors share.
#pragma once

#include "cpu/kernels.h"
#include "grid/search_sets_data.h"
#include "measure/pair_positions.h"
#include "measure/results.h"
#include "vdb_nns/measure.h"

#include <vector>

namespace vdb_nns {

// An attribute of the candidates, by number: floats or doubles, FloatPosition or DoublePosition if it is a vector.
struct AveragedAttribute {
    bool isDouble = false, isVector = false;
    const void* values = nullptr;  // finite: 0 where the attribute is not
    const double* valid = nullptr; // 1 or 0; null where all are
    double unit = 1;               // that the values have, a power of two
};

struct RowMeasures {
    const SearchSetsData& sets;
    const MeasureKernels& kernels;
    const PairPositions& positions;
    const MeasureOptions& options;
    const MeasureTargets& targets;
    const std::vector<AveragedAttribute>& averaged; // as MeasureOptions::attributes; those that are averaged
    double radius; // of all pairs; where particles have their own, the largest
};

} // namespace vdb_nns
