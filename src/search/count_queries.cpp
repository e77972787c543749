#include "search/count_queries.h"

#include "cpu/kernels.h"
#include "cpu/leaves_in_reach-inl.h"
#include "cpu/search_task.h"
#include "exact/exact_test.h"
#include "grid/lattice.h"
#include "lists/cell_candidates.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>

namespace vdb_nns {

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

namespace {

// What the tasks of a count share.
class Counter {
public:
    Counter(const SparseGridData& grid, double radius, const CancelCheck& cancel)
        : mGrid(grid),
          mCancel(cancel),
          mContext{blockViewOf(grid),
                   makeFilterBounds(radiusInCells(grid.lattice, radius), grid.reach(), grid.coordinateError),
                   pollOf(cancel)},
          mExact(grid.view, radius),
          mCount(kernelsFor(SimdLevel::kBest).plain.count)
    {
    }

    void count(const QueryRange& range, std::uint32_t* counts)
    {
        mCancel.check();
        ThreadState& state = mStates.local();
        state.decideBy(mExact, mCancel);
        std::uint64_t cells[8];
        markCell(mGrid, range.leaf, range.firstSlot, cells);
        LeafNeighborhood neighborhood;
        const std::uint32_t reached = leavesInReach(cells, mGrid.reach());
        if (reached != kOwnLeafAlone)
            mGrid.topology.neighborhoods({&mGrid.leafOrigins[range.leaf], 1}, &neighborhood);
        for (int n = 0; n < kLeavesAround; ++n) {
            if (!(reached >> n & 1)) neighborhood.leaf[n] = kNoLeaf;
        }
        neighborhood.leaf[kOwnLeaf] = range.leaf;
        state.sink.slotBase = range.firstSlot;
        state.sink.rowCount = counts;
        mCount(mContext, {range.leaf, range.firstSlot, range.endSlot, neighborhood.leaf, cells},
               state.exactPredicate(), state.halo, state.sink, state.statistics);
    }

private:
    const SparseGridData& mGrid;
    const CancelCheck& mCancel;
    SearchContext mContext;
    ExactTest mExact;
    SearchTaskFunction mCount;
    ThreadStates mStates;
};

} // namespace

std::vector<std::uint32_t> countQueries(const SparseGridData& grid, double radius,
                                        const std::vector<QueryRange>& ranges, const CancelCheck& cancel)
{
    std::vector<std::size_t> begin(1, 0);
    for (const QueryRange& range : ranges) begin.push_back(begin.back() + range.endSlot - range.firstSlot);
    std::vector<std::uint32_t> counts(begin.back());
    Counter counter(grid, radius, cancel);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, ranges.size(), 64), [&](const auto& part) {
        for (std::size_t r = part.begin(); r < part.end(); ++r)
            counter.count(ranges[r], counts.data() + begin[r]);
    });
    return counts;
}

} // namespace vdb_nns
