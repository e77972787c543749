// The memory of rows that wait until those before them are there: chunks, each free again once the last of its rows was taken.
// Small ones, for the rows of a leaf are made in the order of space and many of them wait for a short time. Knows places and
// counts, not what is in the rows.
#pragma once

#include "util/memory.h"
#include "vdb_nns/types.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <set>
#include <utility>
#include <vector>

namespace vdb_nns {

class RowWindow {
public:
    struct Exceeded {};

    // Entries of a chunk, and bits of a row's place in it.
    static constexpr int kChunkBits = 16;
    static constexpr std::size_t kChunkEntries = std::size_t(1) << kChunkBits;
    static constexpr std::size_t kChunkBytes = kChunkEntries * sizeof(std::uint32_t);

    // `lent`: memory that serves first and is not counted, for pages that were never touched are the slowest.
    RowWindow(std::uint64_t allowedBytes, Span<std::uint32_t> lent);

    // Chunks that hold so many entries, one behind the other; returns the first one, which stands for them. They are held until
    // release() was called for the one that takes them and for each row that addRows() counted. Throws Exceeded. Thread-safe,
    // as all functions.
    std::uint32_t take(std::size_t entries);
    void addRows(std::uint32_t first, std::uint32_t count) { mChunks[first].held += count; }
    void release(std::uint32_t first, std::uint32_t count = 1);
    // Frees those chunks that lie entirely behind `used`, which is in them or at their end. By the thread
    // that took them, before its release().
    void shrink(std::uint32_t first, const std::uint32_t* used);

    std::uint64_t heldBytes() const { return mHeldChunks * kChunkBytes; }

    std::uint32_t* begin(std::uint32_t first) const { return mChunks[first].begin; }
    std::uint32_t* end(std::uint32_t first) const
    {
        return begin(first) + mChunks[first].together * kChunkEntries;
    }
    // A row's place is a number of 32 bits.
    std::uint32_t placeOf(std::uint32_t first, const std::uint32_t* row) const
    {
        return (first << kChunkBits) + static_cast<std::uint32_t>(row - begin(first));
    }
    const std::uint32_t* rowAt(std::uint32_t place) const
    {
        return mChunks[place >> kChunkBits].begin + (place & (kChunkEntries - 1));
    }
    // The chunk that stands for those in which the place is.
    std::uint32_t firstOf(std::uint32_t place) const { return mChunks[place >> kChunkBits].first; }

private:
    struct Chunk {
        std::uint32_t* begin = nullptr;
        std::uint32_t first = 0, together = 1;
        std::atomic<std::uint32_t> held{0};
    };

    void addMemory(std::uint32_t chunks);
    // Of consecutive chunks that are free; call them with mMutex held.
    void addRange(std::uint32_t first, std::uint32_t count);
    std::uint32_t takeFromRanges(std::uint32_t count);
    bool adjoin(std::uint32_t left, std::uint32_t right) const;

    std::mutex mMutex;
    std::vector<Chunk> mChunks; // as many as are allowed
    std::vector<PageBlock> mMemory;
    // Free chunks: single ones in the order of their release, others in ranges that are as long as can be.
    std::vector<std::uint32_t> mSingles;
    std::map<std::uint32_t, std::uint32_t>
        mRanges; // first chunk, number of chunks; all in one piece of memory
    std::set<std::pair<std::uint32_t, std::uint32_t>> mByCount; // the same: number of chunks, first chunk
    std::uint32_t mReady = 0;                                   // chunks that have memory
    std::atomic<std::uint64_t> mHeldChunks{0};
};

} // namespace vdb_nns
