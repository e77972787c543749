// One thread decides, by the clocks of plan/dispatcher.h, who takes which block; the work itself is
// jobs of device_executor.h and cpu_blocks.h. The next decision about a device waits for its oldest block: so with simulated
// devices alone decisions do not depend on how fast this machine is. What other devices, and the CPU beside them, turn out to
// do in a second replaces their rates.
//
// Threads: everything here, the dispatcher and the report included, is the decider's alone, which is the caller's thread.
// While it waits it works on jobs like a TBB worker.
#include "out_of_core/run_schedule.h"

#include "out_of_core/block_split.h"
#include "out_of_core/collector.h"
#include "out_of_core/cpu_blocks.h"
#include "out_of_core/device_executor.h"
#include "out_of_core/estimate_feedback.h"
#include "out_of_core/job_queue.h"
#include "out_of_core/run_progress.h"
#include "plan/dispatcher.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "util/wall_clock.h"
#include "vdb_nns/error.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

// Most bytes that a block of the schedule may have on a device: all of its memory where it is alone there.
std::uint64_t budgetOf(const Schedule& schedule, const DeviceLimits& device)
{
    return schedule.inCore && schedule.blocks.size() == 1 ? device.memoryBytes : blockBudget(device);
}

// Each buffer as large as the largest block of the schedule that may go to the device.
BufferNeed bufferNeedOf(const Schedule& schedule, const DeviceLimits& device)
{
    BufferNeed need;
    for (const Block& block : schedule.blocks) {
        if (block.bytes.total() > budgetOf(schedule, device)) continue;
        need.bytes = std::max(need.bytes, block.bytes.total());
        need.buffers = std::min(need.buffers + 1, static_cast<std::size_t>(device.buffers));
    }
    return need;
}

// Host memory of the devices' buffers: what is staged, and what a simulated device is made of.
std::uint64_t hostBytesOf(const Schedule& schedule, const std::vector<DeviceLimits>& devices)
{
    std::uint64_t bytes = 0;
    for (const DeviceLimits& device : devices) {
        const BufferNeed need = bufferNeedOf(schedule, device);
        bytes += need.buffers * need.bytes * (device.kind == DeviceKind::kSim ? 2 : 1);
    }
    return bytes;
}

// The device of the last run, if it is the same.
std::unique_ptr<BlockDevice> takeOpened(std::vector<OpenedDevice>& devices, const DeviceLimits& wanted)
{
    for (OpenedDevice& opened : devices) {
        const DeviceLimits& own = opened.limits;
        if (!opened.device || own.kind != wanted.kind || own.ordinal != wanted.ordinal ||
            own.memoryBytes != wanted.memoryBytes || own.buffers != wanted.buffers ||
            own.mapped != wanted.mapped)
            continue;
        return std::move(opened.device);
    }
    return nullptr;
}

class ScheduleRunner {
public:
    ScheduleRunner(EngineState& engine, const SearchRun& run, const Schedule& schedule,
                   const RunOptions& options, NeighborListsData& lists, ChunkPool& pool, ScheduleRun& report)
        : mEngine(engine),
          mRun(run),
          mSchedule(schedule),
          mOptions(options),
          mReport(report),
          mCollector(run.queries, run.exact, run.cancel, schedule.model.encoding, lists, pool),
          mProgress(run.cancel, run.queries.particleCount(), schedule.blocks.size()),
          mCpu(run, {engine, lists, pool, mProgress}, mJobs)
    {
    }

    void execute(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice);

private:
    void openDevices(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice);
    void openBuffers(DeviceExecutor& device, const BufferNeed& need, DeviceRun& report);
    void setItems(const std::vector<DeviceLimits>& devices);
    void handOut();
    void take(const Dispatcher::Turn& turn);
    void settleFull();
    bool settleAny();
    void settleOldest(std::size_t device);
    void settleFailed(std::size_t device, BlockInFlight& inFlight);
    void measure(std::size_t device, const BlockInFlight& inFlight);
    void startOnCpu(const PendingBlock& block);
    void split(const PendingBlock& whole, const KnownCounts& counts);
    void again(PendingBlock block);
    void giveUp(const PendingBlock& block);
    void writeReport();
    void keepDevices(const std::vector<DeviceLimits>& devices);

    EngineState& mEngine;
    const SearchRun& mRun;
    const Schedule& mSchedule;
    const RunOptions& mOptions;
    ScheduleRun& mReport;
    Collector mCollector;
    RunProgress mProgress;
    CpuBlocks mCpu;
    std::deque<DeviceExecutor> mDevices; // stay where they are
    std::vector<DeviceLimits> mLimits;   // with the buffers that there are
    std::vector<PendingBlock> mBlocks;   // by Item::block; parts of split blocks are added
    std::optional<Dispatcher> mDispatcher;
    EstimateFeedback mFeedback;
    const double mStart = wallSeconds();
    double mReady = mStart; // when devices were open: the dispatcher's clocks begin
    JobQueue mJobs;         // last: its jobs use all of the above, and its destructor waits for them
};

