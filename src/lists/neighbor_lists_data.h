// What NeighborLists holds. By slot of the queries' grid, so that a search writes in order, part after part (SearchPart::firstRow);
// slotOf leads from a query's number to its slot. May know the sets, not how they were searched.
#pragma once

#include "grid/search_sets_data.h"
#include "util/memory.h"
#include "vdb_nns/neighbor_lists.h"

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

constexpr std::uint32_t kNoSlot = 0xffffffffu; // no query, not finite, or far from all candidates

// Rows of membership bits, one after the other, of the slots from firstSlot to the next entry's. A row has one bit for
// each candidate of the cells within reach: by cell (x, y, z) lexicographic, by number inside a cell, padded to 32-bit
// words; the query's own bit is 0. Its length follows from the grid, whatever the radius of the search.
struct MaskRun {
    std::uint32_t firstSlot;
    const std::uint32_t* words;
};

struct NeighborListsData {
    SearchSets sets;
    std::uint32_t nearest = 0; // rows are cut to so many; 0: whole
    bool hasSelf = false;      // a query that is a candidate stands in its own row
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

    // 1 if the query of a row stands in it.
    std::uint32_t selfIn(std::uint32_t query) const
    {
        return hasSelf && sets.data().isCandidate(query) ? 1 : 0;
    }
    // Of the row of a query, itself included.
    std::uint32_t entriesOf(std::size_t query) const
    {
        const std::uint32_t slot = slotOf[query];
        return slot == kNoSlot ? 0 : rowCount[slot];
    }
    // The part of a slot.
    const SearchPart& partOf(std::uint32_t slot) const
    {
        const std::vector<SearchPart>& parts = sets.data().parts;
        std::size_t k = 0;
        while (k + 1 < parts.size() && parts[k + 1].firstRow <= slot) ++k;
        return parts[k];
    }
};

} // namespace vdb_nns
