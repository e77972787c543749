// The search with SSE4. Compiled with the flags of that instruction set; see simd.h.
#define VDB_NNS_SIMD_SSE4
#include "execute/search_task-inl.h"

namespace vdb_nns {

const SearchKernels kSearchSse4 = {searchTask<IndexRows>, searchTask<MaskRows>, searchTask<CountRows>};

} // namespace vdb_nns
