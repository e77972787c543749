// Running a schedule gives the lists of the plain search, byte for byte: whatever the budget, the boundary, the block size, the
// estimate, the devices, and whatever fails on the way. And a device's memory holds to the byte.
#include "out_of_core/block_image.h"
#include "out_of_core/run_schedule.h"
#include "out_of_core/simulated_device.h"
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/executor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <functional>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr Encoding kEncodings[] = {Encoding::kMask, Encoding::kIndex, Encoding::kNone};

std::string nameOf(Encoding encoding)
{
    return encoding == Encoding::kMask ? "mask" : encoding == Encoding::kIndex ? "index" : "none";
}

// A grid, its estimate and its true lists.
struct Case : EstimatedGrid {
    using EstimatedGrid::EstimatedGrid;

    const NeighborLists& truth(Encoding encoding) const
    {
        NeighborLists& lists = mTruth[static_cast<std::size_t>(encoding)];
        if (lists.size() == 0) {
            SearchOptions options;
            options.encoding = encoding;
            SearchEngine engine;
            lists = engine.search(grid, options);
            mStatistics[static_cast<std::size_t>(encoding)] = engine.statistics();
        }
        return lists;
    }
    const SearchStatistics& truthStatistics(Encoding encoding) const
    {
        return mStatistics[static_cast<std::size_t>(encoding)];
    }

    Schedule schedule(Encoding encoding, const std::vector<DeviceLimits>& devices,
                      const ScheduleOptions& options) const
    {
        const WorkloadTree one = tree(encoding, ~0ull);
        std::uint64_t bytes = nodeBytesFor(grid, estimate, one.options.model, devices, options);
        return makeSchedule(grid, tree(encoding, bytes, options.blockLog2Cells), devices, options);
    }

private:
    mutable NeighborLists mTruth[3];
    mutable SearchStatistics mStatistics[3];
};

const Case& sceneCase(const char* scene)
{
    const std::string name(scene);
    static const SceneGrid kBlock("block", 12000), kClusters("clusters", 5000), kSpray("spray", 6000),
        kSheet("sheet", 6000);
    static const Case kCases[] = {Case(kBlock.grid), Case(kClusters.grid), Case(kSpray.grid),
                                  Case(kSheet.grid)};
    return kCases[name == "block" ? 0 : name == "clusters" ? 1 : name == "spray" ? 2 : 3];
}

constexpr const char* kScenes[] = {"block", "clusters", "spray", "sheet"};

// Every query was run once by somebody.
void expectAllRun(const ScheduleRun& report, const Case& problem)
{
    std::uint64_t particles = report.cpuParticles;
    for (const DeviceRun& device : report.devices) particles += device.particles;
    EXPECT_EQ(particles, problem.grid.particleCount());
}

ScheduleRun expectRun(const Case& problem, const Schedule& schedule, const std::vector<DeviceLimits>& devices,
                      const RunOptions& options = {}, const DeviceMaker& maker = openDevice)
{
    ScheduleRun report;
    EngineState engine;
    const NeighborLists lists = runSchedule(engine, problem.grid, schedule, devices, options, report, maker);
    const NeighborLists& truth = problem.truth(schedule.model.encoding);
    expectSameLists(lists, truth);
    EXPECT_EQ(lists.data().rowBytes, truth.data().rowBytes);
    EXPECT_EQ(engine.statistics.doublePairs, problem.truthStatistics(schedule.model.encoding).doublePairs);
    EXPECT_EQ(engine.statistics.exactPairs, problem.truthStatistics(schedule.model.encoding).exactPairs);
    expectAllRun(report, problem);
    EXPECT_EQ(std::accumulate(report.blockPairs.begin(), report.blockPairs.end(), std::uint64_t(0)),
              lists.pairCount());
    for (std::size_t d = 0; d < devices.size(); ++d) {
        EXPECT_LE(report.devices[d].peakBytes, devices[d].memoryBytes);
    }
    return report;
}

