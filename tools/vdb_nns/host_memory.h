// What --host-memory SIZE, the most memory that the process may have resident, leaves for each step of a
// search or a plan. Without it lists still leave room for what is made beside and after them.
#pragma once

#include "vdb_nns/error.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <string>

namespace vdb_nns::cli {

/// The outputs of a search, for what writing them takes.
struct OutputKinds {
    bool npz = false, vdb = false;
};

class HostMemory {
public:
    /// @param boundBytes 0: no bound, so that only lists and writers are held against what is free once the
    ///         grid is made.
    HostMemory(std::uint64_t boundBytes, int threads, const OutputKinds& outputs);

    bool isBounded() const { return mBoundBytes > 0; }
    std::uint64_t boundBytes() const { return mBoundBytes; }

    /// PointFileOptions::hostMemoryBytes.
    std::uint64_t readBytes() const;

    /// Takes the points' memory from the bound, once they are read.
    /// @throws CapacityError when nothing is left
    void beginSearch();

    /// SearchOptions::hostMemoryBytes while the grid is made.
    std::uint64_t gridBytes() const { return isBounded() ? mFreeBytes : 0; }

    /// Without a bound: takes what is free now, beside the grid. Once, before the first lists are made.
    void beginLists(const SparseGrid& grid);

    /// SearchOptions::hostMemoryBytes while lists are made.
    /// @throws CapacityError for counts that do not fit; of other lists the search itself finds that out
    std::uint64_t listBytes(const SparseGrid& grid, Encoding encoding) const;

    /// What the threads of streamNpz() may collect together.
    std::uint64_t bufferBytes(const SparseGrid& grid) const;

    /// Runs a step; a CapacityError that it throws says where the memory went.
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
    std::uint64_t writerBytes(std::uint64_t points, Encoding encoding) const;

    std::uint64_t mBoundBytes, mThreads;
    OutputKinds mOutputs;
    std::uint64_t mUsedBytes = 0, mReserveBytes = 0, mFreeBytes = 0;
};

} // namespace vdb_nns::cli
