// The search with plain C++. Compiled with the flags of that instruction set; see simd.h.
#include "execute/search_task-inl.h"

namespace vdb_nns {

const SearchKernels kSearchScalar = {searchTask<IndexRows>, searchTask<MaskRows>, searchTask<CountRows>};

} // namespace vdb_nns
