// Writes an .npz file while its rows are made, in the order in which they are made.
//
// Counts give every row its place. A thread collects rows until its buffer is full, orders them by number and joins those
// that are neighbors in the file into runs: particles that are numbered along space make long ones. Runs may come in any
// order, because the CRC of an array is the XOR of what each piece adds to it (crcShare); nothing is read back.
#include "io/npz_stream.h"

#include "io/npz_parts.h"
#include "io/output_file.h"
#include "io/row_sorter.h"
#include "io/set_geometry.h"
#include "lists/neighbor_lists_data.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "util/memory.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <utility>

namespace vdb_nns {

namespace {

// Bytes of rows that a thread collects unless told: runs of several leaves.
constexpr std::uint64_t kThreadBytes = std::uint64_t(64) << 20;
// A row's place in the buffer is counted in 32 bits.
constexpr std::uint64_t kMostThreadBytes = std::uint64_t(8) << 30;
// Pairs that a thread puts in order before each write.
constexpr std::size_t kStagedPairs = std::size_t(1) << 16;
// Rows whose places are made at once.
constexpr std::size_t kEndRows = std::size_t(1) << 16;

// Where each row begins: its count, and one sum for every kStep rows.
class RowPlaces {
public:
    explicit RowPlaces(std::vector<std::uint32_t> counts) : mCounts(std::move(counts))
    {
        mSums.reserve(mCounts.size() / kStep + 1);
        std::uint64_t sum = 0;
        for (std::size_t row = 0; row < mCounts.size(); ++row) {
            if (row % kStep == 0) mSums.push_back(sum);
            sum += mCounts[row];
        }
    }

    std::size_t size() const { return mCounts.size(); }
    std::uint32_t count(std::size_t row) const { return mCounts[row]; }

    // Pairs of all rows before.
    std::uint64_t begin(std::size_t row) const
    {
        std::uint64_t pairs = mSums[row / kStep];
        for (std::size_t r = row / kStep * kStep; r < row; ++r) pairs += mCounts[r];
        return pairs;
    }

private:
    static constexpr std::size_t kStep = 16; // counts of a cache line

    std::vector<std::uint32_t> mCounts;
    std::vector<std::uint64_t> mSums;
};

// What all threads share.
struct StreamedFile {
    OutputFile& file;
    const NpzRowSource& source;
    const RowPlaces& places;
    const NpzLayout& layout;
    const CancelCheck& cancel;
    bool hasDistances, isOrdered;
};

// Gathers rows in the order of the file, and writes what follows without a gap.
class RunWriter {
public:
    explicit RunWriter(const StreamedFile& shared) : mShared(shared) {}

    // `place`: pairs of the file before the row; `numbers` in the order of the file.
    void add(std::uint32_t row, std::uint64_t place, const std::uint32_t* numbers, std::uint32_t count)
    {
        if (place != mBegin + mStaged) {
            write();
            mBegin = place;
        }
        for (std::uint32_t taken = 0; taken < count;) {
            const auto n =
                static_cast<std::uint32_t>(std::min<std::size_t>(count - taken, kStagedPairs - mStaged));
            stage(row, numbers + taken, n);
            taken += n;
            if (mStaged == kStagedPairs) write();
        }
    }

    void write()
    {
        if (mStaged == 0) return;
        mShared.cancel.check();
        const std::size_t indexBytes = mShared.layout.indexBytes;
        const void* const indices =
            indexBytes == 8 ? static_cast<const void*>(mWide.data()) : mIndices.data();
        mIndicesCrc ^= writePiece(NpzLayout::kIndices, indices, indexBytes);
        if (mShared.hasDistances) mDistancesCrc ^= writePiece(NpzLayout::kData, mDistances.data(), 4);
        mPairs += mStaged;
        mBegin += mStaged;
        mStaged = 0;
    }

    // Shares of what was written.
    std::uint32_t indicesCrc() const { return mIndicesCrc; }
    std::uint32_t distancesCrc() const { return mDistancesCrc; }
    std::uint64_t pairs() const { return mPairs; }

private:
    void stage(std::uint32_t row, const std::uint32_t* numbers, std::uint32_t count)
    {
        if (mShared.layout.indexBytes == 8) {
            mWide.resize(kStagedPairs);
            std::copy_n(numbers, count, mWide.data() + mStaged);
        } else {
            mIndices.resize(kStagedPairs);
            std::copy_n(numbers, count, mIndices.data() + mStaged);
        }
        if (mShared.hasDistances) {
            mDistances.resize(kStagedPairs);
            for (std::uint32_t k = 0; k < count; ++k)
                mDistances[mStaged + k] = static_cast<float>(mShared.source.distance(row, numbers[k]));
        }
        mStaged += count;
    }