TEST(RunSchedule, AnyBudgetAndBoundaryGiveTheSameLists)
{
    for (const char* scene : kScenes) {
        const Case& problem = sceneCase(scene);
        for (const Encoding encoding : kEncodings) {
            for (const double share : {1.0, 0.5, 0.1, 0.01, 0.0005}) {
                for (const BoundaryMode boundary :
                     {BoundaryMode::kCpu, BoundaryMode::kHalo, BoundaryMode::kAuto}) {
                    SCOPED_TRACE(std::string(scene) + " " + nameOf(encoding) + " " + std::to_string(share) +
                                 " " + boundaryModeName(boundary));
                    const auto memory =
                        static_cast<std::uint64_t>(share * static_cast<double>(problem.need(encoding)));
                    const std::vector<DeviceLimits> devices = {deviceOf(memory)};
                    ScheduleOptions options;
                    options.boundary = boundary;
                    const Schedule schedule = problem.schedule(encoding, devices, options);
                    const ScheduleRun report = expectRun(problem, schedule, devices);
                    EXPECT_EQ(report.devices[0].failure, "");
                    if (encoding == Encoding::kIndex) continue;
                    EXPECT_EQ(report.overflows, 0u) << "bytes are exact";
                    EXPECT_EQ(report.splits, 0u);
                    EXPECT_EQ(report.tooLargeQueries, schedule.tooLargeQueries);
                    EXPECT_NEAR(report.seconds, schedule.predictedSeconds, 0.01 * schedule.predictedSeconds);
                }
            }
        }
    }
}

TEST(RunSchedule, BlocksOfAFixedSizeAndTwoDevicesGiveTheSameLists)
{
    for (const char* scene : kScenes) {
        const Case& problem = sceneCase(scene);
        for (const Encoding encoding : kEncodings) {
            for (const int log2 : {3, 4, 5, 6}) {
                for (const std::size_t count : {1u, 2u}) {
                    SCOPED_TRACE(std::string(scene) + " " + nameOf(encoding) + " " + std::to_string(log2));
                    const std::vector<DeviceLimits> devices(count, deviceOf(problem.need(encoding)));
                    ScheduleOptions options;
                    options.blockLog2Cells = log2;
                    options.boundary = log2 % 2 ? BoundaryMode::kCpu : BoundaryMode::kHalo;
                    expectRun(problem, problem.schedule(encoding, devices, options), devices);
                }
            }
        }
    }
}

TEST(RunSchedule, EveryDistributionGivesTheSameLists)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        if (grid.empty()) return;
        const Case problem(grid);
        for (const Encoding encoding : kEncodings) {
            for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
                const std::vector<DeviceLimits> devices = {deviceOf(problem.need(encoding) / 4 + 3000)};
                ScheduleOptions options;
                options.boundary = boundary;
                expectRun(problem, problem.schedule(encoding, devices, options), devices);
            }
        }
    });
}

TEST(RunSchedule, AnyNumberOfThreadsDecidesTheSame)
{
    const Case& problem = sceneCase("clusters");
    const std::vector<DeviceLimits> devices(2, deviceOf(problem.need(Encoding::kIndex) / 5));
    const Schedule schedule = problem.schedule(Encoding::kIndex, devices, {});
    std::vector<ScheduleRun> reports;
    for (const int threads : {1, 2, 5, 5}) {
        runOnThreads(threads, [&] { reports.push_back(expectRun(problem, schedule, devices)); });
    }
    for (const ScheduleRun& report : reports) {
        EXPECT_EQ(report.seconds, reports[0].seconds);
        EXPECT_EQ(report.cpuBusySeconds, reports[0].cpuBusySeconds);
        EXPECT_EQ(report.cpuParticles, reports[0].cpuParticles);
        EXPECT_EQ(report.overflows, reports[0].overflows);
        EXPECT_EQ(report.retries, reports[0].retries);
        EXPECT_EQ(report.splits, reports[0].splits);
        EXPECT_EQ(report.cpuBlocks, reports[0].cpuBlocks);
        EXPECT_EQ(report.blockPairs, reports[0].blockPairs);
        for (std::size_t d = 0; d < 2; ++d) {
            EXPECT_EQ(report.devices[d].blocks, reports[0].devices[d].blocks);
            EXPECT_EQ(report.devices[d].peakBytes, reports[0].devices[d].peakBytes);
            EXPECT_EQ(report.devices[d].particles, reports[0].devices[d].particles);
            EXPECT_EQ(report.devices[d].busySeconds, reports[0].devices[d].busySeconds);
        }
    }
}

// ---- estimators that lie ---------------------------------------------------------------------------------------------

Case lyingCase(const char* scene, double pairs)
{
    Case problem = sceneCase(scene);
    for (Work& leaf : problem.estimate.leaves) leaf.expectedPairs = pairs;
    problem.estimate.total.expectedPairs = pairs * static_cast<double>(problem.estimate.leaves.size());
    return problem;
}

