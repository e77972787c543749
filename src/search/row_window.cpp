#include "search/row_window.h"

#include <algorithm>
#include <iterator>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMostChunks = std::uint64_t(1) << (32 - RowWindow::kChunkBits);
constexpr std::uint32_t kNone = 0xFFFFFFFFu; // no chunk
// Chunks that get their memory at once: two huge pages.
constexpr std::size_t kChunksAtOnce = (std::size_t(4) << 20) / RowWindow::kChunkBytes;

} // namespace

RowWindow::RowWindow(std::uint64_t allowedBytes, Span<std::uint32_t> lent)
    : mChunks(static_cast<std::size_t>(
          std::min(allowedBytes / kChunkBytes + lent.size() / kChunkEntries, kMostChunks)))
{
    mReady = static_cast<std::uint32_t>(std::min(lent.size() / kChunkEntries, mChunks.size()));
    for (std::uint32_t c = 0; c < mReady; ++c) mChunks[c].begin = lent.data() + c * kChunkEntries;
    if (mReady > 0) addRange(0, mReady);
}

bool RowWindow::adjoin(std::uint32_t left, std::uint32_t right) const
{
    return left + 1 == right && mChunks[right].begin == mChunks[left].begin + kChunkEntries;
}

void RowWindow::addRange(std::uint32_t first, std::uint32_t count)
{
    auto next = mRanges.lower_bound(first);
    if (next != mRanges.end() && adjoin(first + count - 1, next->first)) {
        count += next->second;
        mByCount.erase({next->second, next->first});
        next = mRanges.erase(next);
    }
    if (next != mRanges.begin()) {
        const auto before = std::prev(next);
        if (adjoin(before->first + before->second - 1, first)) {
            first = before->first;
            count += before->second;
            mByCount.erase({before->second, before->first});
            mRanges.erase(before);
        }
    }
    mRanges[first] = count;
    mByCount.insert({count, first});
}

// The front of the shortest range that has so many chunks; kNone if none has.
std::uint32_t RowWindow::takeFromRanges(std::uint32_t count)
{
    const auto found = mByCount.lower_bound({count, 0});
    if (found == mByCount.end()) return kNone;
    const auto [there, first] = *found;
    mByCount.erase(found);
    mRanges.erase(first);
    if (there > count) {
        mRanges[first + count] = there - count;
        mByCount.insert({there - count, first + count});
    }
    return first;
}

void RowWindow::addMemory(std::uint32_t chunks)
{
    const std::size_t left = mChunks.size() - mReady, wanted = std::max<std::size_t>(chunks, kChunksAtOnce);
    if (left < chunks) throw Exceeded();
    const auto added = static_cast<std::uint32_t>(std::min(wanted, left));
    mMemory.emplace_back(added * kChunkBytes);
    auto* const begin = static_cast<std::uint32_t*>(mMemory.back().data());
    for (std::uint32_t c = 0; c < added; ++c) mChunks[mReady + c].begin = begin + c * kChunkEntries;
    addRange(mReady, added);
    mReady += added;
}

std::uint32_t RowWindow::take(std::size_t entries)
{
    const auto count = static_cast<std::uint32_t>(
        std::min<std::size_t>((entries + kChunkEntries - 1) / kChunkEntries, kMostChunks));
    const std::lock_guard<std::mutex> lock(mMutex);
    std::uint32_t first = kNone;
    if (count == 1 && !mSingles.empty()) {
        first = mSingles.back(); // the last one that was used is the likeliest to be in a cache
        mSingles.pop_back();
    } else {
        first = takeFromRanges(count);
        if (first == kNone && !mSingles.empty()) {
            for (const std::uint32_t c : mSingles) addRange(c, 1);
            mSingles.clear();
            first = takeFromRanges(count);
        }
        if (first == kNone) {
            addMemory(count);
            first = takeFromRanges(count);
        }
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
    if (together == 1)
        mSingles.push_back(first);
    else
        addRange(first, together);
    mHeldChunks -= together;
}

void RowWindow::shrink(std::uint32_t first, const std::uint32_t* used)
{
    const std::size_t entries = std::max<std::size_t>(1, static_cast<std::size_t>(used - begin(first)));
    const auto kept = static_cast<std::uint32_t>((entries + kChunkEntries - 1) / kChunkEntries);
    const std::lock_guard<std::mutex> lock(mMutex);
    const std::uint32_t unused = mChunks[first].together - kept;
    if (unused == 0) return;
    mChunks[first].together = kept;
    addRange(first + kept, unused);
    mHeldChunks -= unused;
}

} // namespace vdb_nns