    std::uint32_t writePiece(int number, const void* data, std::size_t valueBytes)
    {
        const NpzMember& member = mShared.layout.members[number];
        const std::size_t bytes = mStaged * valueBytes;
        const std::uint64_t offset = mBegin * valueBytes;
        mShared.file.writeAt(member.valueOffset + offset, data, bytes);
        return crcShare(crcOf(0, data, bytes), member.valueBytes - offset - bytes);
    }

    const StreamedFile& mShared;
    std::vector<std::uint32_t> mIndices;
    std::vector<std::int64_t> mWide; // instead, past 2^31-1 rows
    std::vector<float> mDistances;
    std::uint64_t mBegin = 0; // pairs of the file before those staged
    std::size_t mStaged = 0;
    std::uint64_t mPairs = 0;
    std::uint32_t mIndicesCrc = 0, mDistancesCrc = 0;
};

// The rows that one thread has made and not yet written. Numbers grow from the front of the buffer, rows from its end.
class RowCollector {
public:
    RowCollector(const StreamedFile& shared, std::size_t bytes)
        : mShared(shared), mWriter(shared), mEntries(bytes / sizeof(std::uint32_t))
    {
        mBuffer = PageBlock(mEntries * sizeof(std::uint32_t));
    }

    void take(std::uint32_t row, Span<const std::uint32_t> numbers)
    {
        const auto count = static_cast<std::uint32_t>(numbers.size());
        if (count != mShared.places.count(row)) {
            throw OutputError(mShared.file.path() + ": row " + std::to_string(row) + " was counted with " +
                              std::to_string(mShared.places.count(row)) + " neighbors and came with " +
                              std::to_string(count));
        }
        if (count == 0) return;
        const std::size_t needed = count + kRowEntries;
        if (needed > mEntries - mUsed - mRows * kRowEntries) flush();
        if (needed > mEntries) {
            takeLong(row, numbers);
            return;
        }
        std::copy(numbers.begin(), numbers.end(), values() + mUsed);
        ++mRows;
        *firstRow() = {row, static_cast<std::uint32_t>(mUsed), count};
        mUsed += count;
    }

    void flush()
    {
        std::sort(firstRow(), lastRow(), [](const Row& a, const Row& b) { return a.number < b.number; });
        std::uint64_t place = 0;
        for (const Row* row = firstRow(); row != lastRow(); ++row) {
            const bool follows = row != firstRow() && row[-1].number + 1 == row->number;
            if (!follows) place = mShared.places.begin(row->number);
            mWriter.add(row->number, place, inOrder(row->number, values() + row->begin, row->count),
                        row->count);
            place += row->count;
        }
        mWriter.write();
        mUsed = mRows = 0;
    }

    const RunWriter& writer() const { return mWriter; }

private:
    struct Row {
        std::uint32_t number, begin, count;
    };
    static constexpr std::size_t kRowEntries = sizeof(Row) / sizeof(std::uint32_t);

    // A row that is longer than the buffer.
    void takeLong(std::uint32_t row, Span<const std::uint32_t> numbers)
    {
        const auto count = static_cast<std::uint32_t>(numbers.size());
        mWriter.add(row, mShared.places.begin(row), inOrder(row, numbers.data(), count), count);
        mWriter.write();
        mSorter.releaseLarge();
    }

    // In the order of the file; good until the next call.
    const std::uint32_t* inOrder(std::uint32_t row, const std::uint32_t* numbers, std::uint32_t count)
    {
        std::uint32_t* const sorted = mSorter.sorted(numbers, count);
        if (mShared.isOrdered) mShared.source.order(row, sorted, count);
        return sorted;
    }

    std::uint32_t* values() const { return static_cast<std::uint32_t*>(mBuffer.data()); }
    Row* lastRow() const { return reinterpret_cast<Row*>(values() + mEntries); }
    Row* firstRow() const { return lastRow() - mRows; }

