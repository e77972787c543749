// The search with AVX512. Compiled with the flags of that instruction set; see simd.h.
#define VDB_NNS_SIMD_AVX512
#include "execute/search_task-inl.h"

namespace vdb_nns {

const SearchKernels kSearchAvx512 = {searchTask<IndexRows>, searchTask<MaskRows>, searchTask<CountRows>};

} // namespace vdb_nns
