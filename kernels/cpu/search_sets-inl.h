// The search of one task whose queries need not be the candidates: groups, two sets of points, radii of particles, the nearest.
// The same ways to find candidates as in search_task-inl.h, and the same order; queries are read from their own block, and the
// leaf that they are in may hold no candidate. Internal linkage.
#pragma once

#include "cpu/consume_count-inl.h"
#include "cpu/consume_index-inl.h"
#include "cpu/consume_mask-inl.h"
#include "cpu/consume_nearest-inl.h"
#include "cpu/pace-inl.h"
#include "cpu/search_task-inl.h"
#include "cpu/test_sets-inl.h"

namespace vdb_nns {
namespace {

template <typename Consumer>
inline Consumer makeConsumer(const SearchContext&, const ExactPredicate&, HaloScratch& scratch, RowSink& sink,
                             TaskStatistics&, Consumer*)
{
    return Consumer(scratch, sink);
}

template <typename Target>
inline NearestRows<Target> makeConsumer(const SearchContext& context, const ExactPredicate& exact,
                                        HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics,
                                        NearestRows<Target>*)
{
    return NearestRows<Target>(context, exact, scratch, sink, statistics);
}

// Of queries whose own radii decide: the largest FilterBounds::reachable of some of them.
inline float reachableOfQueries(const SearchContext& context, std::uint32_t slot, std::uint32_t count)
{
    const float* const far = context.sets.queryFar;
    if (!far) return context.bounds.reachable;
    float most = far[slot];
    for (std::uint32_t i = 1; i < count; ++i) most = far[slot + i] > most ? far[slot + i] : most;
    return reachableOf(most);
}

// What the parts of a task share.
template <typename ConsumerType, typename RuleType>
struct SetSearch {
    using Consumer = ConsumerType;
    using Rule = RuleType;

    const SearchContext& context;
    const SearchTask& task;
    const LeafCells* leaves; // of the candidates
    RowTest& test;
    HaloScratch& scratch;
    Consumer& consumer;

    const float* candidateFar() const { return context.sets.candidateFar; }

    // Against the first `count` candidates of the halo from `first` on.
    HaloSetFrame<Rule> haloFrame(std::uint32_t first, std::uint32_t count, std::uint32_t slot) const
    {
        return {scratch.halo() + std::size_t(first) * sizeof(float), scratch.stride, count,
                SetQueries(context.sets, slot, positionsOf(context.sets.queries, slot), {0, 0, 0})};
    }
};

// The first slot of the queries of each x of a leaf; the end.
inline void slabSlots(const BlockView& queries, std::uint32_t leaf, std::uint32_t* slots)
{
    const LeafRecord& record = queries.leaves[leaf];
    const std::uint32_t* cell = queries.cellStart + record.firstCell;
    for (int x = 0; x < 8; ++x) {
        slots[x] = *cell;
        cell += __builtin_popcountll(record.occupancy[x]);
    }
    slots[8] = queries.leaves[leaf + 1].firstSlot;
}

// Searches a leaf with few candidates around. False, and nothing done, when there are more.
template <typename Search>
bool searchSparseSets(const Search& search)
{
    const SearchTask& task = search.task;
    HaloRun runs[kSparseMost + 1];
    std::uint32_t runCount = 0, slabStart[HaloScratch::kMaxSide + 1];
    const BlockView& block = search.context.block;
    const std::uint32_t candidates = listRuns(block, search.leaves, kSparseMost, runs, runCount, slabStart);
    if (candidates > kSparseMost) return false;
    copyRuns<Search::Rule::kOfCandidates>(block, runs, runCount, search.scratch, search.candidateFar());
    std::uint32_t slabs[9];
    slabSlots(search.context.sets.queries, task.leaf, slabs);
    Pace pace(search.context);
    for (int x = 0; x < 8; ++x) {
        const SlotRange slots(task, slabs[x], slabs[x + 1]);
        if (slots.empty()) continue;
        // The last vector may hold candidates of the next slab, which are out of reach.
        const std::uint32_t from = slabStart[x], to = slabStart[x + 2 * block.reach + 1];
        const auto frame = search.haloFrame(from, to - from, slots.begin);
        pace.run({0, slots.count(), slots.begin, to - from}, to - from,
                 [&](const Queries& part) { searchRows(search.consumer, frame, part, search.test); });
    }
    return true;
}

// Each cell by itself, for few of them.
template <typename Search>
void searchSetCells(const Search& search)
{
    const SearchTask& task = search.task;
    const SearchContext& context = search.context;
    Pace pace(context);
    const LeafRecord& leaf = context.sets.queries.leaves[task.leaf];
    const std::uint32_t* cellStart = context.sets.queries.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cellStart) {
            const int bit = __builtin_ctzll(word);
            const SlotRange slots(task, cellStart[0], cellStart[1]);
            if ((task.cells && !(task.cells[x] >> bit & 1)) || slots.empty()) continue;
            std::uint32_t self = 0;
            const std::uint32_t candidates =
                copyReach<Search::Rule::kOfCandidates>(context.block, search.leaves, x, bit >> 3, bit & 7,
                                                       search.scratch, self, search.candidateFar());
            if constexpr (Search::Consumer::kByCandidate) {
                keepAll(search.scratch.keepBits(), candidates);
                search.consumer.reserve(std::size_t(slots.count()) * rowWordsOf(candidates));
            }
            const auto frame = search.haloFrame(0, candidates, slots.begin);
            pace.run({0, slots.count(), slots.begin, candidates}, candidates,
                     [&](const Queries& part) { searchRows(search.consumer, frame, part, search.test); });
        }
    }
}

