// What one thread of a search owns: scratch memory, the sink of its rows, counters. And the chunks that rows live in.
#pragma once

#include "execute/exact_test.h"
#include "execute/search_task.h"
#include "grid/sparse_grid_data.h"
#include "lists/neighbor_lists_data.h"
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
    std::vector<PageBlock> release() { return std::move(mTaken); }

private:
    std::mutex mMutex;
    std::vector<PageBlock> mFree, mTaken;
    std::size_t mChunkBytes = 0;
    std::uint64_t mAllowedBytes = 0, mTakenBytes = 0;
};

struct ThreadState {
    ThreadState();
    ThreadState(const ThreadState&) = delete;
    ThreadState& operator=(const ThreadState&) = delete;

    // Forgets the last search but for its memory.
    void begin();
    // Puts the entries that streamed rows still hold back where they belong.
    void finishRows();
    BandJudge judge();

    // Rows of the coming task go to `visitor` instead of into lists.
    void beginVisit(const SparseGridData& grid, const NeighborVisitor& visitor, const SearchTask& task);
    void flushVisit();

    HaloScratch halo;
    RowSink sink;
    TaskStatistics statistics;
    std::uint64_t exactPairs = 0;
    std::uint64_t maskBytes = 0;
    std::vector<LeafNeighborhood> neighborhoods;
    std::vector<MaskRun> maskRuns;
    const ExactTest* exact = nullptr;
    ChunkPool* pool = nullptr;

private:
    static void reserveHalo(HaloScratch& scratch, std::size_t particles);
    static void growRows(RowSink& sink, std::size_t entries);
    static void growVisit(RowSink& sink, std::size_t entries);
    static bool judgePair(void* state, std::uint32_t query, std::uint32_t candidate);

    PageBlock mHaloMemory;
    PageBlock mVisitRows; // numbers of neighbors
    std::vector<std::uint32_t*> mVisitBegin;
    std::vector<std::uint32_t> mVisitCount;
    std::vector<double> mDistances;
    ExactTestMemory mExactMemory;
    const SparseGridData* mVisitGrid = nullptr;
    const NeighborVisitor* mVisitor = nullptr;
    std::uint32_t mVisited = 0; // slots before it were handed out
};

using ThreadStates = tbb::enumerable_thread_specific<ThreadState>;

} // namespace vdb_nns
