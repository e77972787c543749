// A search whose rows are taken in the order of the particles' numbers, each made once, while a window of them is held: for
// files that need all rows in order and readers that need none twice.
//
// Tasks begin in the order of their lowest numbers. All rows below the lowest number of the first task that is not done are
// there, so they can be taken, and their memory serves for the next ones. Particles that are numbered along space need a window
// of a few per cent; in random order it would be all rows: look at windowRows() first.
#pragma once

#include "search/engine_state.h"
#include "vdb_nns/neighbor_lists.h"

#include <cstddef>
#include <cstdint>
#include <memory>

namespace vdb_nns {

// Rows of consecutive numbers.
struct RowRun {
    std::size_t index;      // of all runs in the order of numbers: 0, 1, 2, ...
    std::uint64_t firstRow; // a particle's number
    std::size_t rowCount;
    std::uint64_t firstPair; // pairs of all rows before
    std::uint64_t pairCount;
    const std::uint32_t* counts;      // of each row
    const std::uint32_t* const* rows; // in cell-visiting order; unspecified where the count is 0
};

class RowRunConsumer {
public:
    virtual ~RowRunConsumer() = default;
    // Runs come in any order, each once, from several threads at once.
    virtual void take(const RowRun& run) = 0;
};

// A search of two sets that is taken in that order. Lives in the thread that made it; `options` as for
// SearchEngine::search(), without encoding and memory.
class OrderedSearch {
public:
    OrderedSearch(EngineState& engine, const SearchSets& sets, const SearchOptions& options);
    ~OrderedSearch();

    const SearchSets& sets() const { return mRuns.sets(); }
    // The most rows that wait for one with a lower number, where tasks are done one after the other.
    std::uint64_t windowRows() const;
    // Neighbors of a query, from a sample of them.
    double expectedNeighbors() const { return mExpectedNeighbors; }

    double expectedPairs() const { return mExpectedNeighbors * static_cast<double>(mRuns.rowCount()); }

    // All pairs, exactly; a pass that counts.
    std::uint64_t countPairs();

    // Makes all rows. Returns lists of counts alone (Encoding::kNone).
    // `windowBytes`: the most that rows may take that are held. Throws WindowExceeded, Cancelled, and what `consumer` throws.
    NeighborLists run(std::uint64_t windowBytes, RowRunConsumer& consumer);
    // The checksum of all pairs of the last run, as NeighborLists::checksum(), if it was to be made.
    void makeChecksum() { mWantsChecksum = true; }
    std::uint64_t checksum() const { return mChecksum; }

private:
    struct TaskOrder;
    class Rows;

    std::uint64_t mostBytesBegun(std::uint64_t windowBytes) const;

    EngineState& mEngine;
    const SearchOptions mOptions;
    const SearchRuns mRuns;
    std::unique_ptr<TaskOrder> mOrder;
    double mExpectedNeighbors = 0;
    bool mWantsChecksum = false;
    std::uint64_t mChecksum = 0;
};

// The window does not hold the rows.
struct WindowExceeded {};

} // namespace vdb_nns
