// See count_queries.h.
#include "execute/count_queries.h"

#include "execute/exact_test.h"
#include "execute/kernels.h"
#include "execute/search_task.h"
#include "execute/thread_state.h"
#include "lists/cell_candidates.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>

namespace vdb_nns {

namespace {

// The cell of a slot of a leaf, as a mask of one.
void markCell(const SparseGridData& grid, std::uint32_t leaf, std::uint32_t slot, std::uint64_t* cells)
{
    const LeafRecord& record = grid.leaves[leaf];
    const std::uint32_t* const begin = grid.cellStart.data() + record.firstCell;
    const std::uint32_t* const end = grid.cellStart.data() + grid.leaves[leaf + 1].firstCell;
    auto left = std::upper_bound(begin, end, slot) - begin - 1; // occupied cells before it
    for (int x = 0; x < 8; ++x) {
        cells[x] = 0;
        std::uint64_t word = record.occupancy[x];
        const int count = __builtin_popcountll(word);
        if (left >= 0 && left < count) {
            for (; left > 0; --left) word &= word - 1;
            cells[x] = word & -word;
        }
        left -= count;
    }
}

// What the tasks of a count share.
class Counter {
public:
    explicit Counter(const SparseGridData& grid)
        : mGrid(grid),
          mContext{blockViewOf(grid), makeFilterBounds(grid.radiusCells, grid.reach, grid.coordinateError)},
          mExact(grid.view, grid.radius),
          mCount(kernelsFor(SimdLevel::kBest).count)
    {
    }

    void count(const SlotRange& range, const std::uint64_t* cells, std::uint32_t* counts)
    {
        ThreadState& state = mStates.local();
        state.exact = &mExact;
        LeafNeighborhood neighborhood;
        mGrid.topology.neighborhoods({&mGrid.leafOrigins[range.leaf], 1}, &neighborhood);
        state.sink.slotBase = range.firstSlot;
        state.sink.rowCount = counts;
        mCount(mContext, {range.leaf, range.firstSlot, range.endSlot, neighborhood.leaf, cells},
               state.judge(), state.halo, state.sink, state.statistics);
    }

private:
    const SparseGridData& mGrid;
    SearchContext mContext;
    ExactTest mExact;
    SearchTaskFunction mCount;
    ThreadStates mStates;
};

} // namespace

std::uint32_t leafOf(const SparseGridData& grid, std::uint32_t slot)
{
    const auto next =
        std::upper_bound(grid.leaves.begin(), grid.leaves.end(), slot,
                         [](std::uint32_t s, const LeafRecord& leaf) { return s < leaf.firstSlot; });
    return static_cast<std::uint32_t>(next - grid.leaves.begin() - 1);
}

std::vector<std::uint32_t> countRanges(const SparseGridData& grid, const std::vector<SlotRange>& ranges,
                                       const CancelCheck& cancel)
{
    std::vector<std::size_t> begin(1, 0);
    for (const SlotRange& range : ranges) begin.push_back(begin.back() + range.endSlot - range.firstSlot);
    std::vector<std::uint32_t> counts(begin.back());
    Counter counter(grid);
    tbb::parallel_for(std::size_t(0), ranges.size(), [&](std::size_t r) {
        cancel.check();
        counter.count(ranges[r], nullptr, counts.data() + begin[r]);
    });
    return counts;
}

std::vector<std::uint32_t> countQueries(const SparseGridData& grid, const std::vector<std::uint32_t>& slots,
                                        const CancelCheck& cancel)
{
    std::vector<std::uint32_t> counts(slots.size());
    Counter counter(grid);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, slots.size(), 64), [&](const auto& range) {
        cancel.check();
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
            const std::uint32_t leaf = leafOf(grid, slots[k]);
            std::uint64_t cells[8];
            markCell(grid, leaf, slots[k], cells);
            counter.count({leaf, slots[k], slots[k] + 1}, cells, &counts[k]);
        }
    });
    return counts;
}

} // namespace vdb_nns