TEST(RunSchedule, AnEstimateThatLiesGivesTheSameLists)
{
    for (const char* scene : kScenes) {
        for (const double pairs : {0.0, 1.0, 1e18}) {
            for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
                for (const std::uint64_t divisor : {1u, 8u, 100u}) {
                    SCOPED_TRACE(std::string(scene) + " " + std::to_string(pairs) + " " +
                                 boundaryModeName(boundary) + " /" + std::to_string(divisor));
                    const Case problem = lyingCase(scene, pairs);
                    const std::uint64_t need = sceneCase(scene).need(Encoding::kIndex);
                    const std::vector<DeviceLimits> devices = {deviceOf(need / divisor)};
                    ScheduleOptions options;
                    options.boundary = boundary;
                    const ScheduleRun report =
                        expectRun(problem, problem.schedule(Encoding::kIndex, devices, options), devices);
                    if (pairs == 1e18) {
                        EXPECT_EQ(report.cpuParticles, problem.grid.particleCount());
                        EXPECT_EQ(report.overflows, 0u);
                    }
                }
            }
        }
        const Case problem = lyingCase(scene, 0);
        const std::vector<DeviceLimits> devices = {deviceOf(sceneCase(scene).need(Encoding::kIndex) / 8)};
        const ScheduleRun report =
            expectRun(problem, problem.schedule(Encoding::kIndex, devices, {}), devices);
        EXPECT_GT(report.overflows, 0u) << "no room was reserved";
        EXPECT_GE(report.retries, report.overflows) << "each is run again, in one part at least";
    }
}

// Masks too, where their sizes are not exact after all: what a rough estimate says of everything at once.
TEST(RunSchedule, MasksThatAreLargerThanTheyWereTakenToBeAreRedone)
{
    for (const char* scene : kScenes) {
        std::uint64_t overflows = 0;
        for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
            SCOPED_TRACE(std::string(scene) + " " + boundaryModeName(boundary));
            Case problem = sceneCase(scene);
            for (Work& leaf : problem.estimate.leaves) leaf.maskBytes = 0;
            problem.estimate.total.maskBytes = 0;
            RunOptions run;
            run.schedule.boundary = boundary;
            run.schedule.useCpu = false;
            for (const std::uint64_t divisor : {1u, 10u}) {
                const std::vector<DeviceLimits> devices = {deviceOf(problem.need(Encoding::kMask) / divisor)};
                const ScheduleRun report = expectRun(
                    problem, problem.schedule(Encoding::kMask, devices, run.schedule), devices, run);
                overflows += report.overflows;
            }
        }
        EXPECT_GT(overflows, 0u);
    }
}

TEST(RunSchedule, ARoughEstimateServesWhereEverythingFits)
{
    EstimateOptions rough;
    rough.estimator = Estimator::kProbed;
    for (const char* scene : kScenes) {
        for (const Encoding encoding : kEncodings) {
            SCOPED_TRACE(std::string(scene) + " " + nameOf(encoding));
            Case problem = sceneCase(scene);
            problem.estimate = estimateWork(problem.grid, rough);
            EXPECT_EQ(problem.estimate.total.particles, problem.grid.particleCount());
            // Twice, or what it says and too little.
            for (const double share : {2.0, 1.0, 0.6}) {
                const auto memory =
                    static_cast<std::uint64_t>(share * static_cast<double>(problem.need(encoding)));
                const std::vector<DeviceLimits> devices = {deviceOf(memory)};
                const Schedule schedule = problem.schedule(encoding, devices, {});
                if (share >= 1) {
                    EXPECT_TRUE(schedule.inCore);
                }
                expectRun(problem, schedule, devices);
            }
        }
    }
}

// What was learnt splits later blocks before they run in vain.
TEST(RunSchedule, WhatIsLearntFromFinishedBlocksSavesOverflows)
{
    const Case honest = sceneCase("block");
    Case problem = honest;
    for (Work& leaf : problem.estimate.leaves) leaf.expectedPairs *= 0.4;
    problem.estimate.total.expectedPairs *= 0.4;
    const std::vector<DeviceLimits> devices = {deviceOf(honest.need(Encoding::kIndex) / 20)};
    ScheduleOptions options;
    options.useCpu = false;
    options.boundary = BoundaryMode::kHalo;
    const Schedule schedule = problem.schedule(Encoding::kIndex, devices, options);
    RunOptions run;
    run.schedule = options;
    const ScheduleRun report = expectRun(problem, schedule, devices, run);
    EXPECT_GT(report.overflows, 0u);
    EXPECT_GT(report.splits, 0u);
    EXPECT_LE(report.overflows, 3u * 3u)
        << "only those that were in flight before anything was known, or near it";
}

