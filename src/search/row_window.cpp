#include "search/row_window.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMostChunks = std::uint64_t(1) << (32 - RowWindow::kChunkBits);

} // namespace

RowWindow::RowWindow(std::uint64_t allowedBytes)
    : mChunks(static_cast<std::size_t>(std::min(allowedBytes / kChunkBytes, kMostChunks)))
{
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
        mChunks[mUsed++].memory = PageBlock(kChunkBytes);
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
