// See run_schedule.h. One thread decides, by the clocks of schedule/dispatcher.h, who takes which block; the work itself is
// jobs on the TBB arena, or on threads of their own where a device does it meanwhile. A device has as many blocks in flight as
// slots, and the next decision about it waits for its oldest: so with simulated devices alone decisions do not depend on how
// fast this machine is. What other devices, and the CPU beside them, turn out to do in a second replaces their rates.
#include "execute/run_schedule.h"

#include "cuda/launch.h"
#include "execute/block_flight.h"
#include "execute/collector.h"
#include "execute/job_queue.h"
#include "execute/simulated_device.h"
#include "schedule/dispatcher.h"
#include "vdb_nns/error.h"
#include "workload/block_halo.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstring>
#include <deque>
#include <iterator>
#include <numeric>
#include <optional>
#include <string>
#include <utility>

namespace vdb_nns {

namespace {

constexpr int kAnyLeaves = 3; // for haloOf(): any range of leaves, not a cube

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// What is left of a block of the schedule: all of it, or a part after a split.
struct RunBlock {
    std::size_t block; // of the schedule
    Dispatcher::Item item;
    BlockPart part;
    int log2Cells;
    bool withHalo;
    bool isStaged = false; // the part's halo is made, and its boundary region handed to TBB workers
    double expectedPairs;
    double undecidedPerQuery = 0; // pairs, where known from an overflow

    std::uint64_t queries() const { return part.endSlot - part.firstSlot; }
    // TBB workers have the queries outside of it now.
    void leaveOutside() { item.tests -= std::exchange(item.outsideTests, 0); }
};

// A block on a device.
struct Flight {
    RunBlock block;
    std::size_t slot;
    std::atomic<bool> ended{false};
    FlownBlock flown;
    Collector::Collected collected;
    double collectSeconds = 0;
    std::vector<std::uint32_t> counts; // of its queries, after an overflow
    std::string failure;

    std::uint64_t pairs() const
    {
        return flown.overflowed ? std::accumulate(counts.begin(), counts.end(), std::uint64_t(0))
                                : collected.pairs;
    }
};

// Neighbors of queries, by slot of the grid, where they are known.
struct Counts {
    const std::uint32_t* count = nullptr;
    std::uint32_t firstSlot = 0;

    std::uint64_t sum(std::uint32_t begin, std::uint32_t end) const
    {
        return std::accumulate(count + (begin - firstSlot), count + (end - firstSlot), std::uint64_t(0));
    }
};

struct Executor {
    std::unique_ptr<BlockDevice> device;
    std::vector<DeviceSlot> slots;
    std::vector<std::size_t> threads; // of the slots, where they have some
    std::uint64_t slotBytes = 0;
    std::size_t begun = 0;
    StepTimes times; // of blocks that have come back
    std::uint64_t tests = 0, bytesUp = 0, bytesDown = 0;
    std::deque<std::unique_ptr<Flight>> flights; // oldest first
};

// Most bytes that a block of the schedule may have on a device.
std::uint64_t budgetOf(const Schedule& schedule, const DeviceLimits& device)
{
    return schedule.inCore ? device.memoryBytes : blockBudget(device);
}

// Slots that a device can use, each as large as the largest block of the schedule that may go there.
struct SlotNeed {
    std::size_t slots = 0;
    std::uint64_t bytes = 0;
};

SlotNeed slotNeedOf(const Schedule& schedule, const DeviceLimits& device)
{
    SlotNeed need;
    for (const Block& block : schedule.blocks) {
        if (block.bytes.total() > budgetOf(schedule, device)) continue;
        need.bytes = std::max(need.bytes, block.bytes.total());
        need.slots = std::min(need.slots + 1, static_cast<std::size_t>(device.slots));
    }
    return need;
}

class ScheduleRunner {
public:
    ScheduleRunner(EngineState& engine, const SearchRun& run, const Schedule& schedule,
                   const RunOptions& options, NeighborListsData& lists, ChunkPool& pool, ScheduleRun& report)
        : mEngine(engine),
          mRun(run),
          mSchedule(schedule),
          mOptions(options),
          mEncoding(schedule.model.encoding),
          mLists(lists),
          mPool(pool),
          mReport(report),
          mCollector(run.grid, run.exact, mEncoding, lists, pool),
          mPairs(schedule.blocks.size())
    {
    }

    void execute(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice);

private:
    void makeItems();
    void openDevices(const DeviceMaker& makeDevice);
    void allocateSlots(std::size_t device);
    void handOut();

