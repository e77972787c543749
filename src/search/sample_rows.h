// How many neighbors queries have, from a few of them that are counted: what memory and plans expect before a search.
#pragma once

#include "search/engine_state.h"

#include <cstddef>

namespace vdb_nns {

struct RowSample {
    std::size_t queries = 0;
    double entries = 0; // of all their rows; of those that are cut, what is left

    double entriesEach() const { return queries > 0 ? entries / static_cast<double>(queries) : 0; }
};

// Counts the rows of up to `most` queries of a part, evenly among its slots. Exact for those.
RowSample sampleRows(const SearchRun& run, std::size_t most, ThreadState& state);

} // namespace vdb_nns
