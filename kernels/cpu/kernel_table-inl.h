// The table of kernels for the instruction set of the including file: the one place that fills Kernels. Internal linkage; see
// simd.h.
#pragma once

#include "cpu/expect_cells-inl.h"
#include "cpu/kernels.h"
#include "cpu/locate_axis-inl.h"
#include "cpu/sample_cubes-inl.h"
#include "cpu/search_task-inl.h"
#include "cpu/sort_row-inl.h"

namespace vdb_nns {
namespace {

constexpr Kernels kKernelTable = {searchTask<IndexRows<StreamedRows>>,
                                  searchTask<IndexRows<DirectRows>>,
                                  searchTask<MaskRows>,
                                  searchTask<CountRows>,
                                  locateAxis,
                                  sampleCubes,
                                  expectCells,
                                  sortRow};

} // namespace
} // namespace vdb_nns
