// Which queries a task has, cell by cell. Knows the layout of blocks and halos; nothing of tests or rows. Internal linkage.
#pragma once

#include "cpu/gather-inl.h"
#include "cpu/halo-inl.h"

namespace vdb_nns {
namespace {

// Queries that stand together among the candidates of a frame.
struct Queries {
    std::uint32_t self; // the candidate that is the first of them; the others follow
    std::uint32_t count;
    std::uint32_t slot;       // of the first
    std::uint32_t candidates; // of the cells in reach, kept or not; nobody reads it in a sparse leaf
};

// Those of a run of slots that the task searches.
struct SlotRange {
    std::uint32_t begin, end;

    SlotRange(const SearchTask& task, std::uint32_t first, std::uint32_t last)
        : begin(first > task.firstSlot ? first : task.firstSlot),
          end(last < task.endSlot ? last : task.endSlot)
    {
    }

    bool empty() const { return begin >= end; }
    std::uint32_t count() const { return end - begin; }
};

// Calls f(lowest, cell, first slot) for each cell with queries of the task, which are of `block`; `lowest` points into the
// halo's cube at the cell of the same column that is `reach` below. `cell.firstQuery` is where they stand if they are candidates
// of the halo too.
template <typename F>
inline void forEachCell(const BlockView& block, const SearchTask& task, const HaloScratch& halo, F&& f)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    const LeafRecord& leaf = block.leaves[task.leaf];
    const std::uint32_t* cellStart = block.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cellStart) {
            const SlotRange slots(task, cellStart[0], cellStart[1]);
            if (slots.empty()) continue;
            const int bit = __builtin_ctzll(word), y = bit >> 3, z = bit & 7;
            const std::uint32_t* const lowest = halo.start + ((x + reach) * side + y + reach) * side + z;
            CellSearch cell{};
            cell.firstQuery = lowest[reach] + (slots.begin - cellStart[0]);
            cell.queries = slots.count();
            f(lowest, cell, slots.begin);
        }
    }
}

} // namespace
} // namespace vdb_nns
