// The kernels with SSE4.1. Compiled with its flag, so nothing but kernelsFor() may lead here; see simd.h.
#define VDB_NNS_SIMD_SSE4
#include "cpu/kernel_table-inl.h"

namespace vdb_nns {

const Kernels kKernelsSse4 = kKernelTable;

} // namespace vdb_nns
