#include "io/npz_in_order.h"

#include "io/npz_parts.h"
#include "io/output_file.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns {

namespace {

// Distances of which nobody asks whether to stop: some milliseconds.
constexpr std::size_t kDistancesBetweenChecks = std::size_t(1) << 16;

// An array's blocks are reserved ahead of its values: as much again as is written, within these bounds.
constexpr std::uint64_t kLeastReserveBytes = std::uint64_t(1) << 20, kMostReserveBytes = std::uint64_t(256)
                                                                                         << 20;
// Longer buffers, of runs with a very long row, are not kept for the next run.
constexpr std::uint64_t kKeptPairs = std::uint64_t(1) << 20;
// Buffers that wait to be written while their threads go on.
constexpr std::size_t kMostQueued = 4;

// Rows lie where their leaves put them, and a processor does not guess where the next one is.
constexpr std::size_t kRowsAhead = 8;

void prefetch(const std::uint32_t* row, std::uint32_t count)
{
    constexpr std::uint32_t kLine = 16,
                            kMost = 16 * kLine; // entries; the rest of a long row is guessed right
    for (std::uint32_t k = 0; k < std::min(count, kMost); k += kLine) __builtin_prefetch(row + k);
}

template <typename T>
T* atLeast(std::vector<T>& values, std::size_t size)
{
    if (values.size() < size) values.resize(size);
    return values.data();
}

} // namespace

NpzInOrder::NpzInOrder(OutputFile& file, const NpzShape& shape, std::uint64_t expectedPairs,
                       const ListForm& form, const RowGeometry& geometry, const CancelCheck& cancel)
    : mFile(file),
      mShape(shape),
      mForm(form),
      mHasDistances(form.values == ListValues::kDistance),
      mGeometry(geometry),
      mCancel(cancel),
      mExpected(layoutNpz(shape, expectedPairs, form.values))
{
}

void NpzInOrder::take(const RowRun& run)
{
    mCancel.check();
    std::unique_ptr<Buffer> buffer = takeBuffer();
    const Crcs crcs = fill(run, *buffer);
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        if (mRuns.size() <= run.index) mRuns.resize(run.index + 1);
        mRuns[run.index] = crcs;
    }
    pass(std::move(buffer));
}

std::unique_ptr<NpzInOrder::Buffer> NpzInOrder::takeBuffer()
{
    const std::lock_guard<std::mutex> lock(mMutex);
    if (mFree.empty()) return std::make_unique<Buffer>();
    std::unique_ptr<Buffer> buffer = std::move(mFree.back()); // likeliest to be in a cache
    mFree.pop_back();
    return buffer;
}

NpzInOrder::Crcs NpzInOrder::fill(const RowRun& run, Buffer& buffer)
{
    buffer.firstRow = run.firstRow;
    buffer.rowCount = run.rowCount;
    buffer.firstPair = run.firstPair;
    buffer.pairCount = run.pairCount;
    const auto pairs = static_cast<std::size_t>(run.pairCount);
    std::int64_t* const ends = atLeast(buffer.ends, run.rowCount);
    std::uint32_t* next = atLeast(buffer.numbers, pairs + kSortOverrun);
    auto end = static_cast<std::int64_t>(run.firstPair);
    RowSorter& sorter = mSorters.local();
    for (std::size_t k = 0; k < run.rowCount; ++k) {
        const std::uint32_t count = run.counts[k];
        if (k + kRowsAhead < run.rowCount) prefetch(run.rows[k + kRowsAhead], run.counts[k + kRowsAhead]);
        if (count > 0) sorter.sort(run.rows[k], count, next);
        if (mForm.order == RowOrder::kDistance) mGeometry.order(run.firstRow + k, next, count);
        next += count;
        ends[k] = end += count;
    }
    sorter.releaseLarge();
    if (mExpected.indexBytes == 8) std::copy_n(buffer.numbers.data(), pairs, atLeast(buffer.wide, pairs));
    if (mHasDistances) fillDistances(buffer);
    return {run.rowCount, run.pairCount, crcOf(0, ends, run.rowCount * sizeof *ends),
            crcOf(0, indicesOf(buffer), pairs * mExpected.indexBytes),
            mHasDistances ? crcOf(0, buffer.distances.data(), pairs * sizeof(float)) : 0};
}

void NpzInOrder::fillDistances(Buffer& buffer) const
{
    float* const distances = atLeast(buffer.distances, static_cast<std::size_t>(buffer.pairCount));
    std::size_t next = 0;
    for (std::size_t k = 0; k < buffer.rowCount; ++k) {
        const auto end =
            static_cast<std::size_t>(static_cast<std::uint64_t>(buffer.ends[k]) - buffer.firstPair);
        for (; next < end; ++next) {
            if (next % kDistancesBetweenChecks == 0) mCancel.check();
            distances[next] =
                static_cast<float>(mGeometry.distance(buffer.firstRow + k, buffer.numbers[next]));
        }
    }
}