    const StreamedFile& mShared;
    RunWriter mWriter;
    RowSorter mSorter;
    PageBlock mBuffer;
    std::size_t mEntries; // of 4 bytes
    std::size_t mUsed = 0, mRows = 0;
};

// Rows that are made are most of the work of a file: shows their progress as a part of it.
class RowProgress final : public Progress {
public:
    explicit RowProgress(Progress& whole) : mWhole(whole) {}
    void update(const char*, double fraction) override { mWhole.update("write", 0.9 * fraction); }
    bool cancelled() const override { return mWhole.cancelled(); }

private:
    Progress& mWhole;
};

void writeEnds(OutputFile& file, const RowPlaces& places, NpzMember& indptr, const CancelCheck& cancel)
{
    std::vector<std::int64_t> ends(1, 0);
    std::int64_t end = 0;
    std::uint64_t written = 0;
    for (std::size_t row = 0; row <= places.size(); ++row) {
        if (ends.size() >= kEndRows || row == places.size()) {
            cancel.check();
            const std::size_t bytes = ends.size() * sizeof(std::int64_t);
            appendValues(file, indptr, written, ends.data(), bytes, crcOf(0, ends.data(), bytes));
            written += bytes;
            ends.clear();
        }
        if (row < places.size()) ends.push_back(end += places.count(row));
    }
}

void writeRows(const StreamedFile& shared, NpzLayout& layout, std::size_t threadBytes, Progress* progress)
{
    tbb::enumerable_thread_specific<RowCollector> collectors(
        [&] { return RowCollector(shared, threadBytes); });
    std::unique_ptr<RowProgress> rowProgress;
    if (progress) rowProgress = std::make_unique<RowProgress>(*progress);
    shared.source.visitRows(
        [&](std::uint32_t row, Span<const std::uint32_t> numbers) { collectors.local().take(row, numbers); },
        rowProgress.get());
    tbb::parallel_for(collectors.range(1), [](const auto& range) {
        for (RowCollector& collector : range) collector.flush();
    });
    std::uint32_t indicesCrc = 0, distancesCrc = 0;
    std::uint64_t pairs = 0;
    for (const RowCollector& collector : collectors) {
        indicesCrc ^= collector.writer().indicesCrc();
        distancesCrc ^= collector.writer().distancesCrc();
        pairs += collector.writer().pairs();
    }
    if (pairs != shared.source.pairCount()) { // nothing is renamed then
        throw OutputError(shared.file.path() + ": " + std::to_string(pairs) + " pairs came instead of " +
                          std::to_string(shared.source.pairCount()));
    }
    NpzMember& indices = layout.members[NpzLayout::kIndices];
    NpzMember& data = layout.members[NpzLayout::kData];
    indices.crc = crcJoined(indices.crc, indicesCrc, indices.valueBytes);
    if (shared.hasDistances) data.crc = crcJoined(data.crc, distancesCrc, data.valueBytes);
}

// Rows of a search.
class SearchRows final : public NpzRowSource {
public:
    SearchRows(SearchEngine& engine, const NeighborLists& lists, const SearchOptions& options)
        : mEngine(engine), mLists(lists), mGeometry(lists.sets()), mOptions(options)
    {
    }

    std::uint64_t columnCount() const override { return mLists.sets().columnCount(); }
    std::vector<std::uint32_t> counts() const override
    {
        std::vector<std::uint32_t> counts(mLists.size());
        for (std::size_t row = 0; row < counts.size(); ++row) counts[row] = mLists.data().entriesOf(row);
        return counts;
    }
    std::uint64_t pairCount() const override { return mLists.pairCount(); }

    void visitRows(const NeighborLists::RowVisitor& visit, Progress* progress) const override
    {
        SearchOptions options = mOptions;
        options.progress = progress;
        options.radius = 0; // that of the sets
        options.nearest = mLists.data().nearest;
        options.includeSelf = mLists.data().hasSelf;
        mEngine.visitRows(mLists.sets(), visit, options);
    }

    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return mGeometry.distance(row, neighbor);
    }
    void order(std::size_t row, std::uint32_t* numbers, std::size_t count) const override
    {
        mGeometry.order(row, numbers, count);
    }

private:
    SearchEngine& mEngine;
    const NeighborLists& mLists;
    const SetGeometry mGeometry;
    const SearchOptions& mOptions;
};

} // namespace

void streamNpzRows(const std::string& path, const NpzRowSource& source, const ListForm& form,
                   const OutputOptions& output, std::size_t threadBytes, Progress* progress)
{
    const CancelCheck cancel(progress, "write");
    cancel.update(0);
    OutputFile file(path, output);
    const RowPlaces places(source.counts());
    const NpzShape shape{places.size(), source.columnCount()};
    NpzLayout layout = beginNpz(shape, source.pairCount(), form.values);
    beginFile(file, layout);
    writeEnds(file, places, layout.members[NpzLayout::kIndptr], cancel);
    isolatedIeee([&] {
        writeRows({file, source, places, layout, cancel, form.values == ListValues::kDistance,
                   form.order == RowOrder::kDistance},
                  layout, threadBytes, progress);
        if (form.values == ListValues::kConnectivity)
            writeOnes(file, layout.members[NpzLayout::kData], cancel);
    });
    finishNpz(file, layout, shape);
    cancel.update(1);
    file.commit();
}

void streamNpz(const std::string& path, SearchEngine& engine, const NeighborLists& counts,
               const ListForm& form, const OutputOptions& output, std::uint64_t bufferBytes,
               const SearchOptions& options)
{
    requireKnown(form.values, ListValues::kDistance, "kind of values");
    requireKnown(form.order, RowOrder::kDistance, "order of rows");
    const auto threads = static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    const std::uint64_t threadBytes =
        bufferBytes ? std::min(bufferBytes / threads, kMostThreadBytes) : kThreadBytes;
    streamNpzRows(path, SearchRows(engine, counts, options), form, output,
                  static_cast<std::size_t>(threadBytes), options.progress);
}

} // namespace vdb_nns
