#include "search/row_window.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMostChunks = std::uint64_t(1) << (32 - RowWindow::kChunkBits);

} // namespace

RowWindow::RowWindow(std::uint64_t allowedBytes, Span<std::uint32_t> lent)
    : mChunks(static_cast<std::size_t>(
          std::min(allowedBytes / kChunkBytes + lent.size() / kChunkEntries, kMostChunks)))
{
    for (std::size_t c = 0; c < std::min(lent.size() / kChunkEntries, mChunks.size()); ++c)
        mChunks[c].begin = lent.data() + c * kChunkEntries;
}

std::uint32_t RowWindow::take()
{
    const std::lock_guard<std::mutex> lock(mMutex);
    std::uint32_t chunk = mUsed;
    if (!mFree.empty()) {
        chunk = mFree.back(); // the last one that was used is the likeliest to be in a cache
        mFree.pop_back();
    } else {
        if (mUsed == mChunks.size()) throw Exceeded();
        Chunk& next = mChunks[mUsed];
        if (!next.begin) {
            next.memory = PageBlock(kChunkBytes);
            next.begin = static_cast<std::uint32_t*>(next.memory.data());
        }
        ++mUsed;
    }
    mChunks[chunk].held = 1;
    ++mHeldChunks;
    return chunk;
}

void RowWindow::release(std::uint32_t chunk, std::uint32_t count)
{
    if (mChunks[chunk].held.fetch_sub(count) != count) return;
    const std::lock_guard<std::mutex> lock(mMutex);
    mFree.push_back(chunk);
    --mHeldChunks;
}

} // namespace vdb_nns
