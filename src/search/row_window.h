// The memory of rows that wait until those before them are there: chunks, each free again once the last of its rows was taken.
// Knows places and counts, not what is in the rows.
#pragma once

#include "util/memory.h"
#include "vdb_nns/types.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

class RowWindow {
public:
    struct Exceeded {};

    // Entries of a chunk, and bits of a row's place in it. A huge page.
    static constexpr int kChunkBits = 19;
    static constexpr std::size_t kChunkEntries = std::size_t(1) << kChunkBits;
    static constexpr std::size_t kChunkBytes = kChunkEntries * sizeof(std::uint32_t);

    // `lent`: memory that serves first and is not counted, for pages that were never touched are the slowest.
    RowWindow(std::uint64_t allowedBytes, Span<std::uint32_t> lent);

    // A chunk, held until release() was called for the one that takes it and for each row that addRows() counted. Throws
    // Exceeded. Thread-safe, as all functions.
    std::uint32_t take();
    void addRows(std::uint32_t chunk, std::uint32_t count) { mChunks[chunk].held += count; }
    void release(std::uint32_t chunk, std::uint32_t count = 1);

    std::uint64_t heldBytes() const { return mHeldChunks * kChunkBytes; }

    std::uint32_t* begin(std::uint32_t chunk) const { return mChunks[chunk].begin; }
    // A row's place is a number of 32 bits.
    std::uint32_t placeOf(std::uint32_t chunk, const std::uint32_t* row) const
    {
        return chunk << kChunkBits | static_cast<std::uint32_t>(row - begin(chunk));
    }
    static std::uint32_t chunkOf(std::uint32_t place) { return place >> kChunkBits; }
    const std::uint32_t* rowAt(std::uint32_t place) const
    {
        return begin(chunkOf(place)) + (place & (kChunkEntries - 1));
    }

private:
    struct Chunk {
        std::uint32_t* begin = nullptr;
        PageBlock memory; // none in lent chunks
        std::atomic<std::uint32_t> held{0};
    };

    std::mutex mMutex;
    std::vector<Chunk>
        mChunks; // as many as are allowed: first those that are lent, the others with memory once taken
    std::vector<std::uint32_t> mFree;
    std::uint32_t mUsed = 0; // chunks that have memory
    std::atomic<std::uint64_t> mHeldChunks{0};
};

} // namespace vdb_nns
