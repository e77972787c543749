// What a bound on the process's resident memory leaves for each step of a search or a plan. Without a bound lists still leave
// room for what is made beside and after them. Knows what every step holds; holds nothing itself.
#pragma once

#include "measure/measure_memory.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search_job.h"

#include <cstdint>
#include <string>

namespace vdb_nns {

class HostBudget {
public:
    // `boundBytes` 0: no bound, so that only lists and writers are held against what is free once the grid is made.
    // `measures` are those that are made besides.
    HostBudget(std::uint64_t boundBytes, int threads, const WrittenKinds& written,
               const MeasureMemory& measures);

    bool isBounded() const { return mBoundBytes > 0; }

    // Takes what is resident now, the points and the program, from the bound. Throws CapacityError when nothing is left.
    void begin();

    // SearchOptions::hostMemoryBytes while the grid is made.
    std::uint64_t gridBytes() const { return isBounded() ? mFreeBytes : 0; }

    // Without a bound: takes what is free now, the grid's memory, and what the engine can use again.
    void beginLists(const SearchSets& sets, std::uint64_t reusableBytes);

    // SearchOptions::hostMemoryBytes while lists are made. Throws CapacityError for counts that do not fit; of other lists the
    // search itself finds that out.
    std::uint64_t listBytes(const SearchSets& sets, Encoding encoding) const;

    // SearchOptions::hostMemoryBytes while measures are made, beside lists that are held.
    std::uint64_t measureBytes(const SearchSets& sets, std::uint64_t heldBytes) const;

    // What measures and the .vdb that they are written to take in all, beside the sets and lists.
    std::uint64_t attributeBytes(const SearchSets& sets) const;

    // What rows may take that wait for others to be written (searchToNpz()); 0 where the counts do not fit.
    std::uint64_t windowBytes(const SearchSets& sets) const;

    // What the threads of streamNpz() may collect together.
    std::uint64_t bufferBytes(const SearchSets& sets) const;

    // Runs a step; a CapacityError that it throws says where the memory went.
    template <typename F>
    auto explained(F&& step) const
    {
        try {
            return step();
        } catch (const CapacityError& error) {
            throw CapacityError(error.what() + explanation(), error.neededBytes(), error.allowedBytes());
        }
    }

private:
    std::string explanation() const; // as the end of a sentence
    std::uint64_t layeredBytes(const SearchSets& sets) const;
    std::uint64_t vdbWriterBytes(std::uint64_t points) const;
    std::uint64_t writerBytes(std::uint64_t points, Encoding encoding) const;

    std::uint64_t mBoundBytes, mThreads;
    WrittenKinds mWritten;
    MeasureMemory mMeasures;
    std::uint64_t mUsedBytes = 0, mReserveBytes = 0, mFreeBytes = 0;
    bool mHasGrid = false;
};

} // namespace vdb_nns
