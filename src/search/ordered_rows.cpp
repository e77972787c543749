#include "search/ordered_rows.h"

#include "cpu/leaves_in_reach-inl.h"
#include "lists/row_checksum.h"
#include "search/row_window.h"
#include "search/sample_rows.h"
#include "util/wall_clock.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>

namespace vdb_nns {

namespace {

// Queries that are searched at once: enough to make the lock around the order of tasks cheap.
constexpr std::uint32_t kBatchQueries = 1024;
// A run ends with these pairs, 1 MiB of numbers, which a second-level cache holds; or with so many rows.
constexpr std::uint64_t kRunPairs = std::uint64_t(1) << 18;
constexpr std::size_t kRunRows = std::size_t(1) << 17;
// Beyond what the window needs by itself: what threads may make while one is late.
constexpr std::uint64_t kAheadBytes = std::uint64_t(24) << 20;

// Of each thread's batch.
constexpr std::uint64_t kThreadBytes = std::uint64_t(2) << 20;
// Requests for memory that are taken at once: less than one of them is unused when the next one does not fit.
constexpr std::size_t kRequestsPerTake = 4;
// Queries whose neighbors are counted to expect those of all.
constexpr std::size_t kSampledQueries = 256;

} // namespace

// Tasks in the order of their lowest numbers.
struct OrderedSearch::TaskOrder {
    struct Batch {
        std::uint32_t lowest; // number in it and all later ones
        std::size_t firstPiece, endPiece;
        std::uint32_t queries;
    };

    struct PieceOfRun {
        std::uint32_t run;
        Piece piece;
    };
    std::vector<PieceOfRun> pieces;
    std::vector<Batch> batches;
    std::uint64_t windowRows = 0;

    explicit TaskOrder(const SearchRuns& runs);
};

namespace {

// How many queries have numbers below another.
class NumberRanks {
public:
    explicit NumberRanks(const SearchRuns& runs) : mAreAll(runs.rowCount() == runs.sets().rowCount())
    {
        if (mAreAll) return;
        mWords.resize(runs.sets().rowCount() / 64 + 1);
        runs.forEach([&](const SearchRun& run) {
            for (const std::uint32_t number : run.queries.number)
                mWords[number / 64] |= std::uint64_t(1) << number % 64;
        });
        mBefore.reserve(mWords.size());
        std::uint64_t sum = 0;
        for (const std::uint64_t word : mWords) {
            mBefore.push_back(static_cast<std::uint32_t>(sum));
            sum += static_cast<std::uint64_t>(__builtin_popcountll(word));
        }
    }

    std::uint64_t of(std::uint32_t number) const
    {
        if (mAreAll) return number;
        const std::uint64_t below = mWords[number / 64] & ((std::uint64_t(1) << number % 64) - 1);
        return mBefore[number / 64] + static_cast<std::uint64_t>(__builtin_popcountll(below));
    }

private:
    bool mAreAll;
    std::vector<std::uint64_t> mWords; // a bit for each number that is there
    std::vector<std::uint32_t> mBefore;
};

} // namespace

OrderedSearch::TaskOrder::TaskOrder(const SearchRuns& runs)
{
    const NumberRanks ranks(runs);
    std::vector<PieceOfRun> unordered;
    for (std::uint32_t r = 0; r < runs.size(); ++r) {
        for (const Piece& piece : runs[r].pieces) unordered.push_back({r, piece});
    }
    struct Numbered {
        std::uint32_t lowest, piece;
    };
    std::vector<Numbered> order(unordered.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, unordered.size(), 16), [&](const auto& range) {
        for (std::size_t p = range.begin(); p < range.end(); ++p) {
            const std::uint32_t* const numbers = runs[unordered[p].run].queries.number.data();
            const Piece& piece = unordered[p].piece;
            order[p] = {*std::min_element(numbers + piece.firstSlot, numbers + piece.endSlot),
                        static_cast<std::uint32_t>(p)};
        }
    });
    tbb::parallel_sort(order.begin(), order.end(),
                       [](const Numbered& a, const Numbered& b) { return a.lowest < b.lowest; });
    pieces.reserve(unordered.size());
    std::uint64_t queries = 0;
    for (const Numbered& next : order) {
        windowRows = std::max(windowRows, queries - std::min(queries, ranks.of(next.lowest)));
        const PieceOfRun& piece = unordered[next.piece];
        if (batches.empty() || batches.back().queries >= kBatchQueries)
            batches.push_back({next.lowest, pieces.size(), pieces.size(), 0});
        pieces.push_back(piece);
        const std::uint32_t count = piece.piece.endSlot - piece.piece.firstSlot;
        batches.back().endPiece = pieces.size();
        batches.back().queries += count;
        queries += count;
    }
}

