#include "out_of_core/simulated_device.h"

#include <algorithm>
#include <cstring>
#include <new>
#include <utility>

namespace vdb_nns {

namespace {

// The search of one block by one thread: rows one after the other into its result.
class BlockSearcher final : public RowCallback {
public:
    BlockSearcher(const SearchRun& run, const BlockSearch& block, ThreadState& state)
        : mRun(run),
          mBlock(block),
          mState(state),
          mLayout(resultLayout(block.image.leaves, block.image.endQuery - block.image.firstQuery,
                               block.encoding)),
          mContext{block.image.block, block.bounds, pollOf(run.cancel)},
          mCounts(at(mLayout.counts)),
          mRows(at(mLayout.rows)),
          mRoom(
              (resultRoom(block.resultBytes, block.image.endQuery - block.image.firstQuery, block.encoding) -
               mLayout.rows) /
              sizeof(std::uint32_t))
    {
    }

    void search()
    {
        mState.decideBy(mRun.exact, mRun.cancel);
        // A block that is redone counts once: its statistics travel with its result.
        const std::uint64_t exactBefore = mState.exactPairs;
        try {
            searchLeaves();
        } catch (const MasksDoNotFit&) {
            mEntries = std::max(countMaskWords(), mRoom + 1);
        }
        const ResultHead head{mEntries * sizeof(std::uint32_t), 0, mStatistics.bandPairs,
                              std::exchange(mState.exactPairs, exactBefore) - exactBefore};
        std::memcpy(mBlock.result, &head, sizeof head);
    }

    void take(const VisitedRows& rows) override
    {
        rows.forEach([&](std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) {
            mCounts[slot - mBlock.image.firstQuery] = count;
            if (mEntries + count <= mRoom) std::copy_n(neighbors, count, mRows + mEntries);
            mEntries += count;
        });
    }

private:
    struct MasksDoNotFit {};

    void searchLeaves()
    {
        const BlockImage& image = mBlock.image;
        std::fill_n(mCounts, image.endQuery - image.firstQuery, 0u);
        forEachTaskOfImage([&](const SearchTask& task) {
            mRun.cancel.check();
            if (mBlock.encoding == Encoding::kMask) {
                reinterpret_cast<std::uint64_t*>(mBlock.result + mLayout.leafRows)[task.leaf] = mEntries;
            }
            searchLeaf(task);
        });
    }

    // Masks that find no room are not made; how long all of them are follows from the cells.
    std::uint64_t countMaskWords() const
    {
        std::uint64_t words = 0;
        forEachTaskOfImage([&](const SearchTask& task) {
            words += maskBytes(mContext.block, mContext.block, task) / sizeof(std::uint32_t);
        });
        return words;
    }

    // f(task) for each leaf with queries.
    template <typename F>
    void forEachTaskOfImage(F&& f) const
    {
        const BlockImage& image = mBlock.image;
        for (std::uint32_t l = 0; l < image.leaves; ++l) {
            const std::uint32_t begin = std::max(image.block.leaves[l].firstSlot, image.firstQuery),
                                end = std::min(image.block.leaves[l + 1].firstSlot, image.endQuery);
            if (begin >= end) continue;
            f(SearchTask{l, begin, end, image.neighborhoods + std::size_t(l) * BlockImage::kNeighborhoodSize,
                         image.cellsOf(l)});
        }
    }

    std::uint32_t* at(std::uint64_t offset) const
    {
        return reinterpret_cast<std::uint32_t*>(mBlock.result + offset);
    }

    void searchLeaf(const SearchTask& task)
    {
        if (mBlock.encoding == Encoding::kIndex) {
            mState.beginCallbacks(*this, task, RowKind::kVisit, nullptr);
            mRun.kernels.visit(mContext, task, mState.exactPredicate(), mState.halo, mState.visited,
                               mStatistics);
            mState.flushRows();
        } else if (mBlock.encoding == Encoding::kMask && task.cells) {
            forEachWantedCell(mContext.block, task,
                              [&](const SearchTask& cell) { searchTo(mRun.kernels.mask, cell); });
        } else {
            searchTo(mBlock.encoding == Encoding::kMask ? mRun.kernels.mask : mRun.kernels.count, task);
        }
    }

