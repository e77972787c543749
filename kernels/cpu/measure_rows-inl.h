// The kernels of measures (measure_rows.h) for the instruction set of the including file, in one table. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_eigen-inl.h"
#include "cpu/measure_pairs-inl.h"
#include "cpu/measure_sums-inl.h"

namespace vdb_nns {
namespace {

constexpr MeasureKernels kMeasureKernels = {
    {pairs<FloatPosition>, pairs<DoublePosition>, pairs<VoxelPosition9>, pairs<WideVoxelPosition>},
    {vectors<FloatPosition>, vectors<DoublePosition>},
    {scalars<float>, scalars<double>},
    weights,
    scales,
    sums,
    moments,
    pcaSums,
    least,
    distanceSums,
    addOncePairs,
    axes,
    stretches};

} // namespace
} // namespace vdb_nns