    void startOnCpu(const RunBlock& block);
    void startOnDevice(int device, RunBlock block);
    void settleOldest(int device);
    void learn(const Flight& flight);
    void measure(int device, const Flight& flight);
    void split(const RunBlock& whole, const Counts& counts);
    RunBlock partOf(const RunBlock& whole, std::uint32_t firstLeaf, std::uint32_t endLeaf,
                    std::uint32_t firstSlot, std::uint32_t endSlot, const Counts& counts) const;
    void again(RunBlock block);
    void giveUp(const RunBlock& block);
    std::uint64_t wantedQueries(const BlockPart& part) const;

    // Jobs.
    template <typename Job>
    void timeJob(double testsPerQuery, Job&& job);
    static double testsPerQuery(const RunBlock& block);
    // All return how many queries they ran.
    std::uint64_t runPieces(std::size_t block, std::size_t first, std::size_t end, const BlockPart& part);
    std::uint64_t runBoundaryLeaf(std::size_t block, const CellSet& cells, std::uint32_t firstSlot,
                                  std::uint32_t endSlot);
    std::uint64_t runTask(std::size_t block, const SearchTask& task);
    void stage(RunBlock& block);
    void requireRoom(const RunBlock& block, std::uint64_t slotBytes) const;
    void runFlight(Executor& executor, Flight& flight);
    void showProgress() const;