// ---- devices that fail -----------------------------------------------------------------------------------------------

// Fails at one step, counted over all buffers. Memory may be refused instead, once or for good.
class FailingDevice final : public SimulatedDevice {
public:
    struct Plan {
        std::string step;
        std::atomic<int> left{0}; // calls of that step until it fails
        std::uint64_t refuseAbove = std::numeric_limits<std::uint64_t>::max();
    };

    FailingDevice(const DeviceLimits& limits, const SearchRun& run, ThreadStates& states, Plan& plan)
        : SimulatedDevice(limits.name, limits.memoryBytes, run, states), mPlan(plan)
    {
    }

    std::byte* allocate(std::uint64_t bytes) override
    {
        if (bytes > mPlan.refuseAbove) throw OutOfDeviceMemory("refused");
        fail("allocate");
        return SimulatedDevice::allocate(bytes);
    }
    std::byte* allocateStaging(std::uint64_t bytes) override
    {
        fail("stage");
        return SimulatedDevice::allocateStaging(bytes);
    }
    void upload(int buffer, std::byte* device, const std::byte* staging, std::uint64_t bytes) override
    {
        fail("upload");
        SimulatedDevice::upload(buffer, device, staging, bytes);
    }
    void search(int buffer, const BlockSearch& block) override
    {
        fail("search");
        SimulatedDevice::search(buffer, block);
        fail("searched");
    }
    std::byte* download(int buffer, std::byte* staging, std::byte* device, std::uint64_t bytes) override
    {
        fail("download");
        return SimulatedDevice::download(buffer, staging, device, bytes);
    }
    StepTimes wait(int buffer) override
    {
        fail("wait");
        return SimulatedDevice::wait(buffer);
    }

private:
    void fail(const char* step)
    {
        if (mPlan.step == step && mPlan.left-- <= 0) throw DeviceError(std::string("injected at ") + step);
    }

    Plan& mPlan;
};

DeviceMaker failing(FailingDevice::Plan& plan)
{
    return [&plan](const DeviceLimits& limits, const SearchRun& run, ThreadStates& states) {
        return std::make_unique<FailingDevice>(limits, run, states, plan);
    };
}

TEST(RunSchedule, ADeviceThatFailsAtAnyStepLosesNothing)
{
    for (const Encoding encoding : kEncodings) {
        for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
            const Case& problem = sceneCase("sheet");
            const std::vector<DeviceLimits> devices = {deviceOf(problem.need(encoding) / 6)};
            ScheduleOptions options;
            options.boundary = boundary;
            options.useCpu = false;
            const Schedule schedule = problem.schedule(encoding, devices, options);
            for (const char* step :
                 {"allocate", "stage", "upload", "search", "searched", "download", "wait"}) {
                constexpr int kNever = 1 << 20;
                FailingDevice::Plan plan;
                plan.step = step;
                plan.left = kNever;
                RunOptions run;
                run.schedule = options;
                expectRun(problem, schedule, devices, run, failing(plan));
                const int all = kNever - plan.left;
                ASSERT_GT(all, 0);
                for (const int calls : {0, all / 2, all - 1}) {
                    SCOPED_TRACE(nameOf(encoding) + " " + boundaryModeName(boundary) + " " + step + " " +
                                 std::to_string(calls));
                    plan.left = calls;
                    run.onFailure = DeviceFailure::kUseCpu;
                    ScheduleRun report = expectRun(problem, schedule, devices, run, failing(plan));
                    EXPECT_LT(plan.left, 0) << "it failed";
                    EXPECT_NE(report.devices[0].failure, "");
                    EXPECT_GT(report.cpuParticles, 0u);
                    plan.left = calls;
                    run.onFailure = DeviceFailure::kStop;
                    EngineState engine;
                    EXPECT_THROW(
                        runSchedule(engine, problem.grid, schedule, devices, run, report, failing(plan)),
                        DeviceError);
                }
            }
        }
    }
}

