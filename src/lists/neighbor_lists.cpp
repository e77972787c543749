// Reading neighbor lists. See neighbor_lists_data.h for the layout.
#include "vdb_nns/neighbor_lists.h"

#include "grid/sparse_grid_data.h"
#include "lists/cell_candidates.h"
#include "lists/neighbor_lists_data.h"
#include "lists/row_checksum.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>

namespace vdb_nns {

namespace {

void requireLists(const NeighborListsData& lists)
{
    if (lists.encoding == Encoding::kNone) {
        throw InvalidInput("only counts were asked for: search with encoding index or mask to read lists");
    }
}

// Appends the numbers of the set bits of one row.
void decodeRow(const CandidateRuns& candidates, const std::uint32_t* words, std::vector<std::uint32_t>& out)
{
    for (const CandidateRuns::Run& run : candidates.runs) {
        const std::uint64_t end = run.firstBit + run.count;
        for (std::uint64_t at = run.firstBit; at < end;) {
            std::uint32_t word = words[at / 32] >> at % 32;
            const std::uint64_t next = std::min(end, (at / 32 + 1) * 32);
            if (next - at < 32) word &= (1u << (next - at)) - 1;
            for (; word; word &= word - 1)
                out.push_back(run.numbers[(at - run.firstBit) + __builtin_ctz(word)]);
            at = next;
        }
    }
}

const MaskRun& runOf(const std::vector<MaskRun>& runs, std::uint32_t slot)
{
    return *std::prev(
        std::upper_bound(runs.begin(), runs.end(), slot,
                         [](std::uint32_t s, const MaskRun& run) { return s < run.firstSlot; }));
}

// Hands out each cell's rows, cut where a task of the search ended: f(first slot, end slot, candidates, first row). Slots are those
// of the part.
template <typename F>
void forEachMaskCell(const NeighborListsData& lists, const SearchPart& part, std::size_t firstLeaf,
                     std::size_t endLeaf, F&& f)
{
    const SparseGridData& grid = *part.queries;
    std::vector<LeafNeighborhood> neighborhoods(endLeaf - firstLeaf);
    part.own.candidates->topology.neighborhoods({grid.leafOrigins.data() + firstLeaf, endLeaf - firstLeaf},
                                                neighborhoods.data());
    CellCandidates candidates(part);
    auto run = &runOf(lists.maskRuns, part.firstRow + grid.leaves[firstLeaf].firstSlot);
    const std::uint32_t* words = run->words;
    const MaskRun* const last = &lists.maskRuns.back();
    for (std::size_t l = firstLeaf; l < endLeaf; ++l) {
        candidates.beginLeaf(l, neighborhoods[l - firstLeaf]);
        forEachOccupiedCell(blockViewOf(grid), static_cast<std::uint32_t>(l), [&](const QueryCell& cell) {
            const CandidateRuns& runs = candidates.of(cell.x, cell.y, cell.z);
            for (std::uint32_t begin = cell.begin; begin < cell.end;) {
                const std::uint32_t row = part.firstRow + begin;
                while (run != last && run[1].firstSlot <= row) words = (++run)->words;
                const std::uint32_t stop =
                    run == last ? cell.end : std::min(cell.end, run[1].firstSlot - part.firstRow);
                f(begin, stop, runs, words);
                words += std::size_t(stop - begin) * runs.words;
                begin = stop;
            }
        });
    }
}

void makeDirectory(const NeighborListsData& lists)
{
    // Tasks of a search begin with a leaf or inside one, so walking from the first leaf meets every task's start.
    std::vector<MaskRun>& directory = lists.directory;
    directory.reserve(lists.sets.cellCount() +
                      lists.maskRuns.size()); // a cell is cut where a task of the search ended
    for (const SearchPart& part : lists.sets.data().parts) {
        if (part.queries->leafCount() == 0) continue;
        forEachMaskCell(
            lists, part, 0, part.queries->leafCount(),
            [&](std::uint32_t begin, std::uint32_t, const CandidateRuns&, const std::uint32_t* words) {
                directory.push_back({part.firstRow + begin, words});
            });
    }
    lists.directoryBytes = directory.size() * sizeof(MaskRun);
}

// Finds the cell of a row's query: its leaf, then its place in it.
void decodeSlot(const NeighborListsData& lists, std::uint32_t row, std::vector<std::uint32_t>& out)
{
    const SearchPart& part = lists.partOf(row);
    const SparseGridData& grid = *part.queries;
    const std::uint32_t slot = row - part.firstRow;
    const auto next =
        std::upper_bound(grid.leaves.begin(), grid.leaves.end(), slot,
                         [](std::uint32_t s, const LeafRecord& leaf) { return s < leaf.firstSlot; });
    const std::size_t leafIndex = static_cast<std::size_t>(next - grid.leaves.begin()) - 1;
    const LeafRecord& leaf = grid.leaves[leafIndex];
    const std::uint32_t* const cells = grid.cellStart.data() + leaf.firstCell;
    const std::uint32_t* const cellEnd = grid.cellStart.data() + next->firstCell;
    auto k = static_cast<std::uint32_t>(std::upper_bound(cells, cellEnd, slot) - cells - 1);
    LeafNeighborhood neighborhood;
    part.own.candidates->topology.neighborhoods({&grid.leafOrigins[leafIndex], 1}, &neighborhood);
    int x = 0;
    std::uint64_t word = leaf.occupancy[0];
    for (; k >= static_cast<std::uint32_t>(__builtin_popcountll(word)); word = leaf.occupancy[++x]) {
        k -= static_cast<std::uint32_t>(__builtin_popcountll(word));
    }
    for (; k > 0; --k) word &= word - 1;
    const int bit = __builtin_ctzll(word);
    CellCandidates candidates(part);
    candidates.beginLeaf(leafIndex, neighborhood);
    const CandidateRuns& runs = candidates.of(x, bit >> 3, bit & 7);
    const MaskRun& run = runOf(lists.directory, row);
    decodeRow(runs, run.words + std::size_t(row - run.firstSlot) * runs.words, out);
}

void visitPart(const NeighborListsData& lists, const SearchPart& part, const CancelCheck& cancel,
               const NeighborLists::RowVisitor& visit)
{
    constexpr std::uint64_t kNumbersBetweenChecks = std::uint64_t(1) << 20;
    const SparseGridData& grid = *part.queries;
    const auto visitLeaves = [&](std::size_t firstLeaf, std::size_t endLeaf) {
        std::uint64_t handedOut = kNumbersBetweenChecks;
        const auto handOut = [&](std::uint32_t slot, Span<const std::uint32_t> row) {
            handedOut += row.size();
            if (handedOut >= kNumbersBetweenChecks) {
                cancel.check();
                handedOut = 0;
            }
            visit(grid.number[slot], row);
        };
        if (lists.encoding == Encoding::kIndex) {
            for (std::uint32_t s = grid.leaves[firstLeaf].firstSlot; s < grid.leaves[endLeaf].firstSlot; ++s)
                handOut(s, {lists.rowBegin[part.firstRow + s], lists.rowCount[part.firstRow + s]});
            return;
        }
        std::vector<std::uint32_t> row;
        forEachMaskCell(lists, part, firstLeaf, endLeaf,
                        [&](std::uint32_t begin, std::uint32_t end, const CandidateRuns& runs,
                            const std::uint32_t* words) {
                            for (std::uint32_t s = begin; s < end; ++s, words += runs.words) {
                                row.clear();
                                decodeRow(runs, words, row);
                                handOut(s, {row.data(), row.size()});
                            }
                        });
    };
    isolatedIeee([&] {
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, grid.leafCount(), 4), [&](const auto& range) {
            isolated([&] { visitLeaves(range.begin(), range.end()); });
        });
    });
}

