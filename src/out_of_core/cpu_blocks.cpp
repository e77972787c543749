#include "out_of_core/cpu_blocks.h"

#include "util/wall_clock.h"

#include <algorithm>
#include <memory>
#include <vector>

namespace vdb_nns {

namespace {

// On average: jobs are timed by what their queries are taken to cost.
double testsPerQuery(const PendingBlock& block, std::uint64_t queries)
{
    return queries > 0 ? static_cast<double>(block.item.tests) / static_cast<double>(queries) : 0;
}

} // namespace

void CpuBlocks::start(const PendingBlock& block)
{
    constexpr std::size_t kPiecesOfJob = 32;
    const std::vector<Piece>& pieces = mRun.pieces;
    const auto first = std::partition_point(pieces.begin(), pieces.end(), [&](const Piece& piece) {
        return piece.endSlot <= block.part.firstSlot;
    });
    const auto last = std::partition_point(
        first, pieces.end(), [&](const Piece& piece) { return piece.firstSlot < block.part.endSlot; });
    const auto end = static_cast<std::size_t>(last - pieces.begin());
    const auto part = std::make_shared<const BlockPart>(block.part);
    const double each = testsPerQuery(block, wantedQueries(mRun.queries, block.part));
    for (auto p = static_cast<std::size_t>(first - pieces.begin()); p < end; p += kPiecesOfJob) {
        mJobs.add([this, number = block.block, p, stop = std::min(p + kPiecesOfJob, end), part, each] {
            timeJob(each, [&] { return runPieces(number, p, stop, *part); });
        });
    }
}

void CpuBlocks::stage(PendingBlock& block)
{
    if (block.isStaged) return;
    makeHalo(mRun.queries, block);
    const double each = testsPerQuery(block, block.queries());
    for (const CellSet& set : block.part.without) {
        mJobs.add([this, number = block.block, set, first = block.part.firstSlot, end = block.part.endSlot,
                   each] { timeJob(each, [&] { return runBoundaryLeaf(number, set, first, end); }); });
    }
    block.isStaged = true;
}

template <typename Job>
void CpuBlocks::timeJob(double testsPerQuery, Job&& job)
{
    const double start = wallSeconds();
    const std::uint64_t queries = job();
    mNanoseconds += static_cast<std::uint64_t>(1e9 * (wallSeconds() - start));
    mTests += static_cast<std::uint64_t>(testsPerQuery * static_cast<double>(queries));
}

// Runs the queries of a part that are in some pieces.
std::uint64_t CpuBlocks::runPieces(std::size_t block, std::size_t first, std::size_t end,
                                   const BlockPart& part)
{
    std::uint64_t queries = 0;
    for (std::size_t p = first; p < end; ++p) {
        mRun.cancel.check();
        const Piece& piece = mRun.pieces[p];
        LeafNeighborhood neighborhood;
        mRun.queries.neighborhoodsInReach(piece.leaf, piece.leaf + 1, &neighborhood);
        std::uint64_t cells[8];
        queries += runTask(block, {piece.leaf, std::max(piece.firstSlot, part.firstSlot),
                                   std::min(piece.endSlot, part.endSlot), neighborhood.leaf,
                                   wantedCells(mRun.queries, part, piece.leaf, cells)});
    }
    mTargets.progress.show();
    return queries;
}

std::uint64_t CpuBlocks::runBoundaryLeaf(std::size_t block, const CellSet& set, std::uint32_t firstSlot,
                                         std::uint32_t endSlot)
{
    const SparseGridData& grid = mRun.queries;
    mRun.cancel.check();
    LeafNeighborhood neighborhood;
    grid.topology.neighborhoods({&grid.leafOrigins[set.leaf], 1}, &neighborhood);
    return runTask(block,
                   {set.leaf, std::max(firstSlot, grid.leaves[set.leaf].firstSlot),
                    std::min(endSlot, grid.leaves[set.leaf + 1].firstSlot), neighborhood.leaf, set.cells});
}

std::uint64_t CpuBlocks::runTask(std::size_t block, const SearchTask& task)
{
    EngineState& engine = mTargets.engine;
    const auto makeRows = [&](const SearchTask& rows, ThreadState& state) {
        engine.makeRows(mRun, rows, state, mTargets.pool, mTargets.lists);
    };
    const bool isMask = mTargets.lists.encoding == Encoding::kMask;
    ThreadState& state = engine.states.local();
    const std::uint64_t before = state.statistics.pairs;
    std::uint64_t queries = task.endSlot - task.firstSlot;
    if (task.cells) {
        queries = 0;
        forEachWantedCell(mRun.context.block, task, [&](const SearchTask& cell) {
            queries += cell.endSlot - cell.firstSlot;
            if (isMask) makeRows(cell, state);
        });
    }
    if (!task.cells || !isMask) makeRows(task, state);
    mTargets.progress.addPairs(block, state.statistics.pairs - before);
    mTargets.progress.addCpuQueries(queries);
    return queries;
}

} // namespace vdb_nns
