// The table of kernels for the instruction set of the including file: the one place that fills Kernels. Internal linkage; see
// simd.h.
#pragma once

#include "cpu/expect_cells-inl.h"
#include "cpu/kernels.h"
#include "cpu/locate_axis-inl.h"
#include "cpu/measure_rows-inl.h"
#include "cpu/sample_cubes-inl.h"
#include "cpu/search_sets-inl.h"
#include "cpu/search_task-inl.h"
#include "cpu/sort_row-inl.h"

namespace vdb_nns {
namespace {

template <typename Rule>
constexpr RowKernels kSetKernels = {searchSets<IndexRows<StreamedRows>, Rule>,
                                    searchSets<IndexRows<DirectRows>, Rule>,
                                    nullptr,
                                    nullptr,
                                    searchSets<MaskRows, Rule>,
                                    searchSets<CountRows, Rule>};

template <typename Rule>
constexpr RowKernels kNearestKernels = {searchSets<NearestRows<StreamedRows>, Rule>,
                                        searchSets<NearestRows<DirectRows>, Rule>,
                                        nullptr,
                                        nullptr,
                                        nullptr,
                                        searchSets<CountRows, Rule>};

constexpr Kernels kKernelTable = {{searchTask<IndexRows<StreamedRows>>, searchTask<IndexRows<DirectRows>>,
                                   searchTask<IndexRows<DirectRows, SmallerNumbers>>,
                                   searchTask<IndexRows<DirectRows>, true>, searchTask<MaskRows>,
                                   searchTask<CountRows>},
                                  {kSetKernels<QueryRadius>, kNearestKernels<QueryRadius>},
                                  {kSetKernels<LargerRadius>, kNearestKernels<LargerRadius>},
                                  locateAxis,
                                  sampleCubes,
                                  expectCells,
                                  sortRow,
                                  kMeasureKernels};

} // namespace
} // namespace vdb_nns