// NeighborLists::visitRows(). The visitor may run loops of its own, and no thread is handed another row meanwhile.
void visitAllRows(const NeighborListsData& lists, const CancelCheck& cancel,
                  const NeighborLists::RowVisitor& visit)
{
    requireLists(lists);
    for (const SearchPart& part : lists.sets.data().parts) visitPart(lists, part, cancel, visit);
}

} // namespace

NeighborLists::NeighborLists() : mData(std::make_shared<NeighborListsData>()) {}
NeighborLists::NeighborLists(std::shared_ptr<const NeighborListsData> data) : mData(std::move(data)) {}

std::size_t NeighborLists::size() const
{
    return mData->slotOf.size();
}
Encoding NeighborLists::encoding() const
{
    return mData->encoding;
}
std::uint64_t NeighborLists::pairCount() const
{
    return mData->statistics.pairs;
}
const ListStatistics& NeighborLists::statistics() const
{
    return mData->statistics;
}
const SearchSets& NeighborLists::sets() const
{
    return mData->sets;
}
const ParticleView& NeighborLists::view() const
{
    return mData->sets.candidates();
}
SparseGrid NeighborLists::grid() const
{
    return SparseGrid(mData->sets.data().parts.front().own.candidates);
}
double NeighborLists::radius() const
{
    return mData->sets.radius();
}

