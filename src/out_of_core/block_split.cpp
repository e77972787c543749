#include "out_of_core/block_split.h"

#include "lists/cell_candidates.h"
#include "plan/block_halo.h"
#include "search/leaf_tasks.h"
#include "shared/block_result.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <numeric>
#include <string>

namespace vdb_nns {

namespace {

constexpr int kAnyLeaves = 3; // for haloOf(): any range of leaves, not a cube

// Leaves and queries of a part.
struct Range {
    std::uint32_t firstLeaf, endLeaf, firstSlot, endSlot;
};

// Of the queries that a part has.
struct PartWork {
    std::uint64_t tests = 0, maskWords = 0;
};

PartWork workOf(const SparseGridData& grid, const BlockPart& part)
{
    PartWork work;
    std::vector<LeafNeighborhood> neighborhoods(part.endLeaf - part.firstLeaf);
    grid.neighborhoodsInReach(part.firstLeaf, part.endLeaf, neighborhoods.data());
    for (std::uint32_t l = part.firstLeaf; l < part.endLeaf; ++l) {
        std::uint64_t cells[8];
        const SearchTask task{l, std::max(part.firstSlot, grid.leaves[l].firstSlot),
                              std::min(part.endSlot, grid.leaves[l + 1].firstSlot),
                              neighborhoods[l - part.firstLeaf].leaf, wantedCells(grid, part, l, cells)};
        forEachCandidateCount(blockViewOf(grid), blockViewOf(grid), task,
                              [&](std::uint64_t queries, std::uint64_t candidates) {
                                  work.tests += queries * candidates;
                                  work.maskWords += queries * ((candidates + 31) / 32);
                              });
    }
    return work;
}

class Splitter {
public:
    Splitter(const SparseGridData& grid, const MemoryModel& model, const KnownCounts& counts,
             std::uint64_t mostBytes)
        : mGrid(grid), mModel(model), mCounts(counts), mMostBytes(mostBytes)
    {
    }

    void split(const PendingBlock& whole);
    BlockSplit takeResult() { return std::move(mResult); }

private:
    PendingBlock partOf(const PendingBlock& whole, const Range& range) const;
    BlockBytes bytesOf(const PendingBlock& part, std::uint64_t maskWords) const;
    Range firstHalf(const PendingBlock& whole) const;

