#include "io/npz_in_order.h"

#include "io/npz_parts.h"
#include "io/output_file.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns {

namespace {

// Distances of which nobody asks whether to stop: some milliseconds.
constexpr std::size_t kDistancesBetweenChecks = std::size_t(1) << 16;

template <typename T>
T* atLeast(std::vector<T>& values, std::size_t size)
{
    if (values.size() < size) values.resize(size);
    return values.data();
}

} // namespace

NpzInOrder::NpzInOrder(OutputFile& file, std::uint64_t rowCount, std::uint64_t expectedPairs,
                       const ParticleView* distancesOf, const CancelCheck& cancel)
    : mFile(file),
      mRowCount(rowCount),
      mValues(distancesOf ? ListValues::kDistance : ListValues::kConnectivity),
      mDistancesOf(distancesOf),
      mCancel(cancel),
      mExpected(layoutNpz(rowCount, expectedPairs, mValues))
{
}

void NpzInOrder::take(const RowRun& run)
{
    mCancel.check();
    Staging& staging = mStaging.local();
    std::uint32_t* const numbers =
        atLeast(staging.numbers, static_cast<std::size_t>(run.pairCount) + kSortOverrun);
    std::uint32_t* next = numbers;
    for (std::size_t k = 0; k < run.rowCount; next += run.counts[k++]) {
        if (run.counts[k] > 0) staging.sorter.sort(run.rows[k], run.counts[k], next);
    }
    const auto pairs = static_cast<std::size_t>(run.pairCount);
    Crcs crcs{run.rowCount, run.pairCount, writeEnds(run, staging), 0, 0};
    if (mExpected.indexBytes == 8) {
        std::int64_t* const wide = atLeast(staging.wide, pairs);
        std::copy_n(numbers, pairs, wide);
        crcs.indices = write(NpzLayout::kIndices, run.firstPair, wide, pairs, sizeof *wide);
    } else {
        crcs.indices = write(NpzLayout::kIndices, run.firstPair, numbers, pairs, sizeof *numbers);
    }
    if (mDistancesOf) crcs.distances = writeDistances(run, staging);
    const std::lock_guard<std::mutex> lock(mMutex);
    if (mRuns.size() <= run.index) mRuns.resize(run.index + 1);
    mRuns[run.index] = crcs;
}

std::uint32_t NpzInOrder::write(int member, std::uint64_t firstValue, const void* values,
                                std::size_t valueCount, std::size_t valueBytes)
{
    const std::size_t bytes = valueCount * valueBytes;
    mFile.writeAt(mExpected.members[member].valueOffset + firstValue * valueBytes, values, bytes);
    return crcOf(0, values, bytes);
}

std::uint32_t NpzInOrder::writeEnds(const RowRun& run, Staging& staging)
{
    std::int64_t* const ends = atLeast(staging.ends, run.rowCount);
    auto end = static_cast<std::int64_t>(run.firstPair);
    for (std::size_t k = 0; k < run.rowCount; ++k) ends[k] = end += run.counts[k];
    return write(NpzLayout::kIndptr, run.firstRow + 1, ends, run.rowCount,
                 sizeof *ends); // before it stands the 0
}

std::uint32_t NpzInOrder::writeDistances(const RowRun& run, Staging& staging)
{
    const auto pairs = static_cast<std::size_t>(run.pairCount);
    float* const distances = atLeast(staging.distances, pairs);
    std::size_t next = 0;
    for (std::size_t k = 0; k < run.rowCount; ++k) {
        for (const std::size_t end = next + run.counts[k]; next < end; ++next) {
            if (next % kDistancesBetweenChecks == 0) mCancel.check();
            distances[next] =
                static_cast<float>(mDistancesOf->distance(run.firstRow + k, staging.numbers[next]));
        }
    }
    return write(NpzLayout::kData, run.firstPair, distances, pairs, sizeof *distances);
}

bool NpzInOrder::finish(std::uint64_t pairCount)
{
    NpzLayout layout = beginNpz(mRowCount, pairCount, mValues);
    NpzMember& indptr = layout.members[NpzLayout::kIndptr];
    NpzMember& indices = layout.members[NpzLayout::kIndices];
    NpzMember& data = layout.members[NpzLayout::kData];
    if (indices.valueOffset != mExpected.members[NpzLayout::kIndices].valueOffset) return false;
    if (mDistancesOf && data.valueOffset != mExpected.members[NpzLayout::kData].valueOffset) return false;
    requireRoom(mFile, layout);
    const std::int64_t zero = 0;
    appendValues(mFile, indptr, 0, &zero, sizeof zero, crcOf(0, &zero, sizeof zero));
    std::uint64_t rows = 0, pairs = 0;
    for (const Crcs& run : mRuns) {
        indptr.crc = crcJoined(indptr.crc, run.ends, run.rowCount * sizeof(std::int64_t));
        indices.crc = crcJoined(indices.crc, run.indices, run.pairCount * mExpected.indexBytes);
        if (mDistancesOf) data.crc = crcJoined(data.crc, run.distances, run.pairCount * sizeof(float));
        rows += run.rowCount;
        pairs += run.pairCount;
    }
    if (rows != mRowCount || pairs != pairCount) { // nothing is renamed then
        throw OutputError(mFile.path() + ": " + std::to_string(pairs) + " pairs of " + std::to_string(rows) +
                          " rows came instead of " + std::to_string(pairCount) + " of " +
                          std::to_string(mRowCount));
    }
    if (!mDistancesOf) writeOnes(mFile, data, mCancel);
    finishNpz(mFile, layout, mRowCount);
    return true;
}

} // namespace vdb_nns