// One device of two fails: the other does its blocks.
TEST(RunSchedule, TheOtherDeviceTakesOver)
{
    const Case& problem = sceneCase("spray");
    const std::vector<DeviceLimits> devices(2, deviceOf(problem.need(Encoding::kMask) / 6));
    RunOptions run;
    run.onFailure = DeviceFailure::kUseCpu;
    run.schedule.boundary = BoundaryMode::kHalo;
    run.schedule.useCpu = false;
    const Schedule schedule = problem.schedule(Encoding::kMask, devices, run.schedule);
    FailingDevice::Plan plan, sound;
    plan.step = "search";
    plan.left = 4;
    int made = 0;
    const ScheduleRun report = expectRun(problem, schedule, devices, run,
                                         [&](const DeviceLimits& limits, const SearchRun& search,
                                             ThreadStates& states) -> std::unique_ptr<BlockDevice> {
                                             return std::make_unique<FailingDevice>(
                                                 limits, search, states, made++ == 0 ? plan : sound);
                                         });
    EXPECT_FALSE(report.devices[0].failure.empty());
    EXPECT_TRUE(report.devices[1].failure.empty());
    EXPECT_GT(report.retries, 0u);
    EXPECT_EQ(report.cpuParticles, 0u);
}

TEST(RunSchedule, MemoryThatIsRefusedHalvesBlocksAndThenTheCpuRunsThem)
{
    for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex}) {
        for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
            const Case& problem = sceneCase("block");
            const std::vector<DeviceLimits> devices = {deviceOf(problem.need(encoding) / 2)};
            RunOptions run;
            run.schedule.boundary = boundary;
            const Schedule schedule = problem.schedule(encoding, devices, run.schedule);
            std::uint64_t largest = 0;
            for (const Block& block : schedule.blocks) {
                if (block.preferred != Block::kOnCpu) largest = std::max(largest, block.bytes.total());
            }
            for (const std::uint64_t divisor : {2u, 10u, 60u}) {
                SCOPED_TRACE(nameOf(encoding) + " " + std::to_string(divisor));
                FailingDevice::Plan plan;
                plan.refuseAbove = largest / divisor;
                const ScheduleRun report = expectRun(problem, schedule, devices, run, failing(plan));
                EXPECT_GT(report.halvings, 0u);
                EXPECT_GT(report.splits, 0u);
                EXPECT_TRUE(report.devices[0].failure.empty());
            }
            FailingDevice::Plan plan;
            plan.refuseAbove = 0;
            const ScheduleRun report = expectRun(problem, schedule, devices, run, failing(plan));
            EXPECT_FALSE(report.devices[0].failure.empty());
            EXPECT_EQ(report.cpuParticles, problem.grid.particleCount());
        }
    }
}

// ---- bytes -----------------------------------------------------------------------------------------------------------

TEST(BlockImage, TakesTheBytesThatTheScheduleCounts)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        if (grid.empty()) return;
        const Case problem(grid);
        const std::vector<DeviceLimits> devices = {deviceOf(problem.need(Encoding::kMask) / 4 + 3000)};
        for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
            ScheduleOptions options;
            options.boundary = boundary;
            for (const Block& block : problem.schedule(Encoding::kMask, devices, options).blocks) {
                const BlockHalo halo = haloOf(grid.data(), block.firstLeaf, block.endLeaf, block.log2Cells);
                BlockPart part{block.firstLeaf,
                               block.endLeaf,
                               static_cast<std::uint32_t>(block.firstSlot),
                               static_cast<std::uint32_t>(block.endSlot),
                               {},
                               {}};
                (block.withHalo ? part.halo : part.without) = block.withHalo ? halo.halo : halo.boundary;
                EXPECT_EQ(imageBytes(grid.data(), part), block.bytes.up);
            }
        }
    });
}

TEST(SimulatedDevice, HoldsItsBudgetToTheByte)
{
    const Case& problem = sceneCase("sheet");
    const SearchRuns runs(problem.grid, {});
    const SearchRun& run = runs[0];
    ThreadStates states;
    SimulatedDevice device("test", 1000, run, states);
    EXPECT_NE(device.allocate(400), nullptr);
    EXPECT_NE(device.allocate(600), nullptr);
    EXPECT_THROW(device.allocate(1), OutOfDeviceMemory);
    EXPECT_EQ(device.peakBytes(), 1000u);
    device.releaseAll();
    EXPECT_THROW(device.allocate(1001), OutOfDeviceMemory);
    EXPECT_NE(device.allocate(1000), nullptr);
}

// ---- bad input -------------------------------------------------------------------------------------------------------

