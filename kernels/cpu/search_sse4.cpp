// The kernels with SSE4.1. Compiled with its flag, so nothing but kernelsFor() may lead here; see simd.h.
#define VDB_NNS_SIMD_SSE4
#include "cpu/expect_cells-inl.h"
#include "cpu/kernels.h"
#include "cpu/locate_axis-inl.h"
#include "cpu/sample_cubes-inl.h"
#include "cpu/search_task-inl.h"

namespace vdb_nns {

const Kernels kKernelsSse4 = {searchTask<IndexRows<StreamedRows>>,
                              searchTask<IndexRows<DirectRows>>,
                              searchTask<MaskRows>,
                              searchTask<CountRows>,
                              locateAxis,
                              sampleCubes,
                              expectCells};

} // namespace vdb_nns
