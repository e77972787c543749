// The kernels in plain C++. Compiled with the flags of that instruction set; see simd.h.
#include "execute/expect_cells-inl.h"
#include "execute/kernels.h"
#include "execute/search_task-inl.h"
#include "grid/draw_lots-inl.h"
#include "grid/locate_axis-inl.h"

namespace vdb_nns {

const Kernels kKernelsScalar = {searchTask<IndexRows<StreamedRows>>,
                                searchTask<IndexRows<DirectRows>>,
                                searchTask<MaskRows>,
                                searchTask<CountRows>,
                                locateAxis,
                                drawLots,
                                expectCells};

} // namespace vdb_nns