    // Counts, and the rows of masks, straight to the result.
    void searchTo(SearchTaskFunction kernel, const SearchTask& task)
    {
        RowSink sink{};
        sink.out = mRows + mEntries;
        sink.end = mRows + mRoom;
        sink.grow = [](RowSink& full, std::size_t entries) {
            if (static_cast<std::size_t>(full.end - full.out) < entries) throw MasksDoNotFit();
        };
        sink.slotBase = mBlock.image.firstQuery;
        sink.rowCount = mCounts;
        kernel(mContext, task, mState.exactPredicate(), mState.halo, sink, mStatistics);
        mEntries = static_cast<std::uint64_t>(sink.out - mRows);
    }

    const SearchRun& mRun;
    const BlockSearch& mBlock;
    ThreadState& mState;
    const ResultLayout mLayout;
    const SearchContext mContext;
    std::uint32_t *const mCounts, *const mRows;
    const std::uint64_t mRoom; // entries
    std::uint64_t mEntries = 0;
    TaskStatistics mStatistics;
};

} // namespace

SimulatedDevice::SimulatedDevice(std::string name, std::uint64_t budgetBytes, const SearchRun& run,
                                 ThreadStates& states)
    : mName(std::move(name)), mBudgetBytes(budgetBytes), mRun(run), mStates(states)
{
}

// Memory that this machine has not is memory that the device has not.
SimulatedDevice::Memory SimulatedDevice::hostMemory(std::uint64_t bytes) const
{
    std::byte* const memory = new (std::nothrow) std::byte[bytes];
    if (!memory)
        throw OutOfDeviceMemory(mName + ": this machine has no " + std::to_string(bytes) + " bytes for it");
    return Memory(memory);
}

std::byte* SimulatedDevice::allocate(std::uint64_t bytes)
{
    if (bytes > mBudgetBytes - mUsedBytes) {
        throw OutOfDeviceMemory(mName + ": " + std::to_string(bytes) + " bytes do not fit beside " +
                                std::to_string(mUsedBytes) + " of a budget of " +
                                std::to_string(mBudgetBytes));
    }
    mMemory.push_back(hostMemory(bytes));
    mUsedBytes += bytes;
    mPeakBytes = std::max(mPeakBytes, mUsedBytes);
    return mMemory.back().get();
}

void SimulatedDevice::releaseAll()
{
    mMemory.clear();
    mStaging.clear();
    mUsedBytes = 0;
}

std::byte* SimulatedDevice::allocateStaging(std::uint64_t bytes)
{
    mStaging.push_back(hostMemory(bytes));
    return mStaging.back().get();
}

// In pieces, so that a run that is cancelled ends soon.
void SimulatedDevice::copy(std::byte* to, const std::byte* from, std::uint64_t bytes) const
{
    constexpr std::uint64_t kPiece = std::uint64_t(64) << 20;
    for (std::uint64_t at = 0; at < bytes; at += kPiece) {
        mRun.cancel.check();
        std::memcpy(to + at, from + at, std::min(kPiece, bytes - at));
    }
}

void SimulatedDevice::upload(int, std::byte* device, const std::byte* staging, std::uint64_t bytes)
{
    copy(device, staging, bytes);
}

void SimulatedDevice::search(int, const BlockSearch& block)
{
    BlockSearcher(mRun, block, mStates.local()).search();
}

std::byte* SimulatedDevice::download(int, std::byte* staging, std::byte* device, std::uint64_t bytes)
{
    copy(staging, device, bytes);
    return staging;
}

} // namespace vdb_nns
