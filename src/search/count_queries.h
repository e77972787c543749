// Counts the neighbors of chosen queries, exactly and without lists. For estimates.
#pragma once

#include "grid/sparse_grid_data.h"
#include "util/cancel.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// Consecutive queries of one cell.
struct QueryRange {
    std::uint32_t leaf, firstSlot, endSlot;
};

// The cell of a slot of a leaf, as a mask of one: 8 words.
void markCell(const SparseGridData& grid, std::uint32_t leaf, std::uint32_t slot, std::uint64_t* cells);

// Numbers of neighbors of the queries of each range, range after range, in parallel. Each range by itself: the first of its
// queries costs several times what a query of a whole search does, the others no more than that.
// `radius` is at most the lattice's. Throws Cancelled.
std::vector<std::uint32_t> countQueries(const SparseGridData& grid, double radius,
                                        const std::vector<QueryRange>& ranges, const CancelCheck& cancel);

} // namespace vdb_nns