void ScheduleRunner::execute(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice)
{
    mReport = {};
    mReport.devices.resize(devices.size());
    mBlocks = pendingBlocksOf(mRun.queries, mSchedule);
    if (mSchedule.devices.size() != devices.size()) {
        throw InvalidInput("a schedule for " + std::to_string(mSchedule.devices.size()) +
                           " devices cannot be run on " + std::to_string(devices.size()));
    }
    openDevices(devices, makeDevice);
    mReady = wallSeconds();
    setItems(devices);
    handOut();
    mJobs.runAll();
    writeReport();
    keepDevices(devices);
}

// ---- before anything runs ------------------------------------------------------------------------------------------

void ScheduleRunner::openDevices(const std::vector<DeviceLimits>& devices, const DeviceMaker& makeDevice)
{
    std::vector<std::unique_ptr<BlockDevice>> opened;
    for (const DeviceLimits& limits : devices) opened.push_back(takeOpened(mEngine.devices, limits));
    mEngine.devices.clear(); // what this run has no use for, before anything new takes its memory
    std::vector<std::uint64_t> budgets;
    for (const DeviceLimits& limits : devices) {
        DeviceRun& report = mReport.devices[mLimits.size()];
        std::unique_ptr<BlockDevice>& known = opened[mLimits.size()];
        try {
            if (known) {
                known->restart();
            } else {
                known = makeDevice(limits, mRun, mEngine.states);
            }
        } catch (const DeviceError& error) {
            known.reset(); // the next run opens it anew
            if (mOptions.onFailure == DeviceFailure::kStop) throw;
            report.failure = error.what();
        }
        DeviceExecutor& device =
            mDevices.emplace_back(std::move(known), DeviceContext{mEngine, mRun, mSchedule.model, mCollector,
                                                                  mCpu, mProgress, mJobs});
        openBuffers(device, bufferNeedOf(mSchedule, limits), report);
        budgets.push_back(device.bufferBytes());
        mLimits.push_back(limits);
        mLimits.back().buffers = std::max(1, static_cast<int>(device.bufferCount()));
    }
    ScheduleOptions options = mOptions.schedule;
    options.useCpu = options.useCpu && !mSchedule.inCore;
    mDispatcher.emplace(mLimits, budgets, options);
    for (std::size_t d = 0; d < mDevices.size(); ++d) {
        if (mDevices[d].bufferCount() == 0) mDispatcher->retire(static_cast<int>(d));
    }
}

// A device that has too little memory is done without, whatever is to happen when one fails.
void ScheduleRunner::openBuffers(DeviceExecutor& device, const BufferNeed& need, DeviceRun& report)
{
    try {
        device.openBuffers(need);
    } catch (const OutOfDeviceMemory& error) {
        report.failure = error.what();
    } catch (const DeviceError& error) {
        if (mOptions.onFailure == DeviceFailure::kStop) throw;
        report.failure = error.what();
    }
    mReport.halvings += device.halvings();
}

void ScheduleRunner::setItems(const std::vector<DeviceLimits>& devices)
{
    std::vector<Dispatcher::Item> items;
    for (const PendingBlock& block : mBlocks) {
        const bool fits = std::any_of(devices.begin(), devices.end(), [&](const DeviceLimits& device) {
            return block.item.bytes.total() <= budgetOf(mSchedule, device);
        });
        if (fits || devices.empty()) {
            items.push_back(block.item);
        } else {
            giveUp(block);
        }
    }
    mDispatcher->setItems(std::move(items));
}

// ---- who takes which block -----------------------------------------------------------------------------------------

void ScheduleRunner::handOut()
{
    for (;;) {
        mRun.cancel.check();
        settleFull();
        if (const std::optional<Dispatcher::Turn> turn = mDispatcher->next()) {
            take(*turn);
        } else if (!settleAny()) {
            return;
        }
    }
}

void ScheduleRunner::take(const Dispatcher::Turn& turn)
{
    PendingBlock block = mBlocks[turn.block];
    if (turn.executor == Block::kOnCpu) {
        startOnCpu(block);
    } else if (turn.executor == Dispatcher::kTooLarge) {
        if (!block.isStaged) {
            mCpu.stage(block);
            mDispatcher->addCpuTests(block.item.outsideTests);
            block.leaveOutside();
        }
        split(block, {});
    } else {
        mDevices[static_cast<std::size_t>(turn.executor)].begin(std::move(block));
    }
}

void ScheduleRunner::startOnCpu(const PendingBlock& block)
{
    ++mReport.cpuBlocks;
    mCpu.start(block);
}