    EngineState& mEngine;
    const SearchRun& mRun;
    const Schedule& mSchedule;
    const RunOptions& mOptions;
    const Encoding mEncoding;
    NeighborListsData& mLists;
    ChunkPool& mPool;
    ScheduleRun& mReport;
    Collector mCollector;
    std::vector<DeviceLimits> mLimits;   // with the slots that there are
    std::vector<std::uint64_t> mBudgets; // most bytes of a block, by device
    std::vector<Executor> mExecutors;
    std::vector<RunBlock> mBlocks; // by Item::block; parts of split blocks are added
    std::optional<Dispatcher> mDispatcher;
    std::vector<std::atomic<std::uint64_t>> mPairs; // by block of the schedule
    std::atomic<std::uint64_t> mCpuParticles{0};
    std::atomic<std::uint64_t> mDeviceParticles{0}; // collected
    // Of blocks that a device is done with.
    double mActualPairs = 0, mExpectedPairs = 0, mUndecidedBytes = 0, mUndecidedRoom = 0, mBytesDown = 0;
    std::atomic<std::uint64_t> mCpuTests{0}, mCpuNanoseconds{0}; // of all workers together
    const double mStart = now();
    JobQueue mJobs; // last: its jobs use all of the above, and its destructor waits for them
};

void ScheduleRunner::execute(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice)
{
    mLimits = devices;
    for (const DeviceLimits& limits : devices) {
        mBudgets.push_back(budgetOf(mSchedule, limits));
    }
    mReport = {};
    mReport.devices.resize(devices.size());
    makeItems();
    openDevices(makeDevice);
    handOut();
    mJobs.runAll();
    for (std::size_t d = 0; d < mExecutors.size(); ++d) {
        const Executor& executor = mExecutors[d];
        DeviceRun& report = mReport.devices[d];
        report.busySeconds = mDispatcher->deviceSeconds(static_cast<int>(d));
        if (!executor.device) continue;
        report.peakBytes = executor.device->peakBytes();
        if (executor.device->isSimulated()) continue;
        report.busySeconds = executor.times.searchSeconds;
        report.uploadSeconds = executor.times.uploadSeconds;
        report.downloadSeconds = executor.times.downloadSeconds;
        report.bytesUp = executor.bytesUp;
        report.bytesDown = executor.bytesDown;
    }
    mReport.cpuParticles = mCpuParticles;
    const bool isVirtual = std::all_of(mExecutors.begin(), mExecutors.end(), [](const Executor& executor) {
        return !executor.device || executor.device->isSimulated();
    });
    mReport.seconds = isVirtual ? mDispatcher->doneSeconds() : now() - mStart;
    mReport.cpuBusySeconds =
        isVirtual ? mDispatcher->cpuSeconds()
                  : 1e-9 * static_cast<double>(mCpuNanoseconds) / tbb::this_task_arena::max_concurrency();
    mReport.blockPairs.assign(mPairs.begin(), mPairs.end());
}

void ScheduleRunner::makeItems()
{
    const SparseGridData& grid = mRun.grid;
    std::uint64_t next = 0; // slot that the next block begins with
    for (std::size_t b = 0; b < mSchedule.blocks.size(); ++b) {
        const Block& planned = mSchedule.blocks[b];
        RunBlock block{};
        block.block = b;
        block.part.firstLeaf = planned.firstLeaf;
        block.part.endLeaf = planned.endLeaf;
        block.part.firstSlot = static_cast<std::uint32_t>(planned.firstSlot);
        block.part.endSlot = static_cast<std::uint32_t>(planned.endSlot);
        block.log2Cells = planned.log2Cells;
        block.withHalo = planned.withHalo;
        block.expectedPairs = planned.work.expectedPairs;
        block.item = {b, planned.work.candidateTests, boundaryTests(planned), planned.bytes,
                      mEncoding != Encoding::kIndex};
        if (planned.firstSlot != next || planned.endSlot <= planned.firstSlot ||
            planned.endLeaf > grid.leafCount() || planned.firstLeaf >= planned.endLeaf ||
            planned.firstSlot < grid.leaves[planned.firstLeaf].firstSlot ||
            planned.endSlot > grid.leaves[planned.endLeaf].firstSlot) {
            throw InvalidInput("block " + std::to_string(b) + " of the schedule is not of this grid");
        }
        next = planned.endSlot;
        mBlocks.push_back(std::move(block));
    }
    if (next != grid.particleCount()) {
        throw InvalidInput("a schedule of " + std::to_string(next) + " queries is not of a grid with " +
                           std::to_string(grid.particleCount()) + " particles");
    }
    if (mSchedule.devices.size() != mLimits.size()) {
        throw InvalidInput("a schedule for " + std::to_string(mSchedule.devices.size()) +
                           " devices cannot be run on " + std::to_string(mLimits.size()));
    }
}

void ScheduleRunner::openDevices(const DeviceMaker& makeDevice)
{
    std::vector<std::uint64_t> budgets;
    mExecutors.resize(mLimits.size());
    for (std::size_t d = 0; d < mLimits.size(); ++d) {
        mExecutors[d].device = makeDevice(mLimits[d], mRun, mEngine.states);
        allocateSlots(d);
        if (!mExecutors[d].device->isSimulated()) {
            for (std::size_t s = 0; s < mExecutors[d].slots.size(); ++s)
                mExecutors[d].threads.push_back(mJobs.addThread());
        }
        mLimits[d].slots = std::max(1, static_cast<int>(mExecutors[d].slots.size()));
        budgets.push_back(mExecutors[d].slotBytes);
    }
    ScheduleOptions options = mOptions.schedule;
    options.useCpu = options.useCpu && !mSchedule.inCore;
    mDispatcher.emplace(mLimits, budgets, options);
    for (std::size_t d = 0; d < mExecutors.size(); ++d) {
        if (mExecutors[d].slots.empty()) mDispatcher->retire(static_cast<int>(d));
    }
}

// As large as the largest block of the schedule that may go there; half of it, and half of that, where the device refuses.
void ScheduleRunner::allocateSlots(std::size_t device)
{
    constexpr std::uint64_t kLeastBytes = 1024;
    const DeviceLimits& limits = mLimits[device];
    Executor& executor = mExecutors[device];
    const SlotNeed need = slotNeedOf(mSchedule, limits);
    if (need.slots == 0) return;
    std::uint64_t bytes = need.bytes;
    do {
        try {
            for (std::size_t s = 0; s < need.slots; ++s) {
                executor.slots.push_back(
                    {static_cast<int>(s), executor.device->allocate(bytes), nullptr, bytes});
            }
            for (DeviceSlot& slot : executor.slots) slot.staging = executor.device->allocateStaging(bytes);
            executor.slotBytes = bytes;
            return;
        } catch (const OutOfDeviceMemory&) {
            ++mReport.halvings;
        } catch (const DeviceError& error) {
            if (mOptions.onFailure == DeviceFailure::kStop) throw;
            mReport.devices[device].failure = error.what();
        }
        executor.device->releaseAll();
        executor.slots.clear();
        if (!mReport.devices[device].failure.empty()) return;
        bytes = bytes / 2 / 16 * 16;
    } while (bytes >= kLeastBytes);
    mReport.devices[device].failure = "it refused memory for even a small block";
}

void ScheduleRunner::handOut()
{
    std::vector<Dispatcher::Item> items;
    for (const RunBlock& block : mBlocks) {
        const bool fits = std::any_of(mBudgets.begin(), mBudgets.end(), [&](std::uint64_t budget) {
            return block.item.bytes.total() <= budget;
        });
        if (!fits && !mBudgets.empty()) {
            giveUp(block);
        } else {
            items.push_back(block.item);
        }
    }
    mDispatcher->setItems(std::move(items));
    for (;;) {
        mRun.cancel.check();
        for (std::size_t d = 0; d < mExecutors.size(); ++d) {
            while (!mExecutors[d].flights.empty() && mDispatcher->full(static_cast<int>(d)))
                settleOldest(static_cast<int>(d));
        }
        if (const std::optional<Dispatcher::Turn> turn = mDispatcher->next()) {
            const RunBlock block = mBlocks[turn->block];
            if (turn->executor == Block::kOnCpu) {
                startOnCpu(block);
            } else if (turn->executor == Dispatcher::kTooLarge) {
                RunBlock whole = block;
                if (!whole.isStaged) {
                    stage(whole);
                    mDispatcher->addCpuTests(whole.item.outsideTests);
                    whole.leaveOutside();
                }
                split(whole, {});
            } else {
                startOnDevice(turn->executor, block);
            }
            continue;
        }
        const auto flying = std::find_if(mExecutors.begin(), mExecutors.end(),
                                         [](const Executor& e) { return !e.flights.empty(); });
        if (flying == mExecutors.end()) return;
        settleOldest(static_cast<int>(flying - mExecutors.begin()));
    }
}

// ---- TBB workers ---------------------------------------------------------------------------------------------------

void ScheduleRunner::startOnCpu(const RunBlock& block)
{
    ++mReport.cpuBlocks;
    const std::vector<Piece>& pieces = mRun.pieces;
    const auto first = std::partition_point(pieces.begin(), pieces.end(), [&](const Piece& piece) {
        return piece.endSlot <= block.part.firstSlot;
    });
    const auto end = std::partition_point(
        first, pieces.end(), [&](const Piece& piece) { return piece.firstSlot < block.part.endSlot; });
    constexpr std::size_t kPiecesOfJob = 32;
    const auto part = std::make_shared<const BlockPart>(block.part);
    for (auto p = first; p < end; p += std::min<std::ptrdiff_t>(kPiecesOfJob, end - p)) {
        const auto begin = static_cast<std::size_t>(p - pieces.begin());
        const std::size_t stop =
            std::min(begin + kPiecesOfJob, static_cast<std::size_t>(end - pieces.begin()));
        mJobs.add([this, number = block.block, begin, stop, part, each = testsPerQuery(block)] {
            timeJob(each, [&] { return runPieces(number, begin, stop, *part); });
        });
    }
}

double ScheduleRunner::testsPerQuery(const RunBlock& block)
{
    return static_cast<double>(block.item.tests) / static_cast<double>(block.queries());
}

template <typename Job>
void ScheduleRunner::timeJob(double testsPerQuery, Job&& job)
{
    const double start = now();
    const std::uint64_t queries = job();
    mCpuNanoseconds += static_cast<std::uint64_t>(1e9 * (now() - start));
    mCpuTests += static_cast<std::uint64_t>(testsPerQuery * static_cast<double>(queries));
}

// Runs the queries of a part that are in some pieces.
std::uint64_t ScheduleRunner::runPieces(std::size_t block, std::size_t first, std::size_t end,
                                        const BlockPart& part)
{
    const SparseGridData& grid = mRun.grid;
    std::uint64_t queries = 0;
    for (std::size_t p = first; p < end; ++p) {
        mRun.cancel.check();
        const Piece& piece = mRun.pieces[p];
        LeafNeighborhood neighborhood;
        grid.neighborhoodsInReach(piece.leaf, piece.leaf + 1, &neighborhood);
        SearchTask task{piece.leaf, std::max(piece.firstSlot, part.firstSlot),
                        std::min(piece.endSlot, part.endSlot), neighborhood.leaf};
        const auto without =
            std::lower_bound(part.without.begin(), part.without.end(), piece.leaf,
                             [](const CellSet& set, std::uint32_t leaf) { return set.leaf < leaf; });
        std::uint64_t cells[8];
        if (without != part.without.end() && without->leaf == piece.leaf) {
            for (int x = 0; x < 8; ++x) cells[x] = grid.leaves[piece.leaf].occupancy[x] & ~without->cells[x];
            task.cells = cells;
        }
        queries += runTask(block, task);
    }
    showProgress();
    return queries;
}

std::uint64_t ScheduleRunner::runBoundaryLeaf(std::size_t block, const CellSet& set, std::uint32_t firstSlot,
                                              std::uint32_t endSlot)
{
    const SparseGridData& grid = mRun.grid;
    mRun.cancel.check();
    LeafNeighborhood neighborhood;
    grid.topology.neighborhoods({&grid.leafOrigins[set.leaf], 1}, &neighborhood);
    return runTask(block,
                   {set.leaf, std::max(firstSlot, grid.leaves[set.leaf].firstSlot),
                    std::min(endSlot, grid.leaves[set.leaf + 1].firstSlot), neighborhood.leaf, set.cells});
}

std::uint64_t ScheduleRunner::runTask(std::size_t block, const SearchTask& task)
{
    ThreadState& state = mEngine.states.local();
    const std::uint64_t before = state.statistics.pairs;
    std::uint64_t queries = task.endSlot - task.firstSlot;
    if (task.cells) {
        queries = 0;
        forEachWantedCell(mRun.context.block, task, [&](const SearchTask& cell) {
            queries += cell.endSlot - cell.firstSlot;
            if (mEncoding == Encoding::kMask) mEngine.makeRows(mRun, cell, state, mPool, mLists);
        });
    }
    if (!task.cells || mEncoding != Encoding::kMask) mEngine.makeRows(mRun, task, state, mPool, mLists);
    mPairs[block] += state.statistics.pairs - before;
    mCpuParticles += queries;
    return queries;
}

// ---- devices -------------------------------------------------------------------------------------------------------

void ScheduleRunner::startOnDevice(int device, RunBlock block)
{
    Executor& executor = mExecutors[static_cast<std::size_t>(device)];
    auto flight = std::make_unique<Flight>();
    flight->block = std::move(block);
    flight->slot = executor.begun++ % executor.slots.size();
    Flight& own = *flight;
    executor.flights.push_back(std::move(flight));
    const auto job = [this, &executor, &own] { runFlight(executor, own); };
    if (executor.threads.empty()) {
        mJobs.add(job);
    } else {
        mJobs.addTo(executor.threads[own.slot], job);
    }
}

// Makes the halo of a block, or hands its boundary region to TBB workers.
void ScheduleRunner::stage(RunBlock& block)
{
    if (block.isStaged) return;
    BlockHalo halo = haloOf(mRun.grid, block.part.firstLeaf, block.part.endLeaf, block.log2Cells);
    if (block.withHalo) {
        block.part.halo = std::move(halo.halo);
    } else {
        block.part.without = std::move(halo.boundary);
        for (const CellSet& set : block.part.without) {
            mJobs.add([this, number = block.block, set, first = block.part.firstSlot,
                       end = block.part.endSlot, each = testsPerQuery(block)] {
                timeJob(each, [&] { return runBoundaryLeaf(number, set, first, end); });
            });
        }
    }
    block.isStaged = true;
}

// A schedule of another grid may say less than its blocks take; nothing is written then.
void ScheduleRunner::requireRoom(const RunBlock& block, std::uint64_t slotBytes) const
{
    const std::uint64_t needed = leastBytes(mRun.grid, block.part, mEncoding);
    if (needed <= slotBytes) return;
    throw InvalidInput("block " + std::to_string(block.block) + " needs " + std::to_string(needed) +
                       " bytes and more, and the schedule has " + std::to_string(slotBytes) +
                       " for it: it is not of this grid");
}

void ScheduleRunner::runFlight(Executor& executor, Flight& flight)
{
    const DeviceSlot& slot = executor.slots[flight.slot];
    try {
        mRun.cancel.check();
        stage(flight.block);
        requireRoom(flight.block, executor.slotBytes);
        const BlockPart& part = flight.block.part;
        const bool isKnown =
            mEncoding == Encoding::kNone ||
            (mEncoding == Encoding::kMask && mSchedule.model.masksAreExact && part.without.empty());
        flight.flown = flyBlock(*executor.device, slot, mRun.grid, part,
                                {mRun.context.bounds, mEncoding, isKnown ? flight.block.item.bytes.down : 0});
        const FlownBlock& flown = flight.flown;
        if (flown.overflowed) {
            const auto* const counts =
                reinterpret_cast<const std::uint32_t*>(flown.result + flown.layout.counts);
            flight.counts.assign(counts, counts + flight.block.queries());
        } else {
            const double start = now();
            flight.collected = mCollector.collect(part, flown.layout, flown.result, mEngine.states.local());
            flight.collectSeconds = now() - start;
            mPairs[flight.block.block] += flight.collected.pairs;
        }
    } catch (const DeviceError& error) {
        flight.failure = error.what();
        if (flight.failure.empty()) flight.failure = "unknown";
    }
    flight.ended = true;
}

// ---- when a block has come back ------------------------------------------------------------------------------------

void ScheduleRunner::settleOldest(int device)
{
    Executor& executor = mExecutors[static_cast<std::size_t>(device)];
    DeviceRun& report = mReport.devices[static_cast<std::size_t>(device)];
    mJobs.runUntil([&] { return executor.flights.front()->ended.load(); });
    const std::unique_ptr<Flight> flight = std::move(executor.flights.front());
    executor.flights.pop_front();
    mDispatcher->finish(device, flight->flown.bytesDown);
    flight->block.leaveOutside();
    if (!flight->failure.empty()) {
        if (mOptions.onFailure == DeviceFailure::kStop) throw DeviceError(flight->failure);
        if (report.failure.empty()) report.failure = flight->failure;
        mDispatcher->retire(device);
        ++mReport.retries;
        again(std::move(flight->block));
        return;
    }
    learn(*flight);
    if (!executor.device->isSimulated()) measure(device, *flight);
    if (flight->flown.overflowed) {
        ++mReport.overflows;
        flight->block.undecidedPerQuery =
            static_cast<double>(flight->flown.head.undecided) / static_cast<double>(flight->block.queries());
        split(flight->block, {flight->counts.data(), flight->block.part.firstSlot});
        return;
    }
    report.blocks += 1;
    report.particles += flight->collected.queries;
    mDeviceParticles += flight->collected.queries;
    mReport.collectSeconds += flight->collectSeconds;
    showProgress();
}

void ScheduleRunner::showProgress() const
{
    mRun.cancel.update(static_cast<double>(mDeviceParticles + mCpuParticles) /
                       static_cast<double>(mRun.grid.particleCount()));
}

// The ratio of actual to expected pairs of blocks that are done corrects what the others are taken to need.
void ScheduleRunner::learn(const Flight& flight)
{
    constexpr double kMost = 1e6, kMargin = 1.05;
    Dispatcher::Correction correction;
    mUndecidedBytes += static_cast<double>(flight.flown.head.undecided * sizeof(UndecidedPair));
    mUndecidedRoom += static_cast<double>(undecidedRoom(flight.block.queries()));
    mBytesDown += static_cast<double>(flight.block.item.bytes.down);
    correction.more = std::clamp((kMargin * mUndecidedBytes - mUndecidedRoom) / mBytesDown, 0.0, kMost);
    if (mEncoding == Encoding::kIndex && flight.block.expectedPairs > 0) {
        const std::uint64_t wanted = wantedQueries(flight.block.part);
        mActualPairs += static_cast<double>(flight.pairs());
        mExpectedPairs += flight.block.expectedPairs * static_cast<double>(wanted) /
                          static_cast<double>(flight.block.queries());
    }
    if (mExpectedPairs > 0) {
        const double ratio = mActualPairs / mExpectedPairs / (1 + mSchedule.model.margin);
        correction.ratio = std::clamp(ratio, 1.0, kMost);
    }
    mDispatcher->correct(correction);
}

// What the device, and the CPU beside it, have done so far replaces the rates that they were taken to have.
void ScheduleRunner::measure(int device, const Flight& flight)
{
    Executor& executor = mExecutors[static_cast<std::size_t>(device)];
    const FlownBlock& flown = flight.flown;
    StepTimes& times = executor.times;
    times.uploadSeconds += flown.times.uploadSeconds;
    times.searchSeconds += flown.times.searchSeconds;
    times.downloadSeconds += flown.times.downloadSeconds;
    executor.tests += flight.block.item.tests;
    executor.bytesUp += flown.bytesUp;
    executor.bytesDown += flown.bytesDown;
    const auto rate = [](std::uint64_t amount, double seconds, double before) {
        return amount > 0 && seconds > 0 ? static_cast<double>(amount) / seconds : before;
    };
    const Rates before = mLimits[static_cast<std::size_t>(device)].rates;
    const double elapsed = now() - mStart;
    mDispatcher->observe(device, elapsed,
                         {0, rate(executor.tests, times.searchSeconds, before.testsPerSecond),
                          rate(executor.bytesUp, times.uploadSeconds, before.uploadBytesPerSecond),
                          rate(executor.bytesDown, times.downloadSeconds, before.downloadBytesPerSecond)});
    // A worker's rate, as long as too little is done to tell, is what it was taken to be.
    constexpr std::uint64_t kTellingTests = 1'000'000;
    const std::uint64_t tests = mCpuTests;
    if (tests < kTellingTests) return;
    const double workers = tbb::this_task_arena::max_concurrency();
    mDispatcher->observeCpu(
        elapsed, tests, workers * static_cast<double>(tests) / (1e-9 * static_cast<double>(mCpuNanoseconds)));
}

// Queries of a part, without those that others have.
std::uint64_t ScheduleRunner::wantedQueries(const BlockPart& part) const
{
    std::uint64_t queries = part.endSlot - part.firstSlot;
    for (const CellSet& set : part.without) {
        const SearchTask task{set.leaf, part.firstSlot, part.endSlot, nullptr, set.cells};
        forEachWantedCell(mRun.context.block, task,
                          [&](const SearchTask& cell) { queries -= cell.endSlot - cell.firstSlot; });
    }
    return queries;
}

void ScheduleRunner::again(RunBlock block)
{
    block.item.block = mBlocks.size();
    mBlocks.push_back(block);
    mDispatcher->addFirst(block.item);
}

// TBB workers run what fits no device.
void ScheduleRunner::giveUp(const RunBlock& block)
{
    mReport.tooLargeQueries += wantedQueries(block.part);
    mDispatcher->addCpuTests(block.item.tests);
    startOnCpu(block);
}

// Two halves of a block, and halves of those where what is known says that they do not fit either.
void ScheduleRunner::split(const RunBlock& whole, const Counts& counts)
{
    const SparseGridData& grid = mRun.grid;
    const BlockPart& part = whole.part;
    const bool isLeaf = part.endLeaf - part.firstLeaf == 1;
    if (whole.queries() <= Block::kFewestQueries) {
        const RunBlock known =
            partOf(whole, part.firstLeaf, part.endLeaf, part.firstSlot, part.endSlot, counts);
        if (counts.count) ++mReport.retries;
        if (known.item.isExact && mDispatcher->fits(known.item.bytes.total())) return again(known);
        return giveUp(known);
    }
    if (!counts.count) ++mReport.splits;
    std::uint32_t leaf = part.firstLeaf,
                  slot = part.firstSlot + static_cast<std::uint32_t>(whole.queries() / 2);
    if (!isLeaf) {
        // Between leaves, where the particles are halved; each half has one leaf at least.
        const auto end = std::partition_point(grid.leaves.begin() + part.firstLeaf + 1,
                                              grid.leaves.begin() + part.endLeaf - 1,
                                              [&](const LeafRecord& l) { return l.firstSlot < slot; });
        leaf = static_cast<std::uint32_t>(end - grid.leaves.begin());
        slot = grid.leaves[leaf].firstSlot;
    }
    const RunBlock first =
        partOf(whole, part.firstLeaf, isLeaf ? part.endLeaf : leaf, part.firstSlot, slot, counts);
    const RunBlock second = partOf(whole, leaf, part.endLeaf, slot, part.endSlot, counts);
    // A leaf's particles and halo stay with every part of it.
    if (isLeaf && !mDispatcher->fits(first.item.bytes.up)) {
        if (counts.count) ++mReport.retries;
        return giveUp(whole);
    }
    // The second first: what is added last is taken first.
    for (const RunBlock* half : {&second, &first}) {
        if (counts.count && !mDispatcher->fits(half->item.bytes.total()) && mDispatcher->fits(0)) {
            split(*half, counts);
        } else {
            if (counts.count) ++mReport.retries;
            again(*half);
        }
    }
}

RunBlock ScheduleRunner::partOf(const RunBlock& whole, std::uint32_t firstLeaf, std::uint32_t endLeaf,
                                std::uint32_t firstSlot, std::uint32_t endSlot, const Counts& counts) const
{
    using M = MemoryModel;
    const SparseGridData& grid = mRun.grid;
    RunBlock half = whole;
    half.part = {firstLeaf, endLeaf, firstSlot, endSlot, haloOf(grid, firstLeaf, endLeaf, kAnyLeaves).halo,
                 {}};
    for (const CellSet& set : whole.part.without) {
        if (set.leaf >= firstLeaf && set.leaf < endLeaf) half.part.without.push_back(set);
    }
    half.withHalo = half.isStaged = true;
    half.expectedPairs =
        whole.expectedPairs * static_cast<double>(half.queries()) / static_cast<double>(whole.queries());
    half.item.outsideTests = half.item.tests = 0;
    std::uint64_t words = 0;
    auto without = half.part.without.begin();
    std::vector<LeafNeighborhood> neighborhoods(endLeaf - firstLeaf);
    grid.neighborhoodsInReach(firstLeaf, endLeaf, neighborhoods.data());
    for (std::uint32_t l = firstLeaf; l < endLeaf; ++l) {
        SearchTask task{l, std::max(firstSlot, grid.leaves[l].firstSlot),
                        std::min(endSlot, grid.leaves[l + 1].firstSlot), neighborhoods[l - firstLeaf].leaf};
        std::uint64_t cells[8];
        while (without != half.part.without.end() && without->leaf < l) ++without;
        if (without != half.part.without.end() && without->leaf == l) {
            for (int x = 0; x < 8; ++x) cells[x] = grid.leaves[l].occupancy[x] & ~without->cells[x];
            task.cells = cells;
        }
        forEachCandidateCount(mRun.context.block, task, [&](std::uint64_t queries, std::uint64_t candidates) {
            half.item.tests += queries * candidates;
            words += queries * ((candidates + 31) / 32);
        });
    }
    BlockBytes& bytes = half.item.bytes;
    bytes.up = imageBytes(grid, half.part);
    constexpr double kUndecidedMargin = 1.25; // queries of a part may have more than those of the whole
    const auto undecided = static_cast<std::uint64_t>(kUndecidedMargin * half.undecidedPerQuery *
                                                      static_cast<double>(half.queries()));
    bytes.down = M::kResultBytes + half.queries() * M::kCountBytes + undecidedRoom(half.queries()) +
                 undecided * sizeof(UndecidedPair);
    bytes.scratch = scratchBytes(half.queries(), mEncoding);
    half.item.isExact = counts.count || mEncoding != Encoding::kIndex;
    // The smallest parts are tried whatever is feared of them.
    half.item.isTried = counts.count || half.queries() <= Block::kFewestQueries;
    if (mEncoding == Encoding::kMask) {
        bytes.down +=
            words * sizeof(std::uint32_t) + (endLeaf - firstLeaf) * M::kMaskLeafBytes + M::kMaskBlockBytes;
    } else if (mEncoding == Encoding::kIndex && counts.count) {
        bytes.down += counts.sum(firstSlot, endSlot) * M::kNeighborBytes;
    } else if (mEncoding == Encoding::kIndex) {
        const double pairs = half.expectedPairs * (1 + mSchedule.model.margin);
        bytes.down += static_cast<std::uint64_t>(pairs < 0x1p58 ? pairs : 0x1p58) * M::kNeighborBytes;
    }
    return half;
}

// Host memory of the devices' slots: what is staged, and what a simulated device is made of.
std::uint64_t hostBytesOf(const Schedule& schedule, const std::vector<DeviceLimits>& devices)
{
    std::uint64_t bytes = 0;
    for (const DeviceLimits& device : devices) {
        const SlotNeed need = slotNeedOf(schedule, device);
        bytes += need.slots * need.bytes * (device.kind == DeviceKind::kSim ? 2 : 1);
    }
    return bytes;
}

} // namespace

std::unique_ptr<BlockDevice> openDevice(const DeviceLimits& limits, const SearchRun& run,
                                        ThreadStates& states)
{
    switch (limits.kind) {
    case DeviceKind::kSim:
        return std::make_unique<SimulatedDevice>(limits.name, limits.memoryBytes, run, states);
    case DeviceKind::kCuda:
        return cuda::openBlockDevice(
            {limits.ordinal, limits.name, limits.memoryBytes, limits.slots, limits.mapped});
    case DeviceKind::kCpu:
        break;
    }
    throw InvalidInput("device '" + limits.name + "' is the CPU, which is no device: give none instead");
}

std::vector<DeviceLimits> cudaDevices()
{
    // A guess: 128 lanes at 1.5 GHz, ten operations a test, and a fifth of that.
    constexpr double kTestsOfMultiprocessor = 4e9;
    std::vector<DeviceLimits> devices;
    for (const cuda::Device& found : cuda::listDevices()) {
        DeviceLimits device;
        device.kind = DeviceKind::kCuda;
        device.name = found.name;
        device.memoryBytes = cuda::freeBytes(found.ordinal);
        device.ordinal = found.ordinal;
        device.rates.testsPerSecond = kTestsOfMultiprocessor * found.multiprocessors;
        devices.push_back(std::move(device));
    }
    return devices;
}

NeighborLists runSchedule(EngineState& engine, const SparseGrid& grid, const Schedule& schedule,
                          const std::vector<DeviceLimits>& devices, const RunOptions& options,
                          ScheduleRun& report, const DeviceMaker& makeDevice)
{
    const std::shared_ptr<NeighborListsData> result = engine.beginLists(grid, schedule.model.encoding);
    const SearchRun run(grid.data(), options.search);
    engine.beginStatistics(options.search);
    ChunkPool pool(std::move(result->chunks));
    const std::uint64_t allowed =
        engine.allowRows(run, options.search, hostBytesOf(schedule, devices), *result, pool);
    try {
        ScheduleRunner runner(engine, run, schedule, options, *result, pool, report);
        runner.execute(devices, makeDevice);
    } catch (const ChunkPool::Exhausted&) {
        throw listsDoNotFit(schedule.model.encoding, false, pool.takenBytes(), allowed);
    }
    engine.finishLists(run, pool, *result);
    engine.lists = result;
    return NeighborLists(result);
}

} // namespace vdb_nns
