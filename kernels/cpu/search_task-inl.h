// The search of one task, for the instruction set of the including file: which queries are tested against which candidates.
// Knows frames and the ways to gather them; what becomes of the hits is the consumer's (search_rows-inl.h). Internal linkage
// throughout, and nothing of the standard library that could leave a copy compiled with these flags for other files to use.
//
//   sparse leaves: every query against all particles of the leaf and its halo
//   few cells:     (task.cells) the queries of each against the particles of the cells in its reach
//   others:        for each occupied cell, gather() keeps the candidates near the ball of the cell's queries;
//                  each query is tested against those, a vector at a time
// All take candidates in the same order, by cell (x, y, z) lexicographic and by number inside a cell.
#pragma once

#include "cpu/consume_count-inl.h"
#include "cpu/consume_index-inl.h"
#include "cpu/consume_mask-inl.h"
#include "cpu/pace-inl.h"

namespace vdb_nns {
namespace {

// A leaf is sparse when leaf and halo together hold no more particles than this: then testing them all takes about as
// many vectors a query as a dense cell's kept candidates, and saves the table of cells, balls and gathering. On spray 256
// is 5 % of the search faster than 160 and as fast as 400.
constexpr std::uint32_t kSparseMost = 512;

// Searches a sparse leaf. False, and nothing done, when it is not sparse.
template <typename Consumer>
bool searchSparse(const SearchContext& context, const SearchTask& task, const LeafCells* leaves,
                  RowTest& test, HaloScratch& scratch, RowSink& sink)
{
    if (task.endSlot - task.firstSlot > kSparseMost) return false;
    HaloRun runs[kSparseMost + 1]; // each holds a particle at least
    std::uint32_t runCount = 0, slabStart[HaloScratch::kMaxSide + 1];
    const std::uint32_t particles = listRuns(context.block, leaves, kSparseMost, runs, runCount, slabStart);
    if (particles > kSparseMost) return false;
    copyRuns(context.block, runs, runCount, scratch);
    Consumer consumer(scratch, sink);
    std::uint32_t at = 0;
    for (std::uint32_t r = 0; r < runCount; at += runs[r].end - runs[r].begin, ++r) {
        if (runs[r].leaf != kOwnLeaf) continue;
        const SlotRange slots(task, runs[r].begin, runs[r].end);
        if (slots.empty()) continue;
        // The last vector may hold particles of the next slab: those are out of reach, so the test says no.
        const int slab = runs[r].slab, reach = context.block.reach;
        const std::uint32_t from = slabStart[slab - reach], to = slabStart[slab + reach + 1];
        const HaloFrame frame{scratch.halo() + std::size_t(from) * sizeof(float), scratch.stride, to - from};
        const std::uint32_t self = at - from + (slots.begin - runs[r].begin);
        searchRows(consumer, frame, {self, slots.count(), slots.begin, frame.count}, test);
    }
    consumer.finish();
    return true;
}

// Says that the first `candidates` are kept, as gather() would.
inline void keepAll(std::uint64_t* keepBits, std::uint32_t candidates)
{
    for (std::uint32_t w = 0; w < candidates / 64; ++w) keepBits[w] = ~std::uint64_t(0);
    keepBits[candidates / 64] = (std::uint64_t(1) << candidates % 64) - 1;
}

// Searches the cells of task.cells, each by itself: for so few that the halo of the whole leaf would cost more.
template <typename Consumer>
void searchCells(const SearchContext& context, const SearchTask& task, const LeafCells* leaves, RowTest& test,
                 HaloScratch& scratch, RowSink& sink)
{
    Pace pace(context);
    Consumer consumer(scratch, sink);
    const std::uint32_t* cellStart = context.block.cellStart + context.block.leaves[task.leaf].firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaves[kOwnLeaf].word[x]; word; word &= word - 1, ++cellStart) {
            const int bit = __builtin_ctzll(word);
            const SlotRange slots(task, cellStart[0], cellStart[1]);
            if (!(task.cells[x] >> bit & 1) || slots.empty()) continue;
            std::uint32_t self = 0;
            const std::uint32_t candidates =
                copyReach(context.block, leaves, x, bit >> 3, bit & 7, scratch, self);
            if constexpr (Consumer::kByCandidate) {
                keepAll(scratch.keepBits(), candidates);
                consumer.reserve(std::size_t(slots.count()) * rowWordsOf(candidates));
            }
            const HaloFrame frame{scratch.halo(), scratch.stride, candidates};
            self += slots.begin - cellStart[0];
            pace.run({self, slots.count(), slots.begin, candidates}, candidates,
                     [&](const Queries& part) { searchRows(consumer, frame, part, test); });
        }
    }
    consumer.finish();
}

// kHalf: if the task is a whole leaf, and not a sparse one, each pair of it stands in one row only, that of the query that is visited later;
// then sink.areHalf is true.
template <typename Consumer, bool kHalf = false>
void searchTask(const SearchContext& context, const SearchTask& task, const ExactPredicate& exact,
                HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    if constexpr (kHalf) {
        const LeafRecord* const leaf = context.block.leaves + task.leaf;
        if (task.cells || task.firstSlot != leaf[0].firstSlot || task.endSlot != leaf[1].firstSlot)
            return searchTask<Consumer>(context, task, exact, scratch, sink, statistics);
    }
    LeafCells leaves[kLeavesAround];
    const std::size_t particles = readLeaves(context.block, task.neighborhood, leaves);
    scratch.reserve(scratch, particles);
    RowTest test{context.bounds, exact, statistics};
    if (task.cells) return searchCells<Consumer>(context, task, leaves, test, scratch, sink);
    if constexpr (!Consumer::kByCandidate) {
        if (searchSparse<Consumer>(context, task, leaves, test, scratch, sink)) return;
    }
    if constexpr (kHalf) sink.areHalf = true;
    fillHalo(context.block, leaves, scratch);
    Pace pace(context);
    pace.copied(particles);
    Consumer consumer(scratch, sink);
    if constexpr (Consumer::kByCandidate) consumer.reserve(rowWordsOf(context.block, task, scratch));
    forEachCell(context.block, task, scratch,
                [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
                    gather<Consumer::kByCandidate, kHalf>(context, scratch, lowest, cell);
                    const CellFrame<kHalf> frame{scratch.kept(), scratch.stride, cell.kept};
                    pace.run({cell.self, cell.queries, firstSlot, cell.candidates}, cell.kept,
                             [&](const Queries& part) { searchRows(consumer, frame, part, test); });
                });
    consumer.finish();
}

} // namespace
} // namespace vdb_nns
