// What methods that write rows by themselves share: buffers that are kept from run to run, and what writes into them.
#pragma once

#include "bench/method.h"

#include <cstddef>
#include <cstdint>
#include <mutex>

namespace vdb_nns::cli {

/// Hands out buffers of RowBuffers to writers.
class RowPool {
public:
    explicit RowPool(RowBuffers& rows) : mRows(rows) {}

    /// All buffers are free again.
    void restart() { mUsed = 0; }
    RowBuffers& rows() { return mRows; }

    /// A buffer of at least so many numbers. Thread-safe. Buffers given out stay where they are.
    std::uint32_t take(std::size_t least, std::uint32_t*& begin, std::size_t& size);

private:
    /// Large enough that the rows cut off at its end are few, small enough that the last ones of few threads are.
    static constexpr std::size_t kNumbers = std::size_t(1) << 18;

    RowBuffers& mRows;
    std::mutex mMutex;
    std::size_t mUsed = 0;
};

/// One thread's.
class RowWriter {
public:
    explicit RowWriter(RowPool& pool) : mPool(&pool) {}

    /// To be called when the pool restarts.
    void restart()
    {
        mSize = mUsed = 0;
        mPairs = 0;
    }

    /// Room for so many numbers, until commit().
    std::uint32_t* reserve(std::size_t most)
    {
        if (mSize - mUsed < most) {
            mBuffer = mPool->take(most, mBegin, mSize);
            mUsed = 0;
        }
        return mBegin + mUsed;
    }

    /// The row of a query is the first `count` numbers there.
    void commit(std::uint32_t query, std::uint32_t count)
    {
        mPool->rows().places[query] = {mUsed, count, mBuffer};
        mUsed += count;
        mPairs += count;
    }

    /// Both, for a row that stands elsewhere.
    void append(std::uint32_t query, const std::uint32_t* row, std::size_t count);

    std::uint64_t pairs() const { return mPairs; }

private:
    RowPool* mPool;
    std::uint32_t* mBegin = nullptr;
    std::size_t mUsed = 0, mSize = 0;
    std::uint32_t mBuffer = 0;
    std::uint64_t mPairs = 0;
};

class RowMethod : public Method {
public:
    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) final;
    MethodRun runSets(const SetSearch& search, const ProgressSpan& span) final;
    void discard() override { mHasResult = false; }
    const FoundNeighbors& found() const override;

protected:
    /// Writes a row for every query that has the role, and fills in seconds, pairs and structureBytes. Rows
    /// of others are empty before.
    virtual void search(const SetSearch& search, MethodRun& result) = 0;

    RowBuffers mRows;
    RowPool mPool{mRows};

private:
    bool mHasResult = false;
};

} // namespace vdb_nns::cli
