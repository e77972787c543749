// How rows become an .npz file that are found in the order of their numbers and known by nobody before: each run goes to its
// place at once, and what depends on the number of all pairs is written last.
//
// A thread sorts its run in a buffer. One at a time writes, for a file system lets in no more, and those that waited would spin;
// the others leave their buffers to it and go on.
#pragma once

#include "io/npz_writer.h"
#include "io/row_sorter.h"
#include "search/ordered_rows.h"
#include "util/cancel.h"

#include <tbb/enumerable_thread_specific.h>

#include <array>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <vector>

namespace vdb_nns {

class OutputFile;

class NpzInOrder final : public RowRunConsumer {
public:
    // `expectedPairs`: the indices stand elsewhere in a file in which they take 4 GiB or more (localHeader()). Where that was
    // expected wrongly, the same runs must come again.
    // Distances stand behind the indices: `expectedPairs` is exact then.
    NpzInOrder(OutputFile& file, const NpzShape& shape, std::uint64_t expectedPairs, const ListForm& form,
               const RowGeometry& geometry, const CancelCheck& cancel);

    void take(const RowRun& run) override;

    // Once all runs came: ones, small members, headers, directory. False, with nothing of use in the file, if the number of
    // pairs was expected wrongly.
    bool finish(std::uint64_t pairCount);

private:
    // A run as it stands in the file.
    struct Buffer {
        std::uint64_t firstRow, rowCount, firstPair, pairCount;
        std::vector<std::int64_t> ends;
        std::vector<std::uint32_t> numbers;
        std::vector<std::int64_t> wide; // instead, past 2^31-1 columns
        std::vector<float> distances;
    };
    struct Crcs {
        std::uint64_t rowCount, pairCount;
        std::uint32_t ends, indices, distances;
    };

    const void* indicesOf(const Buffer& buffer) const;
    Crcs fill(const RowRun& run, Buffer& buffer);
    void fillDistances(Buffer& buffer) const;
    void reserveAhead(const NpzMember& member, std::uint64_t end, std::uint64_t& reserved);
    void write(const Buffer& buffer);
    std::unique_ptr<Buffer> takeBuffer();
    void pass(std::unique_ptr<Buffer> buffer);

    OutputFile& mFile;
    const NpzShape mShape;
    const ListForm mForm;
    const bool mHasDistances;
    const RowGeometry& mGeometry;
    const CancelCheck& mCancel;
    const NpzLayout mExpected;
    tbb::enumerable_thread_specific<RowSorter> mSorters;
    std::mutex mMutex;
    std::condition_variable mWritten;
    bool mIsWriting = false, mFailed = false;
    std::vector<std::unique_ptr<Buffer>> mFree;
    std::deque<std::unique_ptr<Buffer>> mQueue; // to be written
    std::vector<Crcs> mRuns;                    // by index
    // Bytes of each member's values, from its first one; for the thread that writes.
    std::array<std::uint64_t, NpzLayout::kMembers> mReserved{};
};

} // namespace vdb_nns
