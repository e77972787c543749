// The search with AVX2. Compiled with the flags of that instruction set; see simd.h.
#define VDB_NNS_SIMD_AVX2
#include "execute/search_task-inl.h"

namespace vdb_nns {

const SearchKernels kSearchAvx2 = {searchTask<IndexRows>, searchTask<MaskRows>, searchTask<CountRows>};

} // namespace vdb_nns
