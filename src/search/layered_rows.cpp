#include "search/layered_rows.h"

#include "grid/wide_leaf.h"
#include "lists/cell_candidates.h"
#include "search/engine_state.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns {

namespace {

constexpr std::size_t kLeastBlockBytes = std::size_t(64) << 10;
// At once; a task has fewer.
constexpr std::uint32_t kMostRows = 1u << 16;

// Whether a box of cells about a leaf holds any particle.
bool hasParticles(const SparseGridData& grid, const LeafNeighborhood& neighborhood, const int (&low)[3],
                  const int (&high)[3])
{
    constexpr std::uint64_t kEachByte = 0x0101010101010101u;
    const auto cellsIn = [&](int axis, int leaf, int& first, int& last) {
        first = std::max(low[axis] - 8 * (leaf - 1), 0);
        last = std::min(high[axis] - 8 * (leaf - 1), 7);
        return first <= last;
    };
    int x0, x1, y0, y1, z0, z1;
    for (int n = 0; n < kLeavesAround; ++n) {
        if (neighborhood.leaf[n] == kNoLeaf) continue;
        if (!cellsIn(0, n / 9, x0, x1) || !cellsIn(1, n / 3 % 3, y0, y1) || !cellsIn(2, n % 3, z0, z1))
            continue;
        const std::uint64_t column = ((std::uint64_t(2) << (z1 - z0)) - 1) << z0;
        const std::uint64_t rows = (~std::uint64_t(0) << 8 * y0) & (~std::uint64_t(0) >> 8 * (7 - y1));
        const std::uint64_t mask = column * kEachByte & rows;
        const std::uint64_t* const occupancy = grid.leaves[neighborhood.leaf[n]].occupancy;
        for (int x = x0; x <= x1; ++x) {
            if (occupancy[x] & mask) return true;
        }
    }
    return false;
}

SearchTaskFunction shareKernelOf(const RowKernels& kernels, RowKind kind)
{
    return kind == RowKind::kMask ? kernels.mask : kind == RowKind::kCount ? kernels.count : kernels.visit;
}

} // namespace

bool findLayerTask(const SparseGridData& queries, const SparseGridData& candidates, int octaves,
                   const SearchTask& task, LayerTask& layerTask)
{
    const WideLeaf wide = wideLeafOf(queries.leafOrigins[task.leaf], octaves);
    candidates.topology.neighborhoods({&wide.origin, 1}, &layerTask.neighborhood);
    int low[3], high[3];
    for (int axis = 0; axis < 3; ++axis) {
        low[axis] = wide.place.wideCell(axis, 0) - candidates.reach();
        high[axis] = wide.place.wideCell(axis, 7) + candidates.reach();
    }
    if (!hasParticles(candidates, layerTask.neighborhood, low, high)) return false;
    layerTask.place = wide.place;
    layerTask.task = task;
    layerTask.task.neighborhood = layerTask.neighborhood.leaf;
    layerTask.task.wide = &layerTask.place;
    return true;
}

void LayeredRows::grow(RowSink& sink, std::size_t entries)
{
    Share& share = *static_cast<Share*>(sink.owner);
    share.owner->growShare(share, entries);
}

void LayeredRows::growShare(Share& share, std::size_t entries)
{
    const std::size_t bytes = entries * sizeof(std::uint32_t),
                      left = kMostBytes - std::min(kMostBytes, mBytes);
    if (mMayBeFull && bytes > left) throw Full();
    const std::size_t most = std::max(bytes, left);
    std::vector<PageBlock>& blocks = share.blocks;
    const bool fits = share.blocksUsed < blocks.size() && blocks[share.blocksUsed].bytes() >= bytes &&
                      blocks[share.blocksUsed].bytes() <= most;
    if (!fits) {
        blocks.resize(share.blocksUsed);
        // Twice as much each time.
        const std::size_t wanted = blocks.empty() ? kLeastBlockBytes : 2 * blocks.back().bytes();
        blocks.emplace_back(std::min(std::max(bytes, wanted), most));
    }
    const PageBlock& block = blocks[share.blocksUsed++];
    mBytes += block.bytes();
    share.sink.out = static_cast<std::uint32_t*>(block.data());
    share.sink.end = share.sink.out + block.bytes() / sizeof(std::uint32_t);
}