TEST(RunSchedule, AScheduleOfAnotherGridIsRefused)
{
    const Case &block = sceneCase("block"), &sheet = sceneCase("sheet");
    const std::vector<DeviceLimits> devices = {deviceOf(block.need(Encoding::kMask) / 4)};
    const Schedule schedule = block.schedule(Encoding::kMask, devices, {});
    ScheduleRun report;
    EXPECT_THROW(SearchEngine().search(sheet.grid, schedule, devices, {}, report), InvalidInput);
    EXPECT_THROW(SearchEngine().search(block.grid, Schedule(), devices, {}, report), InvalidInput);
    EXPECT_THROW(SearchEngine().search(block.grid, schedule, {}, {}, report), InvalidInput);
    // As many leaves and slots, but not so many cells: no byte is written past what the schedule asked for.
    const auto leavesOf = [](double spread) {
        std::vector<double> xyz;
        for (int i = 0; i < 4800; ++i) {
            const double cell = 0.2 + spread * (i % 7), across = 0.2 + spread * (i / 7 % 7);
            xyz.insert(xyz.end(), {8.0 * (i / 600) + cell, across, 0.2 + spread * (i / 49 % 7) + 1e-5 * i});
        }
        return xyz;
    };
    const std::vector<double> together = leavesOf(0.01), apart = leavesOf(1);
    const Case few(gridOf(ParticleView::fromArray(together.data(), 4800), 1, 1));
    const SparseGrid many = gridOf(ParticleView::fromArray(apart.data(), 4800), 1, 1);
    ASSERT_EQ(few.grid.leafCount(), many.leafCount());
    for (const std::uint64_t divisor : {1u, 2u}) {
        const std::vector<DeviceLimits> own = {deviceOf(few.need(Encoding::kNone) / divisor)};
        RunOptions run;
        run.schedule.useCpu = false;
        EXPECT_THROW(
            SearchEngine().search(many, few.schedule(Encoding::kNone, own, run.schedule), own, run, report),
            InvalidInput);
    }
    RunOptions unknown;
    unknown.onFailure = static_cast<DeviceFailure>(2);
    EXPECT_THROW(SearchEngine().search(block.grid, schedule, devices, unknown, report), InvalidInput);
    DeviceLimits cuda = devices[0];
    cuda.kind = DeviceKind::kCuda;
    EXPECT_THROW(SearchEngine().search(block.grid, schedule, {cuda}, {}, report), DeviceError);
}

TEST(RunSchedule, ListsThatDoNotFitTheHostAreACapacityError)
{
    const Case& problem = sceneCase("block");
    for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex}) {
        const std::vector<DeviceLimits> devices = {deviceOf(problem.need(encoding) / 4)};
        RunOptions run;
        run.search.hostMemoryBytes = problem.grid.bytes() + 200'000;
        ScheduleRun report;
        EXPECT_THROW(SearchEngine().search(problem.grid, problem.schedule(encoding, devices, {}), devices,
                                           run, report),
                     CapacityError);
    }
}

class StopsAt final : public Progress {
public:
    explicit StopsAt(int calls) : mLeft(calls) {}
    void update(const char*, double) override {}
    bool cancelled() const override { return mLeft-- <= 0; }

private:
    mutable std::atomic<int> mLeft;
};

TEST(RunSchedule, CanBeCancelledAnywhere)
{
    const Case& problem = sceneCase("spray");
    const std::vector<DeviceLimits> devices = {deviceOf(problem.need(Encoding::kIndex) / 10)};
    const Schedule schedule = problem.schedule(Encoding::kIndex, devices, {});
    SearchEngine engine;
    for (const int calls : {0, 1, 10, 100, 300}) {
        StopsAt progress(calls);
        RunOptions run;
        run.search.progress = &progress;
        ScheduleRun report;
        EXPECT_THROW(engine.search(problem.grid, schedule, devices, run, report), Cancelled) << calls;
    }
    ScheduleRun report;
    expectSameLists(engine.search(problem.grid, schedule, devices, {}, report),
                    problem.truth(Encoding::kIndex));
}

TEST(RunSchedule, NothingToDoIsDone)
{
    const std::vector<float> none;
    const SparseGrid grid = gridOf(ParticleView::fromArray(none.data(), 0), 1, 1);
    const Case problem(grid);
    const std::vector<DeviceLimits> devices = {deviceOf(100000)};
    ScheduleRun report;
    const Schedule schedule = problem.schedule(Encoding::kIndex, devices, {});
    EXPECT_EQ(SearchEngine().search(grid, schedule, devices, {}, report).size(), 0u);
}

} // namespace

} // namespace vdb_nns::testing