// The queries of a cell, against those of its candidates that are near their ball.
template <typename Search>
inline void searchNear(const Search& search, Pace& pace, float reachable, const QueryPositions& positions,
                       const std::uint32_t* lowest, CellSearch& cell, std::uint32_t slot)
{
    using Rule = typename Search::Rule;
    HaloScratch& scratch = search.scratch;
    const QueryBounds where = boundsOf(reachable, positions.x, positions.y, positions.z, cell.queries);
    gatherNear<Gathered<Search::Consumer::kByCandidate, Rule::kOfCandidates>, false>(
        where, scratch, search.context.block.reach, lowest, cell);
    const KeptSetFrame<Rule> frame{scratch.kept(), scratch.stride, cell.kept,
                                   SetQueries(search.context.sets, slot, positions, where.center)};
    pace.run({0, cell.queries, slot, cell.candidates}, cell.kept,
             [&](const Queries& part) { searchRows(search.consumer, frame, part, search.test); });
}

// All cells, against the halo of the leaf.
template <typename Search>
void searchSetLeaf(const Search& search, std::size_t candidates)
{
    using Rule = typename Search::Rule;
    const SearchContext& context = search.context;
    const BlockView& queries = context.sets.queries;
    HaloScratch& scratch = search.scratch;
    fillHalo<Rule::kOfCandidates>(context.block, search.leaves, scratch, search.candidateFar());
    Pace pace(context);
    pace.copied(candidates);
    if constexpr (Search::Consumer::kByCandidate)
        search.consumer.reserve(rowWordsOf(queries, search.task, scratch));
    forEachCell(queries, search.task, scratch,
                [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
                    const float reachable = Rule::kOfCandidates
                                                ? context.bounds.reachable
                                                : reachableOfQueries(context, firstSlot, cell.queries);
                    searchNear(search, pace, reachable, positionsOf(queries, firstSlot), lowest, cell,
                               firstSlot);
                });
}

// The queries that a run of cells has, and the cell that they are in: of the leaf of candidates whose halo is filled.
struct WideQueries {
    std::uint32_t slot, count;
    const std::uint32_t* lowest; // as forEachCell() gives it
};

// Moves the queries of a task into the frame of the wide leaf that they are in.
inline void moveQueries(const SearchContext& context, const SearchTask& task, HaloScratch& scratch)
{
    const BlockView& queries = context.sets.queries;
    const float* const from[3] = {queries.x, queries.y, queries.z};
    const Simd::F scale = Simd::set(task.wide->scale);
    for (int axis = 0; axis < 3; ++axis) {
        const Simd::F shift = Simd::set(task.wide->shift[axis]);
        float* to = scratch.movedQueries(axis);
        for (std::size_t i = task.firstSlot; i < task.endSlot; i += Simd::kLanes, to += Simd::kLanes)
            Simd::store(to, Simd::mulAdd(Simd::load(from[axis] + i), scale, shift));
    }
}

