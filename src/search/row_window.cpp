#include "search/row_window.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMostChunks = std::uint64_t(1) << (32 - RowWindow::kChunkBits);
// Chunks that get their memory at once: two huge pages.
constexpr std::size_t kChunksAtOnce = (std::size_t(4) << 20) / RowWindow::kChunkBytes;

} // namespace

RowWindow::RowWindow(std::uint64_t allowedBytes, Span<std::uint32_t> lent)
    : mChunks(static_cast<std::size_t>(
          std::min(allowedBytes / kChunkBytes + lent.size() / kChunkEntries, kMostChunks)))
{
    mReady = static_cast<std::uint32_t>(std::min(lent.size() / kChunkEntries, mChunks.size()));
    for (std::uint32_t c = 0; c < mReady; ++c) mChunks[c].begin = lent.data() + c * kChunkEntries;
}

void RowWindow::addMemory(std::uint32_t chunks)
{
    for (; mUsed < mReady; ++mUsed) mFree.push_back(mUsed); // too few in one piece
    const std::size_t left = mChunks.size() - mReady, wanted = std::max<std::size_t>(chunks, kChunksAtOnce);
    if (left < chunks) throw Exceeded();
    const auto added = static_cast<std::uint32_t>(std::min(wanted, left));
    mMemory.emplace_back(added * kChunkBytes);
    auto* const begin = static_cast<std::uint32_t*>(mMemory.back().data());
    for (std::uint32_t c = 0; c < added; ++c) mChunks[mReady++].begin = begin + c * kChunkEntries;
}

std::uint32_t RowWindow::take(std::size_t entries)
{
    const auto count = static_cast<std::uint32_t>(
        std::min<std::size_t>((entries + kChunkEntries - 1) / kChunkEntries, kMostChunks));
    const std::lock_guard<std::mutex> lock(mMutex);
    std::uint32_t first = mUsed;
    if (count == 1 && !mFree.empty()) {
        first = mFree.back(); // the last one that was used is the likeliest to be in a cache
        mFree.pop_back();
    } else {
        if (mReady - mUsed < count) addMemory(count);
        first = mUsed;
        mUsed += count;
    }
    for (std::uint32_t c = first; c < first + count; ++c) mChunks[c].first = first;
    mChunks[first].together = count;
    mChunks[first].held = 1;
    mHeldChunks += count;
    return first;
}

void RowWindow::release(std::uint32_t first, std::uint32_t count)
{
    if (mChunks[first].held.fetch_sub(count) != count) return;
    const std::lock_guard<std::mutex> lock(mMutex);
    const std::uint32_t together = mChunks[first].together;
    for (std::uint32_t c = first; c < first + together; ++c) mFree.push_back(c);
    mHeldChunks -= together;
}

} // namespace vdb_nns
