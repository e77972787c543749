// A grid as tasks of the CPU: which queries a task has, and how all of them are run. Knows the grid and TBB, not what a task does.
#pragma once

#include "cpu/search_task.h"
#include "grid/sparse_grid_data.h"
#include "lists/cell_candidates.h"
#include "search/thread_state.h"
#include "util/cancel.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <vector>

namespace vdb_nns {

// `cancel` outlives it.
inline CancelPoll pollOf(const CancelCheck& cancel)
{
    return {&cancel, [](const void* state) { static_cast<const CancelCheck*>(state)->check(); }};
}

// Queries of one leaf.
struct Piece {
    std::uint32_t leaf, firstSlot, endSlot;
};

// A leaf each; leaves with many particles in pieces, small enough to keep all threads of the arena busy to the end, large
// enough that filling the halo again for each piece stays below a few per cent of its tests.
std::vector<Piece> makePieces(const SparseGridData& grid);

// Runs `run(state, task)` for the pieces of the queries' grid; tasks have the leaves of the candidates' grid around them.
template <typename Run>
void forEachTask(const SparseGridData& queriesGrid, const SparseGridData& candidates,
                 const std::vector<Piece>& pieces, ThreadStates& states, const CancelCheck& cancel, Run&& run)
{
    std::atomic<std::uint64_t> done{0};
    const std::size_t grain = std::clamp<std::size_t>(pieces.size() / 4096, 1, 64);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pieces.size(), grain), [&](const auto& range) {
        ThreadState& state = states.local();
        const std::uint32_t firstLeaf = pieces[range.begin()].leaf,
                            endLeaf = pieces[range.end() - 1].leaf + 1;
        state.neighborhoods.resize(endLeaf - firstLeaf);
        queriesGrid.neighborhoodsInReach(candidates, firstLeaf, endLeaf, state.neighborhoods.data());
        std::uint64_t queries = 0;
        for (std::size_t p = range.begin(); p < range.end(); ++p) {
            cancel.check();
            const Piece& piece = pieces[p];
            run(state, SearchTask{piece.leaf, piece.firstSlot, piece.endSlot,
                                  state.neighborhoods[piece.leaf - firstLeaf].leaf});
            queries += piece.endSlot - piece.firstSlot;
        }
        const std::uint64_t total = done.fetch_add(queries) + queries;
        cancel.update(static_cast<double>(total) / static_cast<double>(queriesGrid.particleCount()));
    });
}

// Calls f(task) for each cell of a task with cells, as masks want them: one by itself, with its own slots.
template <typename F>
void forEachWantedCell(const BlockView& block, const SearchTask& task, F&& f)
{
    const LeafRecord& leaf = block.leaves[task.leaf];
    const std::uint32_t* cell = block.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
            const std::uint32_t begin = std::max(cell[0], task.firstSlot),
                                end = std::min(cell[1], task.endSlot);
            const std::uint64_t bit = word & -word;
            if (!(task.cells[x] & bit) || begin >= end) continue;
            std::uint64_t alone[8] = {};
            alone[x] = bit;
            f(SearchTask{task.leaf, begin, end, task.neighborhood, alone});
        }
    }
}

// Calls f(queries, candidates) for each cell with queries of a task: how many, and the candidates of the cells in reach.
template <typename F>
void forEachCandidateCount(const BlockView& queries, const BlockView& candidates, const SearchTask& task,
                           F&& f)
{
    LeafNeighborhood neighborhood;
    std::copy_n(task.neighborhood, kLeavesAround, neighborhood.leaf);
    forEachOccupiedCell(queries, candidates, task.leaf, neighborhood, task.wide,
                        [&](const OccupiedCell& cell) {
                            if (task.cells && !(task.cells[cell.x] & cell.bit())) return;
                            const std::uint32_t begin = std::max(cell.begin, task.firstSlot),
                                                end = std::min(cell.end, task.endSlot);
                            if (begin < end) f(end - begin, cell.candidates);
                        });
}

// Bytes of the mask rows of a task.
inline std::uint64_t maskBytes(const BlockView& queriesBlock, const BlockView& candidatesBlock,
                               const SearchTask& task)
{
    std::uint64_t words = 0;
    forEachCandidateCount(
        queriesBlock, candidatesBlock, task,
        [&](std::uint64_t queries, std::uint64_t candidates) { words += queries * maskWords(candidates); });
    return words * sizeof(std::uint32_t);
}

} // namespace vdb_nns
