// What each step of a job holds, in bytes, and what is left of the bound for it.
#include "job/host_budget.h"

#include "search/layered_rows.h"
#include "vdb_nns/memory.h"
#include "vdb_nns/particle_view.h"

#include <algorithm>

namespace vdb_nns {
namespace {

constexpr std::uint64_t kMiB = std::uint64_t(1) << 20;
// The dozen large arrays of a search each end inside of a huge page of 2 MiB; and the heap's own losses.
constexpr std::uint64_t kArrayReserve = 24 * kMiB;
// A thread's scratch, stack and heap, two huge pages and something. Scratch is 88 bytes for each particle of a leaf and its halo. With
// 4 MiB each, two threads on a busy machine passed a bound of 110 MB by 0.3 in one of 25 runs.
constexpr std::uint64_t kThreadReserve = 5 * kMiB;
// writeNpz(): two blocks of 2 M pairs and their ends.
constexpr std::uint64_t kNpzWriter = 52 * kMiB;
// What a thread of streamNpz() collects: enough for writes of many rows; more than the largest need not be, and
// without a bound not more than usual.
constexpr std::uint64_t kLeastBuffer = 1 * kMiB, kUsualBuffer = 64 * kMiB, kLargestBuffer = 256 * kMiB;
// OpenVDB's writer; and for each particle the counts, and a copy of the attributes: of the counts, if there are no others.
constexpr std::uint64_t kVdbWriter = 16 * kMiB, kCountsWritten = 4, kFewestAttributes = 4;
// Of a point of a new grid: its place while points are sorted, its number there and as the attribute `id`, and P.
constexpr std::uint64_t kNewGridPoint = 16 + 4 + 4 + 12;
// What a thread makes of rows on several lattices before they are joined.
constexpr std::uint64_t kLayeredBytes = LayeredRows::kMostBytes;
// The tasks of a search, for each leaf; and for each the start of its mask rows, once more while they are ordered.
constexpr std::uint64_t kTaskBytes = 16, kMaskTaskBytes = 32;
// Of searchToNpz(): the tasks of a search in another order too, and their groups; a run of rows for each thread.
constexpr std::uint64_t kOrderedTaskBytes = 64, kStagingBytes = 8 * kMiB;
// The way to the mask rows of each cell.
constexpr std::uint64_t kMaskCellBytes = 16;
// From a particle's number to its row; the row's count; its place in a file that rows go straight to.
constexpr std::uint64_t kNumberBytes = 4, kCountBytes = 4, kPlaceBytes = 5;

std::uint64_t difference(std::uint64_t from, std::uint64_t bytes)
{
    return from > bytes ? from - bytes : 0;
}

} // namespace

HostBudget::HostBudget(std::uint64_t boundBytes, int threads, const WrittenKinds& written,
                       const MeasureMemory& measures)
    : mBoundBytes(boundBytes),
      mThreads(static_cast<std::uint64_t>(threads)),
      mWritten(written),
      mMeasures(measures),
      mReserveBytes(kArrayReserve + mThreads * kThreadReserve)
{
    if (isBounded()) returnFreedMemory();
}

void HostBudget::begin()
{
    if (!isBounded()) return;
    returnFreedMemory();
    mUsedBytes = residentMemoryBytes();
    const std::uint64_t needed = mUsedBytes + mReserveBytes;
    if (needed >= mBoundBytes) {
        throw CapacityError("the points alone need " + std::to_string(needed) + " bytes, allowed are " +
                                std::to_string(mBoundBytes) + ": allow more host memory",
                            needed, mBoundBytes);
    }
    mFreeBytes = mBoundBytes - needed;
}

void HostBudget::beginLists(const SearchSets& sets, std::uint64_t reusableBytes)
{
    mHasGrid = true;
    if (isBounded()) return;
    mFreeBytes = difference(availableMemoryBytes() + sets.bytes() + reusableBytes, mReserveBytes);
}

std::uint64_t HostBudget::vdbWriterBytes(std::uint64_t points) const
{
    const std::uint64_t attributes = std::max(kFewestAttributes, mMeasures.resultBytesEach());
    const std::uint64_t gridEach = mWritten.newGrid ? kNewGridPoint + mWritten.keptBytes : 0;
    return kVdbWriter + (kCountsWritten + attributes + gridEach) * points;
}

// Of the outputs, which are written one after the other, the largest need. Without lists the rows of an .npz are streamed.
std::uint64_t HostBudget::writerBytes(std::uint64_t points, Encoding encoding) const
{
    const std::uint64_t npz =
        encoding == Encoding::kNone ? kPlaceBytes * points + mThreads * kLeastBuffer : kNpzWriter;
    return std::max(mWritten.npz ? npz : 0, mWritten.vdb ? vdbWriterBytes(points) : 0);
}

std::uint64_t HostBudget::layeredBytes(const SearchSets& sets) const
{
    return sets.latticeCount() > 1 ? mThreads * kLayeredBytes : 0;
}

std::uint64_t HostBudget::listBytes(const SearchSets& sets, Encoding encoding) const
{
    const std::uint64_t points = sets.rowCount(), leaves = sets.leafCount();
    std::uint64_t beside =
        kNumberBytes * points + kTaskBytes * leaves + writerBytes(points, encoding) + layeredBytes(sets);
    // Measures that are made in the pass that counts have their own look at what is left.
    if (encoding != Encoding::kNone) beside += mMeasures.bytes(sets);
    if (encoding == Encoding::kMask) {
        beside += kMaskTaskBytes * leaves + kMaskCellBytes * (sets.cellCount() + leaves);
    }
    const std::uint64_t needed = sets.bytes() + kCountBytes * points + beside;
    if (needed > mFreeBytes && encoding == Encoding::kNone) {
        throw CapacityError("the grid and the counts of " + std::to_string(points) + " particles need " +
                                std::to_string(needed) + " bytes, allowed are " + std::to_string(mFreeBytes) +
                                ": allow more host memory, or search a part of the particles at a time",
                            needed, mFreeBytes);
    }
    return std::max<std::uint64_t>(1, difference(mFreeBytes, beside)); // 0 would be no bound
}

std::uint64_t HostBudget::measureBytes(const SearchSets& sets, std::uint64_t heldBytes) const
{
    if (!isBounded()) return 0;
    return std::max<std::uint64_t>(1, difference(listBytes(sets, Encoding::kNone), heldBytes));
}

std::uint64_t HostBudget::attributeBytes(const SearchSets& sets) const
{
    const std::uint64_t written = mWritten.vdb ? vdbWriterBytes(sets.rowCount()) : 0;
    return mMeasures.inputBytes() + mMeasures.bytes(sets) + written;
}

std::uint64_t HostBudget::windowBytes(const SearchSets& sets) const
{
    const std::uint64_t points = sets.rowCount();
    return difference(mFreeBytes, sets.bytes() + (kNumberBytes + 2 * kCountBytes) * points +
                                      kOrderedTaskBytes * sets.leafCount() + mThreads * kStagingBytes +
                                      layeredBytes(sets));
}

std::uint64_t HostBudget::bufferBytes(const SearchSets& sets) const
{
    const std::uint64_t points = sets.rowCount();
    const std::uint64_t held = sets.bytes() + (kNumberBytes + kCountBytes + kPlaceBytes) * points +
                               kTaskBytes * sets.leafCount() + layeredBytes(sets) +
                               mMeasures.resultBytesEach() * points;
    // TBB may replace a worker that rests by another one, which collects rows of its own: with nothing for that, 7 of 80 runs on
    // two threads passed their bound of 110 MB by up to 1.2 MB.
    const std::uint64_t collected = difference(mFreeBytes, held) / (mThreads + 1) * mThreads;
    return std::clamp(collected, mThreads * kLeastBuffer,
                      mThreads * (isBounded() ? kLargestBuffer : kUsualBuffer));
}

std::string HostBudget::explanation() const
{
    if (!isBounded()) {
        if (!mHasGrid) return {};
        return " (of the memory that is free beside the program and the points, " +
               std::to_string(mReserveBytes) + " are kept for the threads and for what arrays lose)";
    }
    return " (of the host memory allowed, which is " + std::to_string(mBoundBytes) +
           ", the program and the points use " + std::to_string(mUsedBytes) + ", and " +
           std::to_string(mReserveBytes) + " are kept for the threads and for what arrays lose)";
}

} // namespace vdb_nns
