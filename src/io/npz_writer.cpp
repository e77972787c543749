// Fills an .npz file with lists: blocks of rows are sorted by all threads while the block before is written.
// Memory is two blocks, whatever the lists' size; every value's place is known in advance, so the arrays grow
// side by side.
#include "io/npz_writer.h"

#include "io/npz_parts.h"
#include "io/output_file.h"
#include "io/row_sorter.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>

namespace vdb_nns {

namespace {

// Pairs of a block: 2 blocks of up to 12 bytes a pair are 50 MB; each write is large.
constexpr std::uint64_t kBlockPairs = std::uint64_t(1) << 21;
// Rows of a block, for lists that are mostly empty.
constexpr std::size_t kBlockRows = std::size_t(1) << 20;
// Pairs of a task: its values stay in the second-level cache between sorting and CRC.
constexpr std::uint64_t kTaskPairs = std::uint64_t(1) << 15;

// Rows of one task, and what it found.
struct Task {
    std::size_t rowBegin, rowEnd;
    std::uint32_t indicesCrc, distancesCrc;
};

// A run of rows that is sorted, then written.
struct Block {
    std::size_t rowBegin = 0, rowEnd = 0;
    std::uint64_t firstPair = 0;
    std::vector<std::int64_t> ends; // indptr[row + 1] of its rows
    std::vector<Task> tasks;
    std::vector<std::uint32_t> indices;
    std::vector<std::int64_t> wideIndices; // instead, past 2^31-1 rows
    std::vector<float> distances;

    std::uint64_t pairCount() const
    {
        return ends.empty() ? 0 : static_cast<std::uint64_t>(ends.back()) - firstPair;
    }
    // Pairs of the block before a row.
    std::uint64_t pairsBefore(std::size_t row) const
    {
        return row == rowBegin ? 0 : static_cast<std::uint64_t>(ends[row - rowBegin - 1]) - firstPair;
    }
};

class NpzStream {
public:
    NpzStream(OutputFile& file, const NpzRows& rows, const ListForm& form, const NpzPart* part,
              const CancelCheck& cancel)
        : mFile(file),
          mRows(rows),
          mPart(part),
          mCancel(cancel),
          mHasDistances(form.values == ListValues::kDistance),
          mIsOrdered(form.order == RowOrder::kDistance),
          mShape{rows.size(), rows.columnCount()},
          mLayout(beginNpz(mShape, rows.pairCount(), form.values, part != nullptr))
    {
    }

    void write()
    {
        beginFile(mFile, mLayout);
        const std::int64_t zero = 0;
        appendValues(mFile, mLayout.members[NpzLayout::kIndptr], 0, &zero, sizeof zero,
                     crcOf(0, &zero, sizeof zero));
        Block blocks[2];
        Block* next = &blocks[0];
        Block* ready = &blocks[1];
        plan(*next, *ready);
        sortRows(*next);
        while (next->rowEnd > next->rowBegin) {
            mCancel.update(static_cast<double>(next->rowBegin) / static_cast<double>(mRows.size()));
            std::swap(next, ready);
            tbb::parallel_invoke([&] { writeBlock(*ready); },
                                 [&] {
                                     plan(*next, *ready);
                                     sortRows(*next);
                                 });
        }
        if (next->firstPair != mRows.pairCount()) { // nothing is renamed then
            throw OutputError(mFile.path() + ": the counts of the lists sum to " +
                              std::to_string(next->firstPair) + " pairs instead of " +
                              std::to_string(mRows.pairCount()));
        }
        NpzMember& data = mLayout.members[NpzLayout::kData];
        if (!mHasDistances) data.crc = crcJoined(data.crc, crcOfOnes(mRows.pairCount()), mRows.pairCount());
        finishNpz(mFile, mLayout, mShape, mPart);
    }

private:
    // The rows that follow a block, and where their pairs go.
    void plan(Block& block, const Block& before)
    {
        block.rowBegin = block.rowEnd = before.rowEnd;
        block.firstPair = before.firstPair + before.pairCount();
        block.ends.clear();
        block.tasks.clear();
        std::uint64_t end = block.firstPair, taskStart = end;
        std::size_t taskRow = block.rowBegin;
        while (block.rowEnd < mRows.size() && block.rowEnd - block.rowBegin < kBlockRows &&
               end - block.firstPair < kBlockPairs) {
            end += mRows.count(block.rowEnd++);
            block.ends.push_back(static_cast<std::int64_t>(end));
            if (end - taskStart >= kTaskPairs) {
                block.tasks.push_back({taskRow, block.rowEnd, 0, 0});
                taskRow = block.rowEnd;
                taskStart = end;
            }
        }
        if (taskRow < block.rowEnd) block.tasks.push_back({taskRow, block.rowEnd, 0, 0});
    }

    void sortRows(Block& block)
    {
        const std::size_t pairs = static_cast<std::size_t>(block.pairCount());
        if (block.indices.size() < pairs) block.indices.resize(pairs);
        if (mLayout.indexBytes == 8 && block.wideIndices.size() < pairs) block.wideIndices.resize(pairs);
        if (mHasDistances && block.distances.size() < pairs) block.distances.resize(pairs);
        tbb::parallel_for(std::size_t(0), block.tasks.size(),
                          [&](std::size_t i) { sortTask(block, block.tasks[i]); });
    }