namespace {

// Where one thread makes rows.
class RowMaker {
public:
    explicit RowMaker(RowWindow& window) : mWindow(window), mSink{}
    {
        mSink.owner = this;
        mSink.grow = grow;
    }
    RowMaker(const RowMaker&) = delete;
    RowMaker& operator=(const RowMaker&) = delete;

    // `places`, `counts`: by slot.
    void make(const SearchRun& run, const SearchTask& task, ThreadState& state, std::uint32_t* places,
              std::uint32_t* counts)
    {
        mPlaces = places;
        mRowBegin.resize(task.endSlot - task.firstSlot);
        mSink.slotBase = mSink.nextSlot = mNoted = task.firstSlot;
        mSink.rowBegin = mRowBegin.data();
        mSink.rowCount = counts + task.firstSlot;
        run.makeRows(RowKind::kVisit, task, state, mSink);
        noteRows();
    }

    std::uint64_t checksum = 0;

private:
    // The places of rows that were made since the last call.
    void noteRows()
    {
        std::uint32_t rows = 0;
        for (; mNoted < mSink.nextSlot; ++mNoted) {
            const std::uint32_t row = mNoted - mSink.slotBase;
            if (mSink.rowCount[row] == 0) continue;
            mPlaces[mNoted] = mWindow.placeOf(mChunk, mRowBegin[row]);
            ++rows;
        }
        if (rows > 0) mWindow.addRows(mChunk, rows);
    }

    static void grow(RowSink& sink, std::size_t entries)
    {
        auto& self = *static_cast<RowMaker*>(sink.owner);
        self.noteRows();
        if (sink.out) {
            self.mWindow.shrink(self.mChunk, sink.out);
            self.mWindow.release(self.mChunk);
        }
        sink.out = sink.end = nullptr;
        // `entries` is what a few rows may have at most; they mostly have less, and many follow.
        try {
            self.mChunk = self.mWindow.take(kRequestsPerTake * entries);
        } catch (const RowWindow::Exceeded&) {
            self.mChunk = self.mWindow.take(entries);
        }
        sink.out = self.mWindow.begin(self.mChunk);
        sink.end = self.mWindow.end(self.mChunk);
    }

    RowWindow& mWindow;
    RowSink mSink;
    std::uint32_t mChunk = 0; // where `out` is
    std::uint32_t mNoted = 0; // slots before it have their places
    std::vector<std::uint32_t*> mRowBegin;
    std::uint32_t* mPlaces = nullptr;
};

} // namespace

class OrderedSearch::Rows {
public:
    Rows(OrderedSearch& search, std::uint64_t windowBytes, NeighborListsData& result,
         RowRunConsumer& consumer)
        : mEngine(search.mEngine),
          mRuns(search.mRuns),
          mCancel(search.mOptions.progress, "search"),
          mOrder(*search.mOrder),
          mResult(result),
          mConsumer(consumer),
          mWantsChecksum(search.mWantsChecksum),
          mAll(static_cast<std::uint32_t>(result.sets.rowCount())),
          mWindow(windowBytes, idleMemory(search.mEngine.scratch)),
          mMakers([this] { return std::make_unique<RowMaker>(mWindow); }),
          mDone(mOrder.batches.size(), 0),
          mMostBytes(search.mostBytesBegun(windowBytes))
    {
        const std::size_t particles = mRuns.rowCount();
        mPlaces = mEngine.scratch.leafOf.data(); // idle too
        if (mEngine.scratch.leafOf.size() < particles) {
            mOwnPlaces.resizeDiscarding(particles);
            mPlaces = mOwnPlaces.data();
        }
        result.rowCount.resizeDiscarding(particles);
        result.slotOf.resizeDiscarding(mAll);
        if (particles < mAll) std::fill(result.slotOf.begin(), result.slotOf.end(), kNoSlot);
    }