void ScheduleRunner::again(PendingBlock block)
{
    block.item.block = mBlocks.size();
    mDispatcher->addFirst(block.item);
    mBlocks.push_back(std::move(block));
}

// TBB workers run what fits no device.
void ScheduleRunner::giveUp(const PendingBlock& block)
{
    mReport.tooLargeQueries += wantedQueries(mRun.queries, block.part);
    mDispatcher->addCpuTests(block.item.tests);
    startOnCpu(block);
}

void ScheduleRunner::split(const PendingBlock& whole, const KnownCounts& counts)
{
    BlockSplit made = splitBlock(mRun.queries, mSchedule.model, whole, counts, mDispatcher->mostBytes());
    if (counts.count) {
        mReport.retries += made.parts.size() + made.tooLarge.size();
    } else if (whole.queries() > Block::kFewestQueries) {
        ++mReport.splits;
    }
    for (const PendingBlock& block : made.tooLarge) giveUp(block);
    for (PendingBlock& part : made.parts) again(std::move(part));
}

// ---- when a block has come back ------------------------------------------------------------------------------------

// Until a device is free to take a block. Simulated ones are settled in their order, however long each takes here; of others
// whichever is done first.
void ScheduleRunner::settleFull()
{
    const auto isFull = [&](std::size_t d) {
        return mDevices[d].hasInFlight() && mDispatcher->full(static_cast<int>(d));
    };
    const auto anyHasEnded = [&] {
        return std::any_of(mDevices.begin(), mDevices.end(),
                           [](const DeviceExecutor& device) { return device.oldestHasEnded(); });
    };
    for (std::size_t d = 0; d < mDevices.size(); ++d) {
        while (mDevices[d].isSimulated() && isFull(d)) settleOldest(d);
    }
    for (;;) {
        std::size_t inUse = 0, full = 0;
        for (std::size_t d = 0; d < mDevices.size(); ++d) {
            while (!mDevices[d].isSimulated() && mDevices[d].oldestHasEnded()) settleOldest(d);
            if (mDispatcher->isRetired(static_cast<int>(d))) continue;
            inUse += 1;
            full += isFull(d);
        }
        if (full == 0 || full < inUse) return;
        mJobs.runUntil(anyHasEnded);
    }
}

// False when no block is in flight.
bool ScheduleRunner::settleAny()
{
    for (std::size_t d = 0; d < mDevices.size(); ++d) {
        if (!mDevices[d].hasInFlight()) continue;
        settleOldest(d);
        return true;
    }
    return false;
}

void ScheduleRunner::settleOldest(std::size_t device)
{
    const std::unique_ptr<BlockInFlight> inFlight = mDevices[device].awaitOldest();
    mDispatcher->finish(static_cast<int>(device), inFlight->transferred.bytesDown);
    PendingBlock& block = inFlight->block;
    block.leaveOutside();
    if (!inFlight->failure.empty()) return settleFailed(device, *inFlight);
    mFeedback = mFeedback + feedbackOf(mRun.queries, mSchedule.model, block, inFlight->pairs(),
                                       inFlight->transferred.head);
    mDispatcher->correct(correctionOf(mFeedback, mSchedule.model));
    if (!mDevices[device].isSimulated()) measure(device, *inFlight);
    if (inFlight->transferred.overflowed) {
        ++mReport.overflows;
        // Without room for rows they may not have been listed at all.
        if (inFlight->transferred.head.undecided > 0) {
            block.undecidedPerQuery = static_cast<double>(inFlight->transferred.head.undecided) /
                                      static_cast<double>(block.queries());
        }
        split(block, {inFlight->counts.data(), block.part.firstSlot});
        return;
    }
    DeviceRun& report = mReport.devices[device];
    report.blocks += 1;
    report.particles += inFlight->collected.queries;
    mReport.collectSeconds += inFlight->collectSeconds;
    mProgress.addDeviceQueries(inFlight->collected.queries);
    mProgress.show();
}

void ScheduleRunner::settleFailed(std::size_t device, BlockInFlight& inFlight)
{
    const std::string why = mLimits[device].name + ", block " + std::to_string(inFlight.block.block) +
                            " of " + std::to_string(mSchedule.blocks.size()) + ": " + inFlight.failure;
    if (mOptions.onFailure == DeviceFailure::kStop) throw DeviceError(why);
    std::string& failure = mReport.devices[device].failure;
    if (failure.empty()) failure = why;
    mDispatcher->retire(static_cast<int>(device));
    ++mReport.retries;
    again(std::move(inFlight.block));
}