const void* NpzInOrder::indicesOf(const Buffer& buffer) const
{
    if (mExpected.indexBytes == 8) return buffer.wide.data();
    return buffer.numbers.data();
}

// `end`: of the values written next. Reserves nothing past the values that are expected, until more come.
void NpzInOrder::reserveAhead(const NpzMember& member, std::uint64_t end, std::uint64_t& reserved)
{
    if (end <= reserved) return;
    std::uint64_t wanted = end + std::clamp(end, kLeastReserveBytes, kMostReserveBytes);
    if (end <= member.valueBytes) wanted = std::min(wanted, member.valueBytes);
    mFile.reserve(member.valueOffset + reserved, member.valueOffset + wanted);
    reserved = wanted;
}

void NpzInOrder::write(const Buffer& buffer)
{
    const auto writeValues = [&](int number, std::uint64_t first, const void* values, std::uint64_t count,
                                 std::size_t bytes) {
        mFile.writeAt(mExpected.members[number].valueOffset + first * bytes, values,
                      static_cast<std::size_t>(count) * bytes);
    };
    const auto reserve = [&](int number, std::uint64_t end, std::size_t bytes) {
        reserveAhead(mExpected.members[number], end * bytes, mReserved[number]);
    };
    reserve(NpzLayout::kIndptr, buffer.firstRow + buffer.rowCount + 1, sizeof(std::int64_t));
    reserve(NpzLayout::kIndices, buffer.firstPair + buffer.pairCount, mExpected.indexBytes);
    if (mHasDistances) reserve(NpzLayout::kData, buffer.firstPair + buffer.pairCount, sizeof(float));
    // Before the end of the first row stands a 0.
    writeValues(NpzLayout::kIndptr, buffer.firstRow + 1, buffer.ends.data(), buffer.rowCount,
                sizeof(std::int64_t));
    writeValues(NpzLayout::kIndices, buffer.firstPair, indicesOf(buffer), buffer.pairCount,
                mExpected.indexBytes);
    if (mHasDistances)
        writeValues(NpzLayout::kData, buffer.firstPair, buffer.distances.data(), buffer.pairCount,
                    sizeof(float));
}

// Writes it, and what others leave meanwhile; or leaves it to the one who writes.
void NpzInOrder::pass(std::unique_ptr<Buffer> buffer)
{
    std::unique_lock<std::mutex> lock(mMutex);
    mQueue.push_back(std::move(buffer));
    if (mIsWriting) {
        mWritten.wait(lock, [&] { return mQueue.size() < kMostQueued || !mIsWriting || mFailed; });
        if (mIsWriting || mFailed) return;
    }
    mIsWriting = true;
    while (!mQueue.empty() && !mFailed) {
        std::unique_ptr<Buffer> next = std::move(mQueue.front());
        mQueue.pop_front();
        lock.unlock();
        try {
            mCancel.check();
            write(*next);
        } catch (...) {
            lock.lock();
            mFailed = true; // nobody waits for this one
            mWritten.notify_all();
            throw;
        }
        lock.lock();
        if (next->pairCount <= kKeptPairs) mFree.push_back(std::move(next));
        mWritten.notify_all();
    }
    mIsWriting = false;
}

bool NpzInOrder::finish(std::uint64_t pairCount)
{
    NpzLayout layout = beginNpz(mShape, pairCount, mForm.values);
    NpzMember& indptr = layout.members[NpzLayout::kIndptr];
    NpzMember& indices = layout.members[NpzLayout::kIndices];
    NpzMember& data = layout.members[NpzLayout::kData];
    if (indices.valueOffset != mExpected.members[NpzLayout::kIndices].valueOffset) return false;
    if (mHasDistances && data.valueOffset != mExpected.members[NpzLayout::kData].valueOffset) return false;
    // No requireRoom(): the rows have their blocks already.
    mFile.reserve(indices.valueOffset + indices.valueBytes,
                  layout.directoryOffset + centralDirectory(layout).size());
    const std::int64_t zero = 0;
    appendValues(mFile, indptr, 0, &zero, sizeof zero, crcOf(0, &zero, sizeof zero));
    std::uint64_t rows = 0, pairs = 0;
    for (const Crcs& run : mRuns) {
        indptr.crc = crcJoined(indptr.crc, run.ends, run.rowCount * sizeof(std::int64_t));
        indices.crc = crcJoined(indices.crc, run.indices, run.pairCount * mExpected.indexBytes);
        if (mHasDistances) data.crc = crcJoined(data.crc, run.distances, run.pairCount * sizeof(float));
        rows += run.rowCount;
        pairs += run.pairCount;
    }
    if (rows != mShape.rows || pairs != pairCount) { // nothing is renamed then
        throw OutputError(mFile.path() + ": " + std::to_string(pairs) + " pairs of " + std::to_string(rows) +
                          " rows came instead of " + std::to_string(pairCount) + " of " +
                          std::to_string(mShape.rows));
    }
    if (!mHasDistances) writeOnes(mFile, data, mCancel);
    finishNpz(mFile, layout, mShape);
    return true;
}

} // namespace vdb_nns