    // Returns the checksum.
    std::uint64_t run()
    {
        tbb::parallel_for(
            0, tbb::this_task_arena::max_concurrency(), [this](int) { work(); }, tbb::simple_partitioner());
        std::uint64_t checksum = 0;
        for (const std::unique_ptr<RowMaker>& maker : mMakers) checksum += maker->checksum;
        return checksum;
    }

private:
    // The sort of the grid is done, and its memory was touched.
    static Span<std::uint32_t> idleMemory(const GridScratch& scratch)
    {
        return {reinterpret_cast<std::uint32_t*>(scratch.records.data()),
                scratch.records.usedBytes() / sizeof(std::uint32_t)};
    }

    // A run, and where its rows are found.
    struct Claim {
        std::size_t index;
        std::uint32_t firstRow, endRow;
        std::uint64_t firstPair, pairs;
    };

    // Makes batches and takes runs until there are no more. Whoever calls it alone does all of it.
    void work()
    {
        try {
            RowMaker& maker = *mMakers.local();
            std::unique_lock<std::mutex> lock(mMutex);
            for (Claim claim; !mFailed;) {
                if (claimRun(claim)) {
                    lock.unlock();
                    takeRun(claim, maker);
                    lock.lock();
                    mChanged.notify_all(); // there is room
                } else if (mayBegin()) {
                    const std::size_t batch = mBegun++;
                    ++mUnderWay;
                    lock.unlock();
                    makeBatch(mOrder.batches[batch], maker);
                    lock.lock();
                    --mUnderWay;
                    mDone[batch] = 1;
                    while (mFirstUndone < mDone.size() && mDone[mFirstUndone]) ++mFirstUndone;
                    mChanged.notify_all();
                } else if (mUnderWay == 0) {
                    return;
                } else {
                    mChanged.wait_for(lock, std::chrono::milliseconds(10));
                    lock.unlock(); // check() calls the caller's Progress
                    mCancel.check();
                    lock.lock();
                }
            }
        } catch (...) {
            {
                const std::lock_guard<std::mutex> lock(mMutex);
                mFailed = true;
            }
            mChanged.notify_all();
            throw;
        }
    }

    // Somebody always goes on: a window that is full waits for those batches alone that are under way.
    bool mayBegin() const
    {
        if (mBegun == mOrder.batches.size()) return false;
        return mUnderWay == 0 || mWindow.heldBytes() <= mMostBytes;
    }

    // Numbers below it have all their rows.
    std::uint32_t frontier() const
    {
        return mFirstUndone < mDone.size() ? mOrder.batches[mFirstUndone].lowest : mAll;
    }

    // The next run, if all of it is there.
    bool claimRun(Claim& claim)
    {
        const std::uint32_t end = frontier();
        bool isWhole = false;
        while (mScanned < end && !isWhole) {
            const std::uint32_t slot = mResult.slotOf[mScanned++];
            if (slot != kNoSlot) mScannedPairs += mResult.rowCount[slot];
            isWhole = mScannedPairs >= kRunPairs || mScanned - mClaimed == kRunRows;
        }
        if (!isWhole && (mScanned < mAll || mClaimed == mAll)) return false;
        claim = {mRunsClaimed++, mClaimed, mScanned, mClaimedPairs, mScannedPairs};
        mClaimed = mScanned;
        mClaimedPairs += mScannedPairs;
        mScannedPairs = 0;
        return true;
    }