// What the device, and the CPU beside it, have done so far replaces the rates that they were taken to have.
void ScheduleRunner::measure(std::size_t device, const BlockInFlight& inFlight)
{
    // A worker's rate, as long as too little is done to tell, is what it was taken to be.
    constexpr std::uint64_t kTellingTests = 1'000'000;
    DeviceExecutor& executor = mDevices[device];
    executor.measure(inFlight);
    const double elapsed = wallSeconds() - mReady;
    mDispatcher->observe(static_cast<int>(device), elapsed, ratesOf(executor.work(), mLimits[device].rates));
    const CpuWork cpu = mCpu.work();
    if (cpu.tests < kTellingTests || !(cpu.seconds > 0)) return;
    const double workers = tbb::this_task_arena::max_concurrency();
    mDispatcher->observeCpu(elapsed, cpu.tests, workers * static_cast<double>(cpu.tests) / cpu.seconds);
}

// ---- when all is done ----------------------------------------------------------------------------------------------

void ScheduleRunner::writeReport()
{
    bool isVirtual = true;
    for (std::size_t d = 0; d < mDevices.size(); ++d) {
        DeviceRun& report = mReport.devices[d];
        report.peakBytes = mDevices[d].peakBytes();
        report.busySeconds = mDispatcher->deviceSeconds(static_cast<int>(d));
        isVirtual = isVirtual && mDevices[d].isSimulated() && mLimits[d].kind != DeviceKind::kCuda;
        if (mDevices[d].isSimulated()) continue;
        const DeviceWork& work = mDevices[d].work();
        report.busySeconds = work.times.searchSeconds;
        report.uploadSeconds = work.times.uploadSeconds;
        report.downloadSeconds = work.times.downloadSeconds;
        report.bytesUp = work.bytesUp;
        report.bytesDown = work.bytesDown;
    }
    mReport.cpuParticles = mProgress.cpuQueries();
    mReport.blockPairs = mProgress.blockPairs();
    mReport.seconds = isVirtual ? mDispatcher->doneSeconds() : wallSeconds() - mStart;
    mReport.cpuBusySeconds =
        isVirtual ? mDispatcher->cpuSeconds() : mCpu.work().seconds / tbb::this_task_arena::max_concurrency();
}

// Those that worked, for the next run: opening them and taking their memory costs more than many a search.
void ScheduleRunner::keepDevices(const std::vector<DeviceLimits>& devices)
{
    for (std::size_t d = 0; d < mDevices.size(); ++d) {
        if (mDevices[d].isSimulated() || !mReport.devices[d].failure.empty()) continue;
        const std::uint64_t hostBytes = mDevices[d].bufferCount() * mDevices[d].bufferBytes();
        mEngine.devices.push_back({devices[d], mDevices[d].close(), hostBytes});
    }
}

} // namespace

NeighborLists runSchedule(EngineState& engine, const SparseGrid& grid, const Schedule& schedule,
                          const std::vector<DeviceLimits>& devices, const RunOptions& options,
                          ScheduleRun& report, const DeviceMaker& makeDevice)
{
    SearchOptions search = options.search;
    search.encoding = schedule.model.encoding;
    checkOptions(search);
    const SearchRuns runs(SearchSets(grid, search.radius), search);
    const SearchRun& run = runs[0];
    if (!run.isPlain())
        throw InvalidInput(
            "devices search whole lists without the query itself: leave nearest and includeSelf out");
    const std::shared_ptr<NeighborListsData> result =
        engine.beginLists(runs.sets(), schedule.model.encoding, search);
    engine.beginStatistics(options.search);
    ChunkPool pool(std::move(result->chunks));
    const std::uint64_t allowed =
        engine.allowRows(runs, options.search, hostBytesOf(schedule, devices), *result, pool);
    try {
        ScheduleRunner runner(engine, run, schedule, options, *result, pool, report);
        runner.execute(devices, makeDevice);
    } catch (const ChunkPool::Exhausted&) {
        throw listsDoNotFit(schedule.model.encoding, false, pool.takenBytes(), allowed);
    }
    engine.finishLists(runs, pool, *result);
    engine.lists = result;
    return NeighborLists(result);
}

NeighborLists SearchEngine::search(const SparseGrid& grid, const Schedule& schedule,
                                   const std::vector<DeviceLimits>& devices, const RunOptions& options,
                                   ScheduleRun& report)
{
    checkOptions(options.search);
    requireKnown(options.onFailure, DeviceFailure::kUseCpu, "treatment of failed devices");
    requireKnown(options.schedule.boundary, BoundaryMode::kAuto, "boundary mode");
    requireKnown(schedule.model.encoding, Encoding::kNone, "encoding of the schedule");
    return isolatedIeee([&] {
        const double start = wallSeconds();
        const NeighborLists lists = runSchedule(*mImpl, grid, schedule, devices, options, report);
        mImpl->statistics.searchSeconds = wallSeconds() - start;
        return lists;
    });
}

} // namespace vdb_nns
