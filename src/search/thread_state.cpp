// The chunks that rows live in, the memory of one thread and how it grows, and how rows reach a callback.
#include "search/thread_state.h"

#include <algorithm>
#include <cstddef>
#include <utility>

#include <tbb/task_arena.h>

namespace vdb_nns {

void ChunkPool::begin(std::uint64_t allowedBytes, std::size_t particles)
{
    // One chunk a thread may be nearly empty: no more than 1/8 of what is allowed goes that way. Large chunks keep rows
    // on huge pages; small scenes take less, so that they do not touch a huge page for a few rows.
    const auto threads = static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    const std::uint64_t wanted =
        std::clamp<std::uint64_t>(particles * 128 / threads, 65536, std::uint64_t(32) << 20);
    mChunkBytes = std::max<std::uint64_t>(4096, std::min(wanted, allowedBytes / (8 * threads)));
    mAllowedBytes = allowedBytes;
}

void* ChunkPool::take(std::size_t bytes, std::size_t& takenBytes)
{
    const std::lock_guard<std::mutex> lock(mMutex);
    const auto enough =
        std::find_if(mFree.begin(), mFree.end(), [&](const PageBlock& b) { return b.bytes() >= bytes; });
    PageBlock block;
    if (enough != mFree.end()) {
        block = std::move(*enough);
        *enough = std::move(mFree.back());
        mFree.pop_back();
    } else if (mTakenBytes + std::max(bytes, mChunkBytes) <= mAllowedBytes) {
        bytes = std::max(bytes, mChunkBytes); // else no more than is needed
    }
    const std::size_t size = block.data() ? block.bytes() : bytes;
    if (mTakenBytes + size > mAllowedBytes) {
        mTakenBytes += size;
        throw Exhausted();
    }
    if (!block.data()) block = PageBlock(bytes);
    takenBytes = block.bytes();
    mTakenBytes += takenBytes;
    mVisited.push_back(std::move(block));
    return mVisited.back().data();
}

std::uint64_t ChunkPool::freeBytes() const
{
    std::uint64_t bytes = 0;
    for (const PageBlock& block : mFree) bytes += block.bytes();
    return bytes;
}

ThreadState::ThreadState() : halo{}, sink{}, visited{}
{
    halo.owner = this;
    halo.reserve = reserveHalo;
    halo.ask = askHalo;
    sink.owner = visited.owner = this;
    sink.grow = growRows;
    visited.grow = growVisited;
    visited.isPadded = true;
    begin();
}

void ThreadState::begin()
{
    statistics = {};
    exactPairs = maskBytes = 0;
    maskRuns.clear();
    mExactMemory = {};
    sink.out = sink.end = nullptr;
    sink.tailSize = 0;
    halo.records = nullptr;
}

void ThreadState::countDecision()
{
    constexpr std::uint32_t kPairsBetweenChecks = 1u << 14; // some milliseconds
    if (++mDecided % kPairsBetweenChecks == 0) mCancel->check();
}

bool ThreadState::decideNearer(void* state, std::uint32_t query, std::uint32_t a, std::uint32_t b)
{
    auto& self = *static_cast<ThreadState*>(state);
    self.countDecision();
    return self.mExact->isNearer(query, a, b, self.exactPairs);
}

bool ThreadState::decidePair(void* state, std::uint32_t query, std::uint32_t candidate)
{
    auto& self = *static_cast<ThreadState*>(state);
    self.countDecision();
    return self.mExact->isNeighbor(query, candidate, self.mExactMemory, self.exactPairs);
}

void ThreadState::decideBy(const ExactTest& exact, const CancelCheck& cancel)
{
    mExact = &exact;
    mCancel = &cancel;
}

void ThreadState::finishRows()
{
    std::copy_n(sink.tail, sink.tailSize, sink.out);
    sink.tailSize = 0;
}

void ThreadState::beginPlainRows(RowSink& sink)
{
    std::copy_n(sink.tail, sink.tailSize, sink.out);
    sink.out += sink.tailSize;
    sink.tailSize = 0;
}

void ThreadState::endPlainRows(RowSink& sink)
{
    constexpr std::uintptr_t kLineBytes = RowSink::kLine * sizeof(std::uint32_t);
    const std::uintptr_t past = reinterpret_cast<std::uintptr_t>(sink.out) % kLineBytes;
    if (past == 0) return;
    const auto entries = static_cast<std::ptrdiff_t>((kLineBytes - past) / sizeof(std::uint32_t));
    sink.out = sink.end - sink.out < entries ? sink.end : sink.out + entries;
}

ExactPredicate ThreadState::exactPredicate()
{
    return {this, decidePair, decideNearer};
}

void ThreadState::reserveHalo(HaloScratch& scratch, std::size_t particles)
{
    if (particles <= scratch.capacity && scratch.base) return;
    auto& self = *static_cast<ThreadState*>(scratch.owner);
    const std::size_t capacity = particles + particles / 2 + 1024;
    // Vector code reads and writes up to two vectors past the end. An odd number of lines keeps the arrays from falling
    // on the same cache sets.
    scratch.stride = ((capacity + HaloScratch::kStagingSlack) * sizeof(float) / 64 | 1) * 64;
    scratch.base = nullptr; // until there is memory again
    self.mHaloMemory = PageBlock();
    self.mHaloMemory = PageBlock(HaloScratch::kStrides * scratch.stride);
    scratch.base = static_cast<char*>(self.mHaloMemory.data());
    scratch.capacity = capacity;
}

void ThreadState::askHalo(const HaloScratch& scratch)
{
    static_cast<const ThreadState*>(scratch.owner)->mCancel->check();
}

void ThreadState::growRows(RowSink& sink, std::size_t entries)
{
    auto& self = *static_cast<ThreadState*>(sink.owner);
    if (static_cast<std::size_t>(sink.end - sink.out) >= entries) return;
    self.finishRows();
    std::size_t bytes = 0;
    sink.out = static_cast<std::uint32_t*>(self.pool->take(entries * sizeof(std::uint32_t), bytes));
    sink.end = sink.out + bytes / sizeof(std::uint32_t);
}

void ThreadState::beginCallbacks(RowCallback& callback, const SearchTask& task, RowKind kind,
                                 const std::uint32_t* number)
{
    mCallback = &callback;
    const std::size_t queries = task.endSlot - task.firstSlot;
    // A task that was stopped may have left rows that nobody took.
    visited.out = static_cast<std::uint32_t*>(mVisitedRows.data());
    visited.end = visited.out + mVisitedRows.bytes() / sizeof(std::uint32_t);
    mVisitedBegin.resize(queries);
    mVisitedCount.assign(queries, 0);
    visited.slotBase = visited.nextSlot = mVisited = task.firstSlot;
    visited.rowBegin = mVisitedBegin.data();
    visited.rowCount = visited.rowLength = mVisitedCount.data();
    visited.number = number;
    visited.areHalf = false;
    if (kind != RowKind::kSmaller) return;
    mVisitedLength.assign(queries, 0);
    visited.rowLength = mVisitedLength.data();
}

void ThreadState::growVisited(RowSink& sink, std::size_t entries)
{
    constexpr std::size_t kTakenEntries = 65536; // 256 KB: stays in the second-level cache
    auto& self = *static_cast<ThreadState*>(sink.owner);
    self.flushRows();
    if (self.mVisitedRows.bytes() < entries * sizeof(std::uint32_t)) {
        self.mVisitedRows = PageBlock();
        self.mVisitedRows = PageBlock(std::max(entries, kTakenEntries) * sizeof(std::uint32_t));
    }
    sink.out = static_cast<std::uint32_t*>(self.mVisitedRows.data());
    sink.end = sink.out + self.mVisitedRows.bytes() / sizeof(std::uint32_t);
}

void ThreadState::flushRows()
{
    visited.out = static_cast<std::uint32_t*>(mVisitedRows.data());
    if (mVisited == visited.nextSlot) return;
    const std::uint32_t first = std::exchange(mVisited, visited.nextSlot);
    const std::uint32_t begin = first - visited.slotBase;
    mCallback->take({first, mVisited - first, visited.out, visited.rowLength + begin,
                     visited.rowCount + begin, visited.areHalf});
}

} // namespace vdb_nns