    void makeBatch(const TaskOrder::Batch& batch, RowMaker& maker)
    {
        const TaskOrder::PieceOfRun* const pieces = mOrder.pieces.data();
        for (std::size_t first = batch.firstPiece, end; first < batch.endPiece; first = end) {
            for (end = first + 1; end < batch.endPiece && pieces[end].run == pieces[first].run;) ++end;
            makePieces(mRuns[pieces[first].run], pieces + first, end - first, maker);
        }
    }

    // All of one run.
    void makePieces(const SearchRun& run, const TaskOrder::PieceOfRun* pieces, std::size_t count,
                    RowMaker& maker)
    {
        ThreadState& state = mEngine.states.local();
        const SparseGridData& grid = run.queries;
        std::vector<Vec3i> origins(count);
        std::vector<std::uint32_t> wanted(count);
        for (std::size_t k = 0; k < count; ++k) {
            origins[k] = grid.leafOrigins[pieces[k].piece.leaf];
            wanted[k] = leavesInReach(grid.leaves[pieces[k].piece.leaf].occupancy, grid.reach());
        }
        state.neighborhoods.resize(count);
        run.candidates.topology.neighborhoods({origins.data(), count}, wanted.data(),
                                              state.neighborhoods.data());
        for (std::size_t k = 0; k < count; ++k) {
            mCancel.check();
            const Piece& piece = pieces[k].piece;
            maker.make(run, {piece.leaf, piece.firstSlot, piece.endSlot, state.neighborhoods[k].leaf}, state,
                       mPlaces + run.firstRow, mResult.rowCount.data() + run.firstRow);
            for (std::uint32_t slot = piece.firstSlot; slot < piece.endSlot; ++slot)
                mResult.slotOf[grid.number[slot]] = run.firstRow + slot;
        }
    }

    void takeRun(const Claim& claim, RowMaker& maker)
    {
        const std::size_t rowCount = claim.endRow - claim.firstRow;
        std::vector<std::uint32_t> counts(rowCount);
        std::vector<const std::uint32_t*> rows(rowCount);
        struct Held {
            std::uint32_t chunk, rows;
        };
        std::vector<Held> held;
        for (std::size_t k = 0; k < rowCount; ++k) {
            const std::uint32_t slot = mResult.slotOf[claim.firstRow + k];
            counts[k] = slot == kNoSlot ? 0 : mResult.rowCount[slot];
            if (counts[k] == 0) continue;
            const std::uint32_t place = mPlaces[slot], chunk = mWindow.firstOf(place);
            rows[k] = mWindow.rowAt(place);
            if (held.empty() || held.back().chunk != chunk) held.push_back({chunk, 0});
            ++held.back().rows;
        }
        if (mWantsChecksum) {
            for (std::size_t k = 0; k < rowCount; ++k)
                maker.checksum += rowChecksum(claim.firstRow + k, {rows[k], counts[k]});
        }
        mConsumer.take({claim.index, claim.firstRow, rowCount, claim.firstPair, claim.pairs, counts.data(),
                        rows.data()});
        for (const Held& h : held) mWindow.release(h.chunk, h.rows);
        mCancel.update(static_cast<double>(claim.endRow) / static_cast<double>(mAll));
    }

    EngineState& mEngine;
    const SearchRuns& mRuns;
    const CancelCheck mCancel;
    const TaskOrder& mOrder;
    NeighborListsData& mResult;
    RowRunConsumer& mConsumer;
    const bool mWantsChecksum;
    const std::uint32_t mAll; // rows
    RowWindow mWindow;
    std::uint32_t* mPlaces = nullptr; // by slot
    PageArray<std::uint32_t> mOwnPlaces;
    tbb::enumerable_thread_specific<std::unique_ptr<RowMaker>> mMakers;