// Calls f(WideQueries) for the queries of each cell of the task, or for all at once where one wide cell holds them.
template <typename F>
inline void forEachWideCell(const SearchContext& context, const SearchTask& task, const HaloScratch& halo,
                            F&& f)
{
    const WidePlace& wide = *task.wide;
    const int reach = context.block.reach, side = 8 + 2 * reach;
    const auto lowestOf = [&](int x, int y, int z) {
        return halo.start + ((wide.wideCell(0, x) + reach) * side + wide.wideCell(1, y) + reach) * side +
               wide.wideCell(2, z);
    };
    if (wide.bits == 3 && !task.cells)
        return f(WideQueries{task.firstSlot, task.endSlot - task.firstSlot, lowestOf(0, 0, 0)});
    const LeafRecord& leaf = context.sets.queries.leaves[task.leaf];
    const std::uint32_t* cellStart = context.sets.queries.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cellStart) {
            const int bit = __builtin_ctzll(word);
            const SlotRange slots(task, cellStart[0], cellStart[1]);
            if ((task.cells && !(task.cells[x] >> bit & 1)) || slots.empty()) continue;
            f(WideQueries{slots.begin, slots.count(), lowestOf(x, bit >> 3, bit & 7)});
        }
    }
}

// All queries of the task against candidates in wider cells.
template <typename Search>
void searchWide(const Search& search)
{
    const SearchContext& context = search.context;
    const SearchTask& task = search.task;
    HaloScratch& scratch = search.scratch;
    const int reach = context.block.reach;
    CellBox box;
    for (int axis = 0; axis < 3; ++axis) {
        box.low[axis] = task.wide->wideCell(axis, 0) - reach;
        box.high[axis] = task.wide->wideCell(axis, 7) + reach;
    }
    Pace pace(context);
    pace.copied(fillHaloBox<true>(context.block, search.leaves, box, scratch, search.candidateFar()));
    moveQueries(context, task, scratch);
    if constexpr (Search::Consumer::kByCandidate) {
        std::size_t words = 0;
        forEachWideCell(context, task, scratch, [&](const WideQueries& part) {
            words += std::size_t(part.count) * rowWordsOf(candidatesOf(reach, part.lowest));
        });
        search.consumer.reserve(words);
    }
    forEachWideCell(context, task, scratch, [&](const WideQueries& part) {
        const std::uint32_t first = part.slot - task.firstSlot;
        const QueryPositions positions{scratch.movedQueries(0) + first, scratch.movedQueries(1) + first,
                                       scratch.movedQueries(2) + first};
        CellSearch cell{};
        cell.queries = part.count;
        searchNear(search, pace, context.bounds.reachable, positions, part.lowest, cell, part.slot);
    });
}

// Whether so few cells of a leaf have queries that each is searched by itself.
inline bool hasFewCells(const BlockView& queries, std::uint32_t leaf, int reach)
{
    const std::uint32_t cells = queries.leaves[leaf + 1].firstCell - queries.leaves[leaf].firstCell;
    const auto side = static_cast<std::uint32_t>(2 * reach + 1),
               cube = static_cast<std::uint32_t>(8 + 2 * reach);
    return cells * side * side * side < cube * cube * cube;
}

template <typename Consumer, typename Rule>
void searchSets(const SearchContext& context, const SearchTask& task, const ExactPredicate& exact,
                HaloScratch& scratch, RowSink& sink, TaskStatistics& statistics)
{
    LeafCells leaves[kLeavesAround];
    const std::size_t candidates = readLeaves(context.block, task.neighborhood, leaves);
    const std::size_t queries = task.wide ? task.endSlot - task.firstSlot : 0;
    scratch.reserve(scratch, candidates > queries ? candidates : queries);
    RowTest test{context.bounds, exact, statistics};
    Consumer consumer =
        makeConsumer(context, exact, scratch, sink, statistics, static_cast<Consumer*>(nullptr));
    const SetSearch<Consumer, Rule> search{context, task, leaves, test, scratch, consumer};
    const auto run = [&] {
        if constexpr (Rule::kOfCandidates) {
            if (task.wide) return searchWide(search);
        }
        if (task.cells) return searchSetCells(search);
        if constexpr (!Consumer::kByCandidate) {
            if (searchSparseSets(search)) return;
            if (hasFewCells(context.sets.queries, task.leaf, context.block.reach))
                return searchSetCells(search);
        }
        searchSetLeaf(search, candidates);
    };
    run();
    consumer.finish();
}

} // namespace
} // namespace vdb_nns
