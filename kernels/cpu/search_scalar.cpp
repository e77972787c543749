// The kernels in plain C++, for processors without SSE4. Compiled without flags of its own; see simd.h.
#include "cpu/kernel_table-inl.h"

namespace vdb_nns {

const Kernels kKernelsScalar = kKernelTable;

} // namespace vdb_nns
