// A piece of the search: the queries of one leaf, or some of them, against the leaf and its halo. Plain data between the
// driver (search.cpp) and the kernels, which are compiled once for each instruction set from search_task-inl.h.
#pragma once

#include "shared/block_view.h"
#include "shared/membership.h"
#include "shared/wide_place.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// Asks whether the search goes on; throws where it does not.
struct CancelPoll {
    const void* state;
    void (*check)(const void* state);
};

// Of a search whose queries are not its candidates, or whose particles have radii of their own, or whose rows are cut to the
// nearest: what search_sets-inl.h needs besides.
struct SetContext {
    BlockView queries{}; // on the lattice of the candidates, or on one of narrower cells: SearchTask::wide
    const float* queryFar =
        nullptr; // by slot of the queries: farOf() its radius; null: all have `farOfQueries`
    float farOfQueries = 0;
    const float* candidateFar = nullptr; // by slot of the candidates; only for the larger radius of a pair
    bool excludesSelf = true;            // a query is no neighbor of the candidate with its number
    bool addsSelf = false;               // a query that is a candidate stands in its row, beside the nearest
    std::uint32_t nearest = 0;           // of each row, so many are kept; 0: all
    float nearestDoubt = 0;              // scores further apart than this are ordered as the distances are
};

struct SearchContext {
    BlockView block; // the candidates
    FilterBounds bounds;
    CancelPoll cancel;
    SetContext sets = {};
};

struct SearchTask {
    std::uint32_t leaf;
    std::uint32_t firstSlot, endSlot;  // queries, inside the leaf
    const std::uint32_t* neighborhood; // kLeavesAround leaf indices of the candidates, see LeafNeighborhood
    const std::uint64_t* cells =
        nullptr; // 8 words: only queries in these cells; null for all. One alone for masks
    // Where the candidates' cells are wider than those of the queries: the leaf among them. `neighborhood` is then around the leaf
    // that it is in. Only for kernels of the larger radius.
    const WidePlace* wide = nullptr;
};

// Decides the pairs in the filter's band, and which of two candidates is nearer to a query, or has the smaller number where both
// are as near; numbers are the caller's.
struct ExactPredicate {
    void* state;
    bool (*isNeighbor)(void* state, std::uint32_t query, std::uint32_t candidate);
    bool (*isNearer)(void* state, std::uint32_t query, std::uint32_t a, std::uint32_t b);
};

// Where rows go. One for each thread.
struct RowSink {
    static constexpr std::size_t kLine = 16; // entries of a cache line
    static constexpr std::size_t kPad = 8;   // entries that padded rows have a multiple of

    std::uint32_t* out; // next free entry
    std::uint32_t* end;
    void* owner;
    void (*grow)(RowSink& sink, std::size_t entries); // makes room for that many entries at a new `out`
    std::uint32_t slotBase;                           // slot of rowBegin[0] and rowCount[0]
    std::uint32_t** rowBegin;                         // index rows only
    std::uint32_t* rowCount;
    std::uint32_t* rowLength;    // numbers that a row has, where those are fewer than it counts
    const std::uint32_t* number; // of queries by slot, where rows depend on it
    std::uint32_t nextSlot;      // all rows of the task before it are done; index rows only
    bool areHalf;                // RowKernels::half sets it
    bool isPadded; // rows to be read at once: each is filled up to a multiple of kPad, with its last number
    const std::uint32_t* taskBegin; // mask rows only: set by the kernel
    std::uint32_t tail[kLine];      // streamed rows only: entries that belong at `out`
    std::uint32_t tailSize;
};

// Memory of one thread: the particles of a leaf and its halo, by cell (x, y, z) lexicographic, about the leaf's centre;
// and the candidates that one cell's queries keep, about the centre of their ball. In units of `stride` bytes from `base`:
//   kept x 0, y 1, z 2, squared length 4, number 8, far 12      halo x 5, y 6, z 7, number 9, far 13
//   bits or a row 3      rows 10, 11      of rows that are cut: numbers 3, 14, scores 15, 16, sorted 11, scratch 17, 18
//   queries among wider cells: x 19, y 20, z 21
struct HaloScratch {
    static constexpr int kMaxSide = 8 + 2 * 3;
    std::uint32_t
        start[kMaxSide * kMaxSide * kMaxSide + 1]; // first particle of each cell of the cube; the end
    char* base;
    std::size_t stride;
    std::size_t capacity; // particles: candidates of a leaf, or queries among wider cells
    void* owner;
    void (*reserve)(HaloScratch& scratch, std::size_t particles);
    // Asks whether to go on, after so many particles of one run: memory that was never used may be slow. Throws where it does not.
    void (*ask)(const HaloScratch& scratch);
    static constexpr std::uint32_t kBetweenAsks = 1u << 16;
    // What the taker of rows will read of candidates, by number; null: nothing.
    const char* records;
    std::size_t recordBytes;

    char* kept() const { return base; }
    char* halo() const { return base + 5 * stride; }
    // Where rows and scores are that are cut to the nearest, of each of two queries.
    std::uint32_t* uncutNumbers(int row) const { return integersAt(row == 0 ? 3 : 14); }
    std::uint32_t* uncutScores(int row) const { return integersAt(row == 0 ? 15 : 16); }
    std::uint32_t* sortedScores() const { return integersAt(11); } // behind the short rows of staging()
    std::uint32_t* cutScratch() const { return integersAt(17); }   // twice as long
    // Where rows of numbers are made, two at a time: kStagingSlack entries longer than two rows of all kept candidates.
    std::uint32_t* staging() const { return reinterpret_cast<std::uint32_t*>(base + 10 * stride); }
    static constexpr std::size_t kStagingSlack = 1088;
    // Where the second row of a pair is made.
    std::uint32_t* secondRow() const { return reinterpret_cast<std::uint32_t*>(base + 3 * stride); }
    // By candidate of the cells in reach: kept by the ball filter.
    std::uint64_t* keepBits() const { return reinterpret_cast<std::uint64_t*>(base + 3 * stride); }
    // By kept candidate: within the radius of a query. A stride of floats has room for all three several times over.
    std::uint64_t* hitBits() const
    {
        return reinterpret_cast<std::uint64_t*>(base + 3 * stride + stride / 4 / 64 * 64);
    }
    std::uint64_t* secondHitBits() const
    {
        return reinterpret_cast<std::uint64_t*>(base + 3 * stride + stride / 2 / 64 * 64);
    }
    float* movedQueries(int axis) const
    {
        return reinterpret_cast<float*>(base + (19 + static_cast<std::size_t>(axis)) * stride);
    }
    static constexpr std::size_t kStrides = 22;

private:
    std::uint32_t* integersAt(std::size_t strides) const
    {
        return reinterpret_cast<std::uint32_t*>(base + strides * stride);
    }
};

// Particles of each cell of a leaf and of those in reach around it, (x, y, z) lexicographic; zero between leaves.
struct CellCounts {
    static constexpr int kMost = HaloScratch::kMaxSide * HaloScratch::kMaxSide * HaloScratch::kMaxSide;
    std::uint32_t count[kMost] = {};
    std::uint16_t touched[kMost];
    std::uint32_t touchedCount = 0;
};

struct TaskStatistics {
    std::uint64_t pairs = 0;
    std::uint64_t bandPairs = 0;
    std::uint64_t shortened = 0; // rows that were cut to the nearest
};

} // namespace vdb_nns
