// Counts the neighbors of chosen queries, exactly and without lists. For estimates.
#pragma once

#include "grid/sparse_grid_data.h"
#include "util/cancel.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// Queries of one leaf.
struct SlotRange {
    std::uint32_t leaf, firstSlot, endSlot;
};

std::uint32_t leafOf(const SparseGridData& grid, std::uint32_t slot);

// Numbers of neighbors of the particles of each range, range after range, in parallel. Throws Cancelled.
std::vector<std::uint32_t> countRanges(const SparseGridData& grid, const std::vector<SlotRange>& ranges,
                                       const CancelCheck& cancel);

// Number of neighbors of the particle in each of `slots`, in parallel. Each query by itself: about twice the price of a
// query of a whole search. Throws Cancelled.
std::vector<std::uint32_t> countQueries(const SparseGridData& grid, const std::vector<std::uint32_t>& slots,
                                        const CancelCheck& cancel);

} // namespace vdb_nns
