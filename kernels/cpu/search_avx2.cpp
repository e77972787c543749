// The kernels with AVX2, FMA and BMI2. Compiled with their flags, so nothing but kernelsFor() may lead here; see simd.h.
#define VDB_NNS_SIMD_AVX2
#include "cpu/kernel_table-inl.h"

namespace vdb_nns {

const Kernels kKernelsAvx2 = kKernelTable;

} // namespace vdb_nns
