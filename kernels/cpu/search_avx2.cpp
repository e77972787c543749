// The kernels with AVX2, FMA and BMI2. Compiled with their flags, so nothing but kernelsFor() may lead here; see simd.h.
#define VDB_NNS_SIMD_AVX2
#include "cpu/expect_cells-inl.h"
#include "cpu/kernels.h"
#include "cpu/locate_axis-inl.h"
#include "cpu/sample_cubes-inl.h"
#include "cpu/search_task-inl.h"

namespace vdb_nns {

const Kernels kKernelsAvx2 = {searchTask<IndexRows<StreamedRows>>,
                              searchTask<IndexRows<DirectRows>>,
                              searchTask<MaskRows>,
                              searchTask<CountRows>,
                              locateAxis,
                              sampleCubes,
                              expectCells};

} // namespace vdb_nns
