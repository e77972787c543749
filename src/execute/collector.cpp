// See collector.h.
#include "execute/collector.h"

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

std::uint64_t Collector::collect(const BlockPart& part, const ResultLayout& layout, const std::byte* result,
                                 ThreadState& state)
{
    ResultHead head;
    std::memcpy(&head, result, sizeof head);
    const auto* const counts = reinterpret_cast<const std::uint32_t*>(result + layout.counts);
    const auto* const leafRows = reinterpret_cast<const std::uint64_t*>(result + layout.leafRows);
    const auto* const rows = reinterpret_cast<const std::uint32_t*>(result + layout.rows);
    const bool isMask = mEncoding == Encoding::kMask;
    std::uint64_t queries = 0, from = 0; // entries of rows before the leaf
    auto without = part.without.begin();
    for (std::uint32_t l = part.firstLeaf; l < part.endLeaf; ++l) {
        const std::uint32_t begin = std::max(mGrid.leaves[l].firstSlot, part.firstSlot),
                            end = std::min(mGrid.leaves[l + 1].firstSlot, part.endSlot);
        const CellSet* const partial =
            without != part.without.end() && without->leaf == l ? &*without++ : nullptr;
        if (begin >= end) continue;
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
            queries += last - first;
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
            if (partial->cells[cell.x] & cell.bit || first >= last) return;
            place(first, last);
            if (isMask) next += (last - first) * cell.rowWords();
        });
    }
    state.statistics.pairs += head.pairs;
    state.statistics.bandPairs += head.bandPairs;
    state.exactPairs += head.exactPairs;
    state.maskBytes += isMask ? head.rowBytes : 0;
    return queries;
}

} // namespace vdb_nns