void LayeredRows::beginShare(Share& share, const SearchTask& task)
{
    const std::size_t rows = task.endSlot - task.firstSlot;
    share.owner = this;
    share.blocksUsed = 0;
    share.begin.resize(rows);
    share.count.assign(rows, 0);
    share.isEmpty = false;
    RowSink& sink = share.sink;
    sink.owner = &share;
    sink.grow = grow;
    sink.out = sink.end = nullptr;
    sink.slotBase = sink.nextSlot = task.firstSlot;
    sink.rowBegin = share.begin.data();
    sink.rowCount = share.count.data();
    sink.taskBegin = nullptr;
    sink.tailSize = 0;
}

void LayeredRows::makeShares(const SearchRun& run, RowKind kind, const SearchTask& task, ThreadState& state)
{
    TaskStatistics statistics;
    mBytes = 0;
    while (mShares.size() < run.layers.size()) mShares.push_back(std::make_unique<Share>());
    for (std::size_t k = 0; k < run.layers.size(); ++k) {
        const LayerRun& layer = run.layers[k];
        Share& share = *mShares[k];
        share.isEmpty = true;
        LayerTask layerTask;
        if (layer.octaves == 0) {
            layerTask.task = task;
        } else if (!findLayerTask(run.queries, *layer.candidates, layer.octaves, task, layerTask)) {
            continue;
        }
        beginShare(share, task);
        shareKernelOf(run.kernels, kind)(layer.context, layerTask.task, state.exactPredicate(), state.halo,
                                         share.sink, statistics);
    }
    state.statistics.pairs += statistics.pairs;
    state.statistics.bandPairs += statistics.bandPairs;
}

void LayeredRows::addCounts(const SearchTask& task, RowSink& sink) const
{
    const std::size_t rows = task.endSlot - task.firstSlot;
    std::uint32_t* const counts = sink.rowCount + (task.firstSlot - sink.slotBase);
    std::fill_n(counts, rows, 0);
    for (const std::unique_ptr<Share>& share : mShares) {
        if (share->isEmpty) continue;
        for (std::size_t r = 0; r < rows; ++r) counts[r] += share->count[r];
    }
}

void LayeredRows::joinMasks(const SearchRun& run, const SearchTask& task, RowSink& sink)
{
    std::vector<const std::uint32_t*> from(run.layers.size());
    for (std::size_t k = 0; k < run.layers.size(); ++k) from[k] = mShares[k]->sink.taskBegin;
    CellCandidates candidates(run.part);
    LeafNeighborhood own;
    std::copy_n(task.neighborhood, kLeavesAround, own.leaf);
    candidates.beginLeaf(task.leaf, own);
    forEachOccupiedCell(run.context.sets.queries, task.leaf, [&](const QueryCell& cell) {
        const std::uint32_t begin = std::max(cell.begin, task.firstSlot),
                            end = std::min(cell.end, task.endSlot);
        if (begin >= end) return;
        const CandidateRuns& runs = candidates.of(cell.x, cell.y, cell.z);
        for (std::uint32_t slot = begin; slot < end; ++slot) {
            for (std::size_t k = 0; k < from.size(); ++k) {
                const std::uint64_t words = runs.layerWords[k];
                if (words == 0) continue;
                std::memcpy(sink.out, from[k], words * sizeof(std::uint32_t));
                from[k] += words;
                sink.out += words;
            }
        }
    });
    addCounts(task, sink);
}