std::uint32_t NeighborLists::count(std::size_t i) const
{
    const std::uint32_t slot = mData->slotOf[i];
    return slot == kNoSlot ? 0 : mData->rowCount[slot] - mData->selfIn(static_cast<std::uint32_t>(i));
}

std::vector<std::uint32_t> NeighborLists::counts() const
{
    std::vector<std::uint32_t> counts(size());
    isolatedIeee([&] {
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, size(), 4096), [&](const auto& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) counts[i] = count(i);
        });
    });
    return counts;
}

Span<const std::uint32_t> NeighborLists::indices(std::size_t i) const
{
    if (mData->encoding != Encoding::kIndex) {
        throw InvalidInput("the lists are not held as indices: read them with neighbors() or visitRows()");
    }
    const std::uint32_t slot = mData->slotOf[i];
    if (slot == kNoSlot) return {};
    return {mData->rowBegin[slot], mData->rowCount[slot]};
}

void NeighborLists::neighbors(std::size_t i, std::vector<std::uint32_t>& out) const
{
    requireLists(*mData);
    out.clear();
    if (mData->encoding == Encoding::kIndex) {
        const Span<const std::uint32_t> row = indices(i);
        out.assign(row.begin(), row.end());
        return;
    }
    const std::uint32_t slot = mData->slotOf[i];
    if (slot == kNoSlot) return;
    std::call_once(mData->directoryOnce, [&] { makeDirectory(*mData); });
    decodeSlot(*mData, slot, out);
}

void NeighborLists::visitRows(const RowVisitor& visit) const
{
    visitAllRows(*mData, CancelCheck(nullptr, "lists"), visit);
}

Csr NeighborLists::toCsr(Progress* progress) const
{
    constexpr std::size_t kIndicesBetweenChecks = std::size_t(1) << 24;
    requireLists(*mData);
    const CancelCheck cancel(progress, "lists");
    Csr csr;
    csr.offsets.resize(size() + 1);
    for (std::size_t i = 0; i < size(); ++i) csr.offsets[i + 1] = csr.offsets[i] + mData->entriesOf(i);
    csr.indices.reserve(csr.offsets.back());
    while (csr.indices.size() < csr.offsets.back()) {
        cancel.check();
        csr.indices.resize(
            std::min<std::size_t>(csr.offsets.back(), csr.indices.size() + kIndicesBetweenChecks));
    }
    visitAllRows(*mData, cancel, [&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
        std::uint32_t* const row = csr.indices.data() + csr.offsets[query];
        std::copy(neighbors.begin(), neighbors.end(), row);
        std::sort(row, row + neighbors.size());
    });
    return csr;
}

std::uint64_t NeighborLists::checksum(Progress* progress) const
{
    // Sums modulo 2^64 do not depend on the order, so threads may add theirs as they come.
    std::atomic<std::uint64_t> sum{0};
    visitAllRows(*mData, CancelCheck(progress, "lists"),
                 [&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
                     sum.fetch_add(rowChecksum(query, neighbors), std::memory_order_relaxed);
                 });
    return sum;
}

std::uint64_t NeighborLists::bytes() const
{
    return mData->rowBytes + mData->slotOf.usedBytes() + mData->rowCount.usedBytes() +
           mData->rowBegin.usedBytes() + mData->maskRuns.size() * sizeof(MaskRun) + mData->directoryBytes;
}

} // namespace vdb_nns
