// What happens when a CUDA call fails: memory that is refused makes blocks smaller and in the end leaves them to the CPU; any
// other failure is a DeviceError that names the call, or leaves the device's blocks to the CPU. Nothing leaks either way.
#include "cuda/launch.h"
#include "plan/workload_cases.h"
#include "shared/block_device.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/executor.h"

#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr std::uint64_t kDeviceBytes = std::uint64_t(1) << 30;
constexpr std::uint64_t kDriverBytes = std::uint64_t(64) << 20; // left to the driver

// What the kernels take of a device.
std::uint64_t kernelBytes()
{
    simt::resetMachine({kDeviceBytes}, 7);
    cudaDevices();
    return simt::loadedKernels() * simt::kKernelBytes;
}

const EstimatedGrid& problem()
{
    static const SceneGrid kScene("block", 16000);
    static const EstimatedGrid kProblem(kScene.grid);
    return kProblem;
}

struct Outcome {
    ScheduleRun report;
    std::uint64_t checksum = 0;
};

Outcome searchWith(DeviceFailure onFailure, std::uint64_t divisor, const char* failing = nullptr,
                   int after = 0, cudaError_t code = cudaErrorLaunchFailure,
                   std::uint64_t deviceBytes = kDeviceBytes)
{
    const EstimatedGrid& own = problem();
    simt::resetMachine({deviceBytes}, 7);
    std::vector<DeviceLimits> devices = cudaDevices();
    devices[0].memoryBytes = own.need(Encoding::kMask) / divisor;
    RunOptions run;
    run.onFailure = onFailure;
    run.schedule.useCpu = false;
    run.schedule.boundary = BoundaryMode::kHalo;
    const WorkloadTree one = own.tree(Encoding::kMask, ~0ull);
    const std::uint64_t bytes =
        nodeBytesFor(own.grid, own.estimate, one.options.model, devices, run.schedule);
    const Schedule schedule = makeSchedule(own.grid, own.tree(Encoding::kMask, bytes), devices, run.schedule);
    if (failing) simt::fail(failing, after, code);
    Outcome outcome;
    outcome.checksum = SearchEngine().search(own.grid, schedule, devices, run, outcome.report).checksum();
    EXPECT_EQ(simt::liveAllocations(), 0u);
    return outcome;
}

std::uint64_t trueChecksum()
{
    return SearchEngine().search(problem().grid, {}).checksum();
}

// The event that times are counted from is another queue's. The emulation runs queues in any order.
TEST(CudaFailures, QueuesAreTimedFromAnEventThatIsComplete)
{
    for (std::uint64_t seed = 1; seed <= 64; ++seed) {
        simt::resetMachine({kDeviceBytes}, seed);
        cuda::OpenOptions options;
        options.budgetBytes = kDeviceBytes / 2;
        options.buffers = 2;
        const std::unique_ptr<BlockDevice> device = cuda::openBlockDevice(options);
        for (int run = 0; run < 2; ++run) {
            device->restart();
            std::byte* const staging = device->allocateStaging(64);
            std::byte* const memory = device->allocate(64);
            device->upload(1, memory, staging, 64);
            EXPECT_NO_THROW(device->wait(1)) << seed;
        }
    }
}

TEST(CudaFailures, NoneGivesTheLists)
{
    EXPECT_EQ(searchWith(DeviceFailure::kStop, 1).checksum, trueChecksum());
    EXPECT_EQ(searchWith(DeviceFailure::kStop, 4).checksum, trueChecksum());
}

TEST(CudaFailures, MemoryIsKeptForTheNextRun)
{
    const EstimatedGrid& own = problem();
    simt::resetMachine({kDeviceBytes}, 7);
    std::vector<DeviceLimits> devices = cudaDevices();
    RunOptions run;
    run.schedule.useCpu = false;
    run.schedule.boundary = BoundaryMode::kHalo;
    const WorkloadTree one = own.tree(Encoding::kMask, ~0ull);
    {
        SearchEngine engine;
        const auto search = [&](std::uint64_t divisor) {
            devices[0].memoryBytes = own.need(Encoding::kMask) / divisor;
            const std::uint64_t bytes =
                nodeBytesFor(own.grid, own.estimate, one.options.model, devices, run.schedule);
            const Schedule schedule =
                makeSchedule(own.grid, own.tree(Encoding::kMask, bytes), devices, run.schedule);
            ScheduleRun report;
            EXPECT_EQ(engine.search(own.grid, schedule, devices, run, report).checksum(), trueChecksum());
            EXPECT_GT(report.devices[0].peakBytes, 0u);
            EXPECT_LE(report.devices[0].peakBytes, devices[0].memoryBytes);
            return report;
        };
        EXPECT_EQ(search(4).halvings, 0u);
        // An allocation would be refused now, and half of it asked for.
        simt::fail("cudaMalloc", 0, cudaErrorMemoryAllocation);
        EXPECT_EQ(search(4).halvings, 0u);
        EXPECT_EQ(search(2).halvings, 1u) << "another budget is another device";
        EXPECT_EQ(search(4).halvings, 0u);
    }
    EXPECT_EQ(simt::liveAllocations(), 0u);
}