void LayeredRows::keepNearest(const SearchRun& run, std::uint32_t query, ThreadState& state)
{
    const SetContext& sets = run.context.sets;
    const auto self = sets.addsSelf ? std::find(mRow.begin(), mRow.end(), query) : mRow.end();
    const bool hasSelf = self != mRow.end();
    if (mRow.size() - hasSelf <= sets.nearest) return;
    ++state.statistics.shortened;
    mBeforeSelf.assign(mRow.begin(), self);
    if (hasSelf) mRow.erase(self);
    mOrder->keepNearest(query, mRow, sets.nearest, state.exactPairs);
    if (!hasSelf) return;
    std::size_t place = 0; // of those before it, the kept ones are before it still
    for (const std::uint32_t number : mBeforeSelf) place += place < mRow.size() && mRow[place] == number;
    mRow.insert(mRow.begin() + static_cast<std::ptrdiff_t>(place), query);
}

void LayeredRows::joinNumbers(const SearchRun& run, const SearchTask& task, ThreadState& state, RowSink& sink)
{
    const auto reserve = [&](std::size_t entries) {
        if (static_cast<std::size_t>(sink.end - sink.out) < entries) sink.grow(sink, entries);
    };
    for (std::uint32_t slot = task.firstSlot; slot < task.endSlot; ++slot) {
        const std::size_t row = slot - task.firstSlot;
        std::size_t count = 0;
        for (const std::unique_ptr<Share>& share : mShares) {
            if (!share->isEmpty) count += share->count[row];
        }
        const bool isCut = run.context.sets.nearest > 0;
        mRow.clear();
        if (!isCut) reserve(count + RowSink::kPad);
        std::uint32_t* to = sink.out;
        for (const std::unique_ptr<Share>& share : mShares) {
            if (share->isEmpty) continue;
            const std::uint32_t* const numbers = share->begin[row];
            const std::uint32_t some = share->count[row];
            if (some == 0) continue;
            if (isCut) {
                mRow.insert(mRow.end(), numbers, numbers + some);
            } else {
                std::memcpy(to, numbers, some * sizeof(std::uint32_t));
                to += some;
            }
        }
        if (isCut) {
            keepNearest(run, run.queries.number[slot], state);
            count = mRow.size();
            reserve(count + RowSink::kPad);
            std::copy(mRow.begin(), mRow.end(), sink.out);
        }
        sink.rowBegin[slot - sink.slotBase] = sink.out;
        sink.rowCount[slot - sink.slotBase] = static_cast<std::uint32_t>(count);
        sink.out += count;
        if (sink.isPadded && count > 0) {
            const std::size_t pads = (RowSink::kPad - count % RowSink::kPad) % RowSink::kPad;
            sink.out = std::fill_n(sink.out, pads, sink.out[-1]);
        }
        sink.nextSlot = slot + 1;
    }
}

void LayeredRows::make(const SearchRun& run, RowKind kind, const SearchTask& task, ThreadState& state,
                       RowSink& sink)
{
    for (const std::unique_ptr<Share>& share : mShares) share->isEmpty = true;
    if (run.context.sets.nearest > 0 && mOrderedBy != &run.exact) {
        mOrder.emplace(run.exact);
        mOrderedBy = &run.exact;
    }
    if (kind == RowKind::kMask) {
        sink.grow(sink, listWork(run, task).maskBytes / sizeof(std::uint32_t));
        sink.taskBegin = sink.out;
    }
    for (SearchTask some = task; some.firstSlot < task.endSlot;) {
        const std::uint32_t rows = std::min(mMostRows, task.endSlot - some.firstSlot);
        some.endSlot = some.firstSlot + rows;
        mMayBeFull = rows > 2;
        const std::uint64_t exactPairs = state.exactPairs;
        try {
            makeShares(run, kind, some, state);
        } catch (const Full&) {
            state.exactPairs = exactPairs; // they are decided again
            mMostRows = std::max<std::uint32_t>(2, rows / 2);
            continue;
        }
        if (kind == RowKind::kCount) {
            addCounts(some, sink);
        } else if (kind == RowKind::kMask) {
            joinMasks(run, some, sink);
        } else {
            joinNumbers(run, some, state, sink);
        }
        some.firstSlot = some.endSlot;
        if (mBytes < kMostBytes / 4 && rows == mMostRows && rows < kMostRows) mMostRows = 2 * rows;
    }
    if (mBytes > kMostBytes) mShares.clear(); // of a crowd
}

} // namespace vdb_nns
