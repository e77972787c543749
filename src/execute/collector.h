// The collector: puts the rows of blocks where they stay, in the memory of lists. Reads what was downloaded, and the grid;
// nothing of a device's.
#pragma once

#include "execute/block_image.h"
#include "execute/thread_state.h"
#include "lists/neighbor_lists_data.h"

#include <cstddef>
#include <cstdint>
#include <mutex>

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
    Collector(const SparseGridData& grid, Encoding encoding, NeighborListsData& lists, ChunkPool& pool)
        : mGrid(grid), mEncoding(encoding), mLists(lists), mRows(pool)
    {
    }

    // The result of a part, with the image's layout. Returns how many queries it had. Different parts at once are fine.
    // Throws ChunkPool::Exhausted.
    std::uint64_t collect(const BlockPart& part, const ResultLayout& layout, const std::byte* result,
                          ThreadState& state);

private:
    const SparseGridData& mGrid;
    const Encoding mEncoding;
    NeighborListsData& mLists;
    RowStore mRows;
};

} // namespace vdb_nns