    std::mutex mMutex;
    std::condition_variable mChanged;
    bool mFailed = false;
    std::size_t mBegun = 0, mUnderWay = 0, mFirstUndone = 0; // batches
    std::vector<char> mDone;
    const std::uint64_t mMostBytes; // of rows that are held as another batch begins
    std::size_t mRunsClaimed = 0;
    std::uint32_t mClaimed = 0, mScanned = 0; // rows before them
    std::uint64_t mClaimedPairs = 0,
                  mScannedPairs = 0; // of the claimed rows; of those that were scanned after them
};

OrderedSearch::OrderedSearch(EngineState& engine, const SearchSets& sets, const SearchOptions& options)
    : mEngine(engine), mOptions(options), mRuns(setsWithin(sets, options.radius), options)
{
    mOrder = std::make_unique<TaskOrder>(mRuns);
    mEngine.beginStatistics(mOptions);
    double entries = 0;
    mRuns.forEach([&](const SearchRun& run) {
        const RowSample sample = sampleRows(run, kSampledQueries, mEngine.states.local());
        entries += sample.entriesEach() * static_cast<double>(run.queries.particleCount());
    });
    mExpectedNeighbors = entries / static_cast<double>(std::max<std::uint64_t>(1, mRuns.rowCount()));
}

OrderedSearch::~OrderedSearch() = default;

std::uint64_t OrderedSearch::windowRows() const
{
    return mOrder->windowRows;
}

// What waits for others anyway, and some more; each thread may go on to the end of its batch after that.
std::uint64_t OrderedSearch::mostBytesBegun(std::uint64_t windowBytes) const
{
    const auto threads = static_cast<std::uint64_t>(tbb::this_task_arena::max_concurrency());
    const auto waiting = static_cast<std::uint64_t>(static_cast<double>(windowRows()) * mExpectedNeighbors *
                                                    sizeof(std::uint32_t));
    const std::uint64_t kept = threads * kThreadBytes;
    return std::min(waiting + waiting / 2 + kAheadBytes, windowBytes - std::min(windowBytes, kept));
}

std::uint64_t OrderedSearch::countPairs()
{
    mEngine.beginStatistics(mOptions);
    PageArray<std::uint32_t> counts; // by row
    counts.resizeDiscarding(mRuns.rowCount());
    mRuns.forEach([&](const SearchRun& run) {
        std::optional<ProgressShare> share;
        const CancelCheck cancel(mRuns.progressOf(run, mOptions.progress, share), "count");
        forEachTask(run.queries, run.candidates, run.pieces, mEngine.states, cancel,
                    [&](ThreadState& state, const SearchTask& task) {
                        state.sink.slotBase = 0;
                        state.sink.rowCount = counts.data() + run.firstRow;
                        run.makeRows(RowKind::kCount, task, state, state.sink);
                    });
    });
    if (mOptions.nearest == 0) return mEngine.sumStatistics().pairs;
    std::uint64_t pairs = 0; // of rows that are cut; a query in its own is not among the nearest
    mRuns.forEach([&](const SearchRun& run) {
        const auto queries = static_cast<std::uint32_t>(run.queries.particleCount());
        for (std::uint32_t slot = 0; slot < queries; ++slot)
            pairs += run.entriesKept(slot, counts[run.firstRow + slot]);
    });
    return pairs;
}

NeighborLists OrderedSearch::run(std::uint64_t windowBytes, RowRunConsumer& consumer)
{
    const double start = wallSeconds();
    const std::shared_ptr<NeighborListsData> result =
        mEngine.beginLists(mRuns.sets(), Encoding::kNone, mOptions);
    mEngine.beginStatistics(mOptions);
    try {
        mChecksum = Rows(*this, windowBytes, *result, consumer).run();
    } catch (const RowWindow::Exceeded&) {
        throw WindowExceeded();
    }
    ChunkPool none({});
    mEngine.finishLists(mRuns, none, *result);
    mEngine.lists = result;
    mEngine.statistics.searchSeconds = wallSeconds() - start;
    return NeighborLists(result);
}

} // namespace vdb_nns
