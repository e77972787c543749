// The kernels in plain C++, for processors without SSE4. Compiled without flags of its own; see simd.h.
#include "cpu/expect_cells-inl.h"
#include "cpu/kernels.h"
#include "cpu/locate_axis-inl.h"
#include "cpu/sample_cubes-inl.h"
#include "cpu/search_task-inl.h"

namespace vdb_nns {

const Kernels kKernelsScalar = {searchTask<IndexRows<StreamedRows>>,
                                searchTask<IndexRows<DirectRows>>,
                                searchTask<MaskRows>,
                                searchTask<CountRows>,
                                locateAxis,
                                sampleCubes,
                                expectCells};

} // namespace vdb_nns