// A driver loads a kernel at its first launch, if nobody has asked for it before: while that is timed, and when the device may
// be full of blocks.
TEST(CudaKernels, AreLoadedBeforeFreeMemoryIsAskedForAndBeforeTheFirstLaunch)
{
    const std::uint64_t bytes = kernelBytes();
    EXPECT_GT(bytes, 0u);
    EXPECT_EQ(cudaDevices()[0].memoryBytes, kDeviceBytes - kDriverBytes - bytes);
    const SceneGrid scene("block", 500);
    const EstimatedGrid own(scene.grid);
    const std::vector<DeviceLimits> devices = cudaDevices();
    for (const bool isMachineNew : {false, true}) {
        for (const Encoding encoding : {Encoding::kNone, Encoding::kMask, Encoding::kIndex}) {
            if (isMachineNew) simt::resetMachine({kDeviceBytes}, 7); // nobody asks it for its memory
            RunOptions run;
            run.schedule.useCpu = false;
            const Schedule schedule =
                makeSchedule(own.grid, own.tree(encoding, ~0ull), devices, run.schedule);
            ScheduleRun report;
            SearchEngine().search(own.grid, schedule, devices, run, report);
            EXPECT_EQ(report.devices[0].particles, own.grid.particleCount());
            EXPECT_EQ(simt::loadedKernels() * simt::kKernelBytes, bytes);
        }
    }
}

// What is kept makes way for what is needed: a scene that grew from one block to several, a budget that changed on a device
// that is nearly full.
TEST(CudaFailures, WhatIsKeptIsNotInTheWay)
{
    const SceneGrid smaller("block", 5000);
    const EstimatedGrid small(smaller.grid);
    const EstimatedGrid& large = problem();
    simt::resetMachine({kDriverBytes + kernelBytes() + large.need(Encoding::kMask)}, 7);
    std::vector<DeviceLimits> devices = cudaDevices();
    RunOptions run;
    run.schedule.useCpu = false;
    run.schedule.boundary = BoundaryMode::kHalo;
    SearchEngine engine;
    const auto search = [&](const EstimatedGrid& own) {
        const WorkloadTree one = own.tree(Encoding::kMask, ~0ull);
        const std::uint64_t bytes =
            nodeBytesFor(own.grid, own.estimate, one.options.model, devices, run.schedule);
        const Schedule schedule =
            makeSchedule(own.grid, own.tree(Encoding::kMask, bytes), devices, run.schedule);
        ScheduleRun report;
        engine.search(own.grid, schedule, devices, run, report);
        return report.halvings;
    };
    devices[0].memoryBytes = small.need(Encoding::kMask) + 1000;
    EXPECT_EQ(search(small), 0u);
    EXPECT_EQ(search(large), 0u) << "three buffers instead of one";
    EXPECT_EQ(search(small), 0u);
    devices[0].memoryBytes = large.need(Encoding::kMask);
    EXPECT_EQ(search(large), 0u);
    devices[0].memoryBytes -= 16;
    EXPECT_EQ(search(large), 0u) << "the old device is closed first";
    const std::size_t held = simt::liveAllocations();
    engine.releaseDevices();
    EXPECT_LT(simt::liveAllocations(), held);
    EXPECT_EQ(simt::liveAllocations(), 0u);
}

TEST(CudaFailures, MemoryThatIsRefusedHalvesBlocks)
{
    for (const char* call : {"cudaMalloc", "cudaHostAlloc"}) {
        const Outcome outcome = searchWith(DeviceFailure::kStop, 4, call, 1, cudaErrorMemoryAllocation);
        EXPECT_EQ(outcome.report.halvings, 1u) << call;
        EXPECT_EQ(outcome.checksum, trueChecksum()) << call;
    }
}

