// The collector: decides the pairs that a device has left undecided, and puts the rows of blocks where they stay, in the
// memory of lists. Reads what was downloaded, and the grid; nothing of a device's.
#pragma once

#include "lists/neighbor_lists_data.h"
#include "out_of_core/block_image.h"
#include "search/thread_state.h"
#include "shared/block_result.h"

#include <cstddef>
#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

// Memory for rows, in large pieces. Thread-safe.
class RowStore {
public:
    explicit RowStore(ChunkPool& pool) : mPool(pool) {}

    // Throws ChunkPool::Exhausted.
    std::uint32_t* take(std::size_t entries);

private:
    ChunkPool& mPool;
    std::mutex mMutex;
    std::uint32_t *mNext = nullptr, *mEnd = nullptr;
};

class Collector {
public:
    Collector(const SparseGridData& grid, const ExactTest& exact, const CancelCheck& cancel,
              Encoding encoding, NeighborListsData& lists, ChunkPool& pool)
        : mGrid(grid), mExact(exact), mCancel(cancel), mEncoding(encoding), mLists(lists), mRows(pool)
    {
    }

    struct Collected {
        std::uint64_t queries = 0, pairs = 0;
    };

    // The result of a part, with the image's layout; what is undecided is decided there. Different parts at once are fine.
    // Throws ChunkPool::Exhausted, Cancelled.
    Collected collect(const BlockPart& part, const ResultLayout& layout, std::byte* result,
                      ThreadState& state);

private:
    std::vector<UndecidedPair> decide(const BlockPart& part, const ResultLayout& layout, std::byte* result,
                                      ThreadState& state) const;
    void eraseNeighbor(std::uint32_t slot, std::uint32_t neighbor);

    const SparseGridData& mGrid;
    const ExactTest& mExact;
    const CancelCheck& mCancel;
    const Encoding mEncoding;
    NeighborListsData& mLists;
    RowStore mRows;
};

} // namespace vdb_nns