    void sortTask(Block& block, Task& task)
    {
        mCancel.check();
        const std::uint64_t first = block.pairsBefore(task.rowBegin);
        std::uint32_t* row = block.indices.data() + first;
        const std::uint32_t* const taskEnd = block.indices.data() + block.pairsBefore(task.rowEnd);
        for (std::size_t i = task.rowBegin; i < task.rowEnd; ++i) {
            std::uint32_t* const rowEnd = block.indices.data() + block.pairsBefore(i + 1);
            sortInto(i, row, rowEnd, taskEnd);
            if (mIsOrdered) mRows.order(i, row, static_cast<std::size_t>(rowEnd - row));
            if (mHasDistances) {
                float* distance = block.distances.data() + (row - block.indices.data());
                for (; row != rowEnd; ++row) *distance++ = static_cast<float>(mRows.distance(i, *row));
            }
            row = rowEnd;
        }
        const std::size_t pairs = static_cast<std::size_t>(block.pairsBefore(task.rowEnd) - first);
        if (mLayout.indexBytes == 8) {
            std::copy_n(block.indices.data() + first, pairs, block.wideIndices.data() + first);
            task.indicesCrc = crcOf(0, block.wideIndices.data() + first, pairs * 8);
        } else {
            task.indicesCrc = crcOf(0, block.indices.data() + first, pairs * 4);
        }
        if (mHasDistances) task.distancesCrc = crcOf(0, block.distances.data() + first, pairs * 4);
    }

    // Sorting writes past a row's end; what follows the task's last one is another thread's.
    void sortInto(std::size_t row, std::uint32_t* out, const std::uint32_t* outEnd,
                  const std::uint32_t* taskEnd)
    {
        const auto count = static_cast<std::size_t>(outEnd - out);
        Sorting& memory = mSorting.local();
        if (memory.row.size() < count) memory.row.resize(count);
        mRows.copyRow(row, memory.row.data());
        if (static_cast<std::size_t>(taskEnd - outEnd) >= kSortOverrun) {
            memory.sorter.sort(memory.row.data(), count, out);
        } else {
            std::copy_n(memory.sorter.sorted(memory.row.data(), count), count, out);
        }
    }

    void writeBlock(const Block& block)
    {
        const std::uint64_t pairs = block.pairCount();
        const std::size_t endBytes = block.ends.size() * sizeof(std::int64_t);
        appendValues(mFile, mLayout.members[NpzLayout::kIndptr], 8 * (block.rowBegin + 1), block.ends.data(),
                     endBytes, crcOf(0, block.ends.data(), endBytes));
        const bool isWide = mLayout.indexBytes == 8;
        const void* const indices =
            isWide ? static_cast<const void*>(block.wideIndices.data()) : block.indices.data();
        mFile.writeAt(mLayout.members[NpzLayout::kIndices].valueOffset + block.firstPair * mLayout.indexBytes,
                      indices, static_cast<std::size_t>(pairs) * mLayout.indexBytes);
        const NpzMember& data = mLayout.members[NpzLayout::kData];
        if (mHasDistances) {
            mFile.writeAt(data.valueOffset + block.firstPair * 4, block.distances.data(),
                          static_cast<std::size_t>(pairs) * 4);
        } else {
            if (mOnes.size() < pairs) mOnes.resize(static_cast<std::size_t>(pairs), 1);
            mFile.writeAt(data.valueOffset + block.firstPair, mOnes.data(), static_cast<std::size_t>(pairs));
        }
        joinCrcs(block);
    }

    void joinCrcs(const Block& block)
    {
        for (const Task& task : block.tasks) {
            const std::uint64_t pairs = block.pairsBefore(task.rowEnd) - block.pairsBefore(task.rowBegin);
            std::uint32_t& indices = mLayout.members[NpzLayout::kIndices].crc;
            indices = crcJoined(indices, task.indicesCrc, pairs * mLayout.indexBytes);
            std::uint32_t& data = mLayout.members[NpzLayout::kData].crc;
            if (mHasDistances) data = crcJoined(data, task.distancesCrc, pairs * 4);
        }
    }

    struct Sorting {
        RowSorter sorter;
        std::vector<std::uint32_t> row;
    };

    OutputFile& mFile;
    const NpzRows& mRows;
    const NpzPart* const mPart;
    const CancelCheck& mCancel;
    const bool mHasDistances, mIsOrdered;
    const NpzShape mShape;
    NpzLayout mLayout;
    tbb::enumerable_thread_specific<Sorting> mSorting;
    std::vector<std::int8_t> mOnes;
};

} // namespace

void writeNpzRows(const std::string& path, const NpzRows& rows, const ListForm& form,
                  const OutputOptions& options, Progress* progress, const NpzPart* part)
{
    const CancelCheck cancel(progress, "write");
    cancel.update(0);
    OutputFile file(path, options);
    isolatedIeee([&] { NpzStream(file, rows, form, part, cancel).write(); });
    cancel.update(1);
    file.commit();
}

} // namespace vdb_nns