TEST(CudaFailures, ADeviceWithLessFreeMemoryThanAskedForHalvesBlocks)
{
    const std::uint64_t tight = kDriverBytes + problem().need(Encoding::kMask) / 3;
    const Outcome outcome = searchWith(DeviceFailure::kStop, 1, nullptr, 0, cudaSuccess, tight);
    EXPECT_GT(outcome.report.halvings, 0u);
    EXPECT_GT(outcome.report.devices[0].particles, 0u);
    EXPECT_LE(outcome.report.devices[0].peakBytes, problem().need(Encoding::kMask) / 3);
    EXPECT_EQ(outcome.checksum, trueChecksum());
}

TEST(CudaFailures, AFailureStopsAndNamesItsCall)
{
    for (const char* call : {"cudaMemcpyAsync", "cudaEventRecord", "cudaEventSynchronize",
                             "cudaStreamCreateWithFlags", "cudaMalloc", "launch"}) {
        SCOPED_TRACE(call);
        try {
            searchWith(DeviceFailure::kStop, 4, call, std::string(call) == "cudaEventSynchronize" ? 5 : 2);
            ADD_FAILURE() << "nothing was thrown";
        } catch (const DeviceError& error) {
            const std::string what = error.what();
            // Whichever comes third of the launches of several buffers; each is named by the label of its kernel.
            EXPECT_NE(what.find(std::string(call) == "launch" ? "launcher.cuh" : call), std::string::npos)
                << what;
            EXPECT_NE(what.find("719"), std::string::npos) << what;
        }
        EXPECT_EQ(simt::liveAllocations(), 0u);
    }
}

TEST(CudaFailures, TheCpuTakesOverWhereItMay)
{
    for (const char* call : {"cudaMemcpyAsync", "cudaEventSynchronize", "launch", "cudaMalloc",
                             "cudaStreamCreateWithFlags", "cudaEventCreateWithFlags"}) {
        SCOPED_TRACE(call);
        const Outcome outcome = searchWith(DeviceFailure::kUseCpu, 4, call, 2);
        EXPECT_FALSE(outcome.report.devices[0].failure.empty());
        EXPECT_GT(outcome.report.cpuParticles, 0u);
        EXPECT_EQ(outcome.report.cpuParticles + outcome.report.devices[0].particles,
                  problem().grid.particleCount());
        EXPECT_EQ(outcome.checksum, trueChecksum());
    }
}

// A device that is kept and fails before the next run begins has failed as any other; the run after opens it anew.
TEST(CudaFailures, AKeptDeviceMayFailBetweenRuns)
{
    const EstimatedGrid& own = problem();
    simt::resetMachine({kDeviceBytes}, 7);
    std::vector<DeviceLimits> devices = cudaDevices();
    devices[0].memoryBytes = own.need(Encoding::kMask);
    const Schedule schedule = makeSchedule(own.grid, own.tree(Encoding::kMask, ~0ull), devices);
    SearchEngine engine;
    const auto search = [&](DeviceFailure onFailure) {
        RunOptions run;
        run.onFailure = onFailure;
        ScheduleRun report;
        EXPECT_EQ(engine.search(own.grid, schedule, devices, run, report).checksum(), trueChecksum());
        return report;
    };
    EXPECT_TRUE(search(DeviceFailure::kUseCpu).devices[0].failure.empty());
    simt::fail("cudaEventRecord", 0, cudaErrorLaunchFailure);
    const ScheduleRun failed = search(DeviceFailure::kUseCpu);
    EXPECT_NE(failed.devices[0].failure.find("cudaEventRecord"), std::string::npos)
        << failed.devices[0].failure;
    EXPECT_EQ(failed.cpuParticles, own.grid.particleCount());
    EXPECT_EQ(simt::liveAllocations(), 0u);
    const ScheduleRun again = search(DeviceFailure::kUseCpu);
    EXPECT_TRUE(again.devices[0].failure.empty()) << again.devices[0].failure;
    EXPECT_EQ(again.devices[0].particles, own.grid.particleCount());
    simt::fail("cudaEventRecord", 0, cudaErrorLaunchFailure);
    EXPECT_THROW(search(DeviceFailure::kStop), DeviceError);
    EXPECT_TRUE(search(DeviceFailure::kStop).devices[0].failure.empty());
}

} // namespace

} // namespace vdb_nns::testing
