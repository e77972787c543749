// How rows become an .npz file that are found in the order of their numbers and known by nobody before: each run goes to its
// place at once, and what depends on the number of all pairs is written last.
#pragma once

#include "io/npz_writer.h"
#include "io/row_sorter.h"
#include "search/ordered_rows.h"
#include "util/cancel.h"

#include <tbb/enumerable_thread_specific.h>

#include <cstdint>
#include <mutex>
#include <vector>

namespace vdb_nns {

class OutputFile;

class NpzInOrder final : public RowRunConsumer {
public:
    // `expectedPairs`: the indices stand elsewhere in a file in which they take 4 GiB or more (localHeader()). Where that was
    // expected wrongly, the same runs must come again.
    // Distances stand behind the indices: `expectedPairs` is exact then.
    NpzInOrder(OutputFile& file, std::uint64_t rowCount, std::uint64_t expectedPairs,
               const ParticleView* distancesOf, const CancelCheck& cancel);

    void take(const RowRun& run) override;

    // Once all runs came: ones, small members, headers, directory. False, with nothing of use in the file, if the number of
    // pairs was expected wrongly.
    bool finish(std::uint64_t pairCount);

private:
    // What one thread makes of a run. Reused, so that it stays in a cache.
    struct Staging {
        RowSorter sorter;
        std::vector<std::uint32_t> numbers;
        std::vector<std::int64_t> wide; // instead, past 2^31-1 rows
        std::vector<std::int64_t> ends;
        std::vector<float> distances;
    };
    struct Crcs {
        std::size_t rowCount;
        std::uint64_t pairCount;
        std::uint32_t ends, indices, distances;
    };

    std::uint32_t write(int member, std::uint64_t firstValue, const void* values, std::size_t valueCount,
                        std::size_t valueBytes);
    std::uint32_t writeEnds(const RowRun& run, Staging& staging);
    std::uint32_t writeDistances(const RowRun& run, Staging& staging);

    OutputFile& mFile;
    const std::uint64_t mRowCount;
    const ListValues mValues;
    const ParticleView* const mDistancesOf;
    const CancelCheck& mCancel;
    const NpzLayout mExpected;
    tbb::enumerable_thread_specific<Staging> mStaging;
    std::mutex mMutex;
    std::vector<Crcs> mRuns; // by index
};

} // namespace vdb_nns