    const SparseGridData& mGrid;
    const MemoryModel& mModel;
    const KnownCounts mCounts;
    const std::uint64_t mMostBytes;
    BlockSplit mResult;
};

void Splitter::split(const PendingBlock& whole)
{
    const BlockPart& part = whole.part;
    if (whole.queries() <= Block::kFewestQueries) {
        PendingBlock known = partOf(whole, {part.firstLeaf, part.endLeaf, part.firstSlot, part.endSlot});
        const bool fits = known.item.isExact && known.item.bytes.total() <= mMostBytes;
        (fits ? mResult.parts : mResult.tooLarge).push_back(std::move(known));
        return;
    }
    const bool isLeaf = part.endLeaf - part.firstLeaf == 1;
    const Range half = firstHalf(whole);
    const PendingBlock first = partOf(whole, half);
    const PendingBlock second =
        partOf(whole, {isLeaf ? part.firstLeaf : half.endLeaf, part.endLeaf, half.endSlot, part.endSlot});
    // A leaf's particles and halo stay with every part of it.
    if (isLeaf && first.item.bytes.up > mMostBytes) {
        mResult.tooLarge.push_back(whole);
        return;
    }
    // The second first: what is added last is taken first.
    for (const PendingBlock* own : {&second, &first}) {
        if (mCounts.count && mMostBytes > 0 && own->item.bytes.total() > mMostBytes) {
            split(*own);
        } else {
            mResult.parts.push_back(*own);
        }
    }
}

// Where the particles are halved; between leaves if there are several, and then each half has one at least.
Range Splitter::firstHalf(const PendingBlock& whole) const
{
    const BlockPart& part = whole.part;
    const std::uint32_t middle = part.firstSlot + static_cast<std::uint32_t>(whole.queries() / 2);
    if (part.endLeaf - part.firstLeaf == 1) return {part.firstLeaf, part.endLeaf, part.firstSlot, middle};
    const auto end = std::partition_point(mGrid.leaves.begin() + part.firstLeaf + 1,
                                          mGrid.leaves.begin() + part.endLeaf - 1,
                                          [&](const LeafRecord& l) { return l.firstSlot < middle; });
    const auto leaf = static_cast<std::uint32_t>(end - mGrid.leaves.begin());
    return {part.firstLeaf, leaf, part.firstSlot, mGrid.leaves[leaf].firstSlot};
}

PendingBlock Splitter::partOf(const PendingBlock& whole, const Range& range) const
{
    PendingBlock half = whole;
    half.part = {range.firstLeaf,
                 range.endLeaf,
                 range.firstSlot,
                 range.endSlot,
                 haloOf(mGrid, range.firstLeaf, range.endLeaf, kAnyLeaves).halo,
                 {}};
    for (const CellSet& set : whole.part.without) {
        if (set.leaf >= range.firstLeaf && set.leaf < range.endLeaf) half.part.without.push_back(set);
    }
    half.withHalo = half.isStaged = true;
    half.expectedPairs =
        whole.expectedPairs * static_cast<double>(half.queries()) / static_cast<double>(whole.queries());
    const PartWork work = workOf(mGrid, half.part);
    half.item.outsideTests = 0;
    half.item.tests = work.tests;
    half.item.isExact = mCounts.count || mModel.encoding != Encoding::kIndex;
    // The smallest parts are tried whatever is feared of them.
    half.item.isTried = mCounts.count || half.queries() <= Block::kFewestQueries;
    half.item.bytes = bytesOf(half, work.maskWords);
    return half;
}

BlockBytes Splitter::bytesOf(const PendingBlock& part, std::uint64_t maskWords) const
{
    using M = MemoryModel;
    constexpr double kUndecidedMargin = 1.25; // queries of a part may have more than those of the whole
    const std::uint64_t queries = part.queries();
    const auto undecided =
        static_cast<std::uint64_t>(kUndecidedMargin * part.undecidedPerQuery * static_cast<double>(queries));
    BlockBytes bytes;
    bytes.up = imageBytes(mGrid, part.part);
    bytes.down = M::kResultBytes + queries * M::kCountBytes + undecidedRoom(queries) +
                 undecided * sizeof(UndecidedPair);
    bytes.scratch = scratchBytes(queries, mModel.encoding);
    if (mModel.encoding == Encoding::kMask) {
        const std::uint64_t leaves = part.part.endLeaf - part.part.firstLeaf;
        bytes.down += maskWords * sizeof(std::uint32_t) + leaves * M::kMaskLeafBytes + M::kMaskBlockBytes;
    } else if (mModel.encoding == Encoding::kIndex && mCounts.count) {
        bytes.down += mCounts.sum(part.part.firstSlot, part.part.endSlot) * M::kNeighborBytes;
    } else if (mModel.encoding == Encoding::kIndex) {
        const double pairs = part.expectedPairs * (1 + mModel.margin);
        bytes.down += static_cast<std::uint64_t>(pairs < 0x1p58 ? pairs : 0x1p58) * M::kNeighborBytes;
    }
    return bytes;
}

bool isOf(const SparseGridData& grid, const Block& block, std::uint64_t firstSlot)
{
    return block.firstSlot == firstSlot && block.endSlot > block.firstSlot &&
           block.endLeaf <= grid.leafCount() && block.firstLeaf < block.endLeaf &&
           block.firstSlot >= grid.leaves[block.firstLeaf].firstSlot &&
           block.endSlot <= grid.leaves[block.endLeaf].firstSlot;
}

} // namespace

std::vector<PendingBlock> pendingBlocksOf(const SparseGridData& grid, const Schedule& schedule)
{
    std::vector<PendingBlock> blocks;
    std::uint64_t next = 0; // slot that the next block begins with
    for (const Block& planned : schedule.blocks) {
        const std::size_t number = blocks.size();
        if (!isOf(grid, planned, next)) {
            throw InvalidInput("block " + std::to_string(number) + " of the schedule is not of this grid");
        }
        next = planned.endSlot;
        PendingBlock& block = blocks.emplace_back();
        block.block = number;
        block.item = {number, planned.work.candidateTests, boundaryTests(planned), planned.bytes,
                      schedule.model.encoding != Encoding::kIndex};
        block.part = {planned.firstLeaf,
                      planned.endLeaf,
                      static_cast<std::uint32_t>(planned.firstSlot),
                      static_cast<std::uint32_t>(planned.endSlot),
                      {},
                      {}};
        block.log2Cells = planned.log2Cells;
        block.withHalo = planned.withHalo;
        block.expectedPairs = planned.work.expectedPairs;
    }
    if (next != grid.particleCount()) {
        throw InvalidInput("a schedule of " + std::to_string(next) + " queries is not of a grid with " +
                           std::to_string(grid.particleCount()) + " particles");
    }
    return blocks;
}

void makeHalo(const SparseGridData& grid, PendingBlock& block)
{
    BlockHalo halo = haloOf(grid, block.part.firstLeaf, block.part.endLeaf, block.log2Cells);
    if (block.withHalo) {
        block.part.halo = std::move(halo.halo);
    } else {
        block.part.without = std::move(halo.boundary);
    }
}

const std::uint64_t* wantedCells(const SparseGridData& grid, const BlockPart& part, std::uint32_t leaf,
                                 std::uint64_t (&cells)[8])
{
    const auto without =
        std::lower_bound(part.without.begin(), part.without.end(), leaf,
                         [](const CellSet& set, std::uint32_t wanted) { return set.leaf < wanted; });
    if (without == part.without.end() || without->leaf != leaf) return nullptr;
    for (int x = 0; x < 8; ++x) cells[x] = grid.leaves[leaf].occupancy[x] & ~without->cells[x];
    return cells;
}

std::uint64_t wantedQueries(const SparseGridData& grid, const BlockPart& part)
{
    std::uint64_t queries = part.endSlot - part.firstSlot;
    for (const CellSet& set : part.without) {
        const SearchTask task{set.leaf, part.firstSlot, part.endSlot, nullptr, set.cells};
        forEachWantedCell(blockViewOf(grid), task,
                          [&](const SearchTask& cell) { queries -= cell.endSlot - cell.firstSlot; });
    }
    return queries;
}

std::uint64_t KnownCounts::sum(std::uint32_t begin, std::uint32_t end) const
{
    return std::accumulate(count + (begin - firstSlot), count + (end - firstSlot), std::uint64_t(0));
}

BlockSplit splitBlock(const SparseGridData& grid, const MemoryModel& model, const PendingBlock& whole,
                      const KnownCounts& counts, std::uint64_t mostBytes)
{
    Splitter splitter(grid, model, counts, mostBytes);
    splitter.split(whole);
    return splitter.takeResult();
}

} // namespace vdb_nns
