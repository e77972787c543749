// The kernels with AVX-512 (F, BW, VL, DQ). Compiled with their flags, so nothing but kernelsFor() may lead here; see simd.h.
#define VDB_NNS_SIMD_AVX512
#include "cpu/kernel_table-inl.h"

namespace vdb_nns {

const Kernels kKernelsAvx512 = kKernelTable;

} // namespace vdb_nns
