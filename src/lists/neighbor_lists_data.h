// What NeighborLists holds. By slot of the grid, so that a search writes in order; slotOf leads from a particle's number
// to its slot. May know the grid, not how it was searched.
#pragma once

#include "util/memory.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/sparse_grid.h"

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

constexpr std::uint32_t kNoSlot = 0xffffffffu; // a non-finite particle

// Rows of membership bits, one after the other, of the slots from firstSlot to the next entry's. A row has one bit for
// each candidate of the cells within reach: by cell (x, y, z) lexicographic, by number inside a cell, padded to 32-bit
// words; the query's own bit is 0. Its length follows from the grid, whatever the radius of the search.
struct MaskRun {
    std::uint32_t firstSlot;
    const std::uint32_t* words;
};

struct NeighborListsData {
    ParticleView view;
    SparseGrid grid;
    double radius = 0; // of the search, world units
    Encoding encoding = Encoding::kNone;
    ListStatistics statistics;
    std::uint64_t rowBytes = 0; // indices or masks

    PageArray<std::uint32_t> slotOf;    // by number
    PageArray<std::uint32_t> rowCount;  // by slot
    PageArray<std::uint32_t*> rowBegin; // by slot; kIndex
    std::vector<MaskRun> maskRuns;      // by firstSlot; kMask
    std::vector<PageBlock> chunks;      // what rows point into

    // For reading masks by number, made at the first such call: the rows of each occupied cell.
    mutable std::once_flag directoryOnce;
    mutable std::vector<MaskRun> directory;
    mutable std::atomic<std::uint64_t> directoryBytes{0}; // may be read while another thread makes it
};

} // namespace vdb_nns
