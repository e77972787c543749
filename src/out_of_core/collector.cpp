#include "out_of_core/collector.h"

#include "lists/cell_candidates.h"

#include <algorithm>
#include <cstring>
#include <numeric>

namespace vdb_nns {

std::uint32_t* RowStore::take(std::size_t entries)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    if (static_cast<std::size_t>(mEnd - mNext) < entries) {
        std::size_t bytes = 0;
        mNext = static_cast<std::uint32_t*>(mPool.take(entries * sizeof(std::uint32_t), bytes));
        mEnd = mNext + bytes / sizeof(std::uint32_t);
    }
    mNext += entries;
    return mNext - entries;
}

// Decides the undecided pairs. Those that are none leave counts and masks at once; of rows of numbers, which must stay where
// the counts say, they are returned.
std::vector<UndecidedPair> Collector::decide(const BlockPart& part, const ResultLayout& layout,
                                             std::byte* result, ThreadState& state) const
{
    ResultHead head;
    std::memcpy(&head, result, sizeof head);
    const auto* const undecided =
        reinterpret_cast<const UndecidedPair*>(result + layout.undecided(head.rowBytes));
    auto* const counts = reinterpret_cast<std::uint32_t*>(result + layout.counts);
    auto* const rows = reinterpret_cast<std::uint32_t*>(result + layout.rows);
    state.decideBy(mExact, mCancel);
    state.statistics.bandPairs += head.undecided;
    const ExactPredicate exact = state.exactPredicate();
    std::vector<UndecidedPair> refused;
    for (std::uint64_t u = 0; u < head.undecided; ++u) {
        const UndecidedPair& pair = undecided[u];
        if (exact.isNeighbor(exact.state, mGrid.number[part.firstSlot + pair.query], pair.candidate))
            continue;
        if (mEncoding == Encoding::kIndex) {
            refused.push_back(pair);
        } else {
            --counts[pair.query];
            if (mEncoding == Encoding::kMask) rows[pair.bit / 32] &= ~(1u << pair.bit % 32);
        }
    }
    return refused;
}

void Collector::eraseNeighbor(std::uint32_t slot, std::uint32_t neighbor)
{
    std::uint32_t* const row = mLists.rowBegin[slot];
    std::uint32_t* const end = row + mLists.rowCount[slot]--;
    std::uint32_t* const found = std::find(row, end, neighbor);
    std::copy(found + 1, end, found);
}

Collector::Collected Collector::collect(const BlockPart& part, const ResultLayout& layout, std::byte* result,
                                        ThreadState& state)
{
    const std::vector<UndecidedPair> refused = decide(part, layout, result, state);
    ResultHead head;
    std::memcpy(&head, result, sizeof head);
    const auto* const counts = reinterpret_cast<const std::uint32_t*>(result + layout.counts);
    const auto* const leafRows = reinterpret_cast<const std::uint64_t*>(result + layout.leafRows);
    const auto* const rows = reinterpret_cast<const std::uint32_t*>(result + layout.rows);
    const bool isMask = mEncoding == Encoding::kMask;
    Collected collected;
    std::uint64_t from = 0; // entries of rows before the leaf
    auto without = part.without.begin();
    for (std::uint32_t l = part.firstLeaf; l < part.endLeaf; ++l) {
        const std::uint32_t begin = std::max(mGrid.leaves[l].firstSlot, part.firstSlot),
                            end = std::min(mGrid.leaves[l + 1].firstSlot, part.endSlot);
        const CellSet* const partial =
            without != part.without.end() && without->leaf == l ? &*without++ : nullptr;
        if (begin >= end) continue;
        mCancel.check();
        // Rows of a leaf stay together; cells that are not wanted have counts of 0.
        std::uint64_t entries = 0;
        if (isMask) {
            const std::uint32_t next = l + 1 - part.firstLeaf;
            from = leafRows[next - 1];
            entries = (l + 1 < part.endLeaf ? leafRows[next] : head.rowBytes / sizeof(std::uint32_t)) - from;
        } else if (mEncoding == Encoding::kIndex) {
            entries = std::accumulate(counts + (begin - part.firstSlot), counts + (end - part.firstSlot),
                                      std::uint64_t(0));
        }
        std::uint32_t* next = entries > 0 ? mRows.take(entries) : nullptr;
        if (entries > 0) std::memcpy(next, rows + from, entries * sizeof(std::uint32_t));
        from += entries;
        const auto place = [&](std::uint32_t first, std::uint32_t last) {
            collected.queries += last - first;
            std::copy_n(counts + (first - part.firstSlot), last - first, mLists.rowCount.data() + first);
            if (isMask) state.maskRuns.push_back({first, next});
            if (mEncoding != Encoding::kIndex) return;
            for (std::uint32_t s = first; s < last; ++s) {
                mLists.rowBegin[s] = next;
                next += mLists.rowCount[s];
            }
        };
        if (!partial) {
            place(begin, end);
            continue;
        }
        LeafNeighborhood neighborhood;
        mGrid.topology.neighborhoods({&mGrid.leafOrigins[l], 1}, &neighborhood);
        forEachOccupiedCell(blockViewOf(mGrid), l, neighborhood, [&](const OccupiedCell& cell) {
            const std::uint32_t first = std::max(cell.begin, begin), last = std::min(cell.end, end);
            if (partial->cells[cell.x] & cell.bit() || first >= last) return;
            place(first, last);
            if (isMask) next += (last - first) * cell.rowWords();
        });
    }
    for (const UndecidedPair& pair : refused) eraseNeighbor(part.firstSlot + pair.query, pair.candidate);
    collected.pairs =
        std::accumulate(counts, counts + (part.endSlot - part.firstSlot), std::uint64_t(0)) - refused.size();
    state.statistics.pairs += collected.pairs;
    state.statistics.bandPairs += head.bandPairs;
    state.exactPairs += head.exactPairs;
    state.maskBytes += isMask ? head.rowBytes : 0;
    return collected;
}

} // namespace vdb_nns
