// What one thread of a search owns: scratch memory, the sink of its rows, counters. And the chunks that rows live in.
#pragma once

#include "cpu/search_task.h"
#include "exact/exact_test.h"
#include "grid/sparse_grid_data.h"
#include "lists/neighbor_lists_data.h"
#include "search/layered_rows.h"
#include "util/cancel.h"
#include "util/memory.h"
#include "vdb_nns/search.h"

#include <tbb/enumerable_thread_specific.h>

#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

// Hands out chunks of list memory, old ones first, up to a limit.
class ChunkPool {
public:
    struct Exhausted {};

    explicit ChunkPool(std::vector<PageBlock> old) : mFree(std::move(old)) {}

    void begin(std::uint64_t allowedBytes, std::size_t particles);

    // A chunk of at least `bytes` bytes. Throws Exhausted when the chunks' bytes would pass the limit. Thread-safe.
    void* take(std::size_t bytes, std::size_t& takenBytes);

    std::uint64_t freeBytes() const;
    std::uint64_t takenBytes() const { return mTakenBytes; }
    std::vector<PageBlock> release() { return std::move(mVisited); }

private:
    std::mutex mMutex;
    std::vector<PageBlock> mFree, mVisited;
    std::size_t mChunkBytes = 0;
    std::uint64_t mAllowedBytes = 0, mTakenBytes = 0;
};

// Rows of consecutive slots, one behind the other, each filled up to a multiple of RowSink::kPad.
struct VisitedRows {
    std::uint32_t firstSlot, rows;
    const std::uint32_t* numbers;
    const std::uint32_t* lengths; // of each row
    const std::uint32_t*
        counts;   // of neighbors; others than the lengths where rows have the smaller numbers alone
    bool areHalf; // RowSink::areHalf; counts then are of those in the row

    // f(slot, numbers, length)
    template <typename F>
    void forEach(F&& f) const
    {
        const std::uint32_t* row = numbers;
        for (std::uint32_t r = 0; r < rows; ++r) {
            f(firstSlot + r, row, lengths[r]);
            row += (lengths[r] + RowSink::kPad - 1) / RowSink::kPad * RowSink::kPad;
        }
    }
};

// Takes rows of numbers as they are made, in the order of slots. They are valid during the call.
class RowCallback {
public:
    virtual ~RowCallback() = default;
    virtual void take(const VisitedRows& rows) = 0;
    // The task's rows are all taken. False: they are wanted again, as those of RowKind::kVisit.
    virtual bool finish() { return true; }
};

struct ThreadState {
    ThreadState();
    ThreadState(const ThreadState&) = delete;
    ThreadState& operator=(const ThreadState&) = delete;

    // Forgets the last search but for its memory.
    void begin();
    // Puts the entries that streamed rows still hold back where they belong.
    void finishRows();
    // What exactPredicate() asks from now on.
    void decideBy(const ExactTest& exact, const CancelCheck& cancel);
    ExactPredicate exactPredicate();

    // Before and after rows are written to `sink` in the plain way, of which others of the thread may be streamed: entries that wait
    // go where they belong, and the next ones begin with a line.
    static void beginPlainRows(RowSink& sink);
    static void endPlainRows(RowSink& sink);

    // Rows of the coming task, of kVisit, kSmaller or kHalf, go to `callback` instead of into lists. Queries outside of the task's cells
    // have empty rows. `number`: of the queries, by slot.
    void beginCallbacks(RowCallback& callback, const SearchTask& task, RowKind kind,
                        const std::uint32_t* number);
    void flushRows();

    HaloScratch halo;
    LayeredRows layered;
    RowSink sink;    // rows into lists
    RowSink visited; // rows that are handed to a RowCallback
    TaskStatistics statistics;
    std::uint64_t exactPairs = 0;
    std::uint64_t maskBytes = 0;
    std::vector<LeafNeighborhood> neighborhoods;
    std::vector<MaskRun> maskRuns;
    ChunkPool* pool = nullptr;
    std::vector<double> distances;

private:
    static void reserveHalo(HaloScratch& scratch, std::size_t particles);
    static void askHalo(const HaloScratch& scratch);
    static void growRows(RowSink& sink, std::size_t entries);
    static void growVisited(RowSink& sink, std::size_t entries);
    static bool decidePair(void* state, std::uint32_t query, std::uint32_t candidate);
    static bool decideNearer(void* state, std::uint32_t query, std::uint32_t a, std::uint32_t b);
    void countDecision();

    const ExactTest* mExact = nullptr;
    const CancelCheck* mCancel = nullptr;
    std::uint32_t mDecided = 0; // pairs, for asking whether to stop
    PageBlock mHaloMemory;
    PageBlock mVisitedRows; // numbers of neighbors
    std::vector<std::uint32_t*> mVisitedBegin;
    std::vector<std::uint32_t> mVisitedCount, mVisitedLength;
    RowCallback* mCallback = nullptr;
    std::uint32_t mVisited = 0; // slots before it were handed out
    ExactTestMemory mExactMemory;
};

using ThreadStates = tbb::enumerable_thread_specific<ThreadState>;

} // namespace vdb_nns
