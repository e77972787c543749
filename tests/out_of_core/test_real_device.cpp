// Devices that are not simulated, by a double that searches like the simulated one and measures what a test wants: their
// blocks in flight have threads of their own, what they measure is reported and changes who takes which block, and whatever
// ends a run ends it only after the last block in flight.
#include "out_of_core/run_schedule.h"
#include "out_of_core/simulated_device.h"
#include "plan/dispatcher.h"
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include <dlfcn.h>
#include <pthread.h>

namespace {

// Threads that this thread may still start before one is refused, once; negative: all it likes.
thread_local int threadsBeforeRefusal = -1;

} // namespace

// Before the system's, for the whole program.
extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*run)(void*),
                              void* argument)
{
    using Create = int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
    static const auto create = reinterpret_cast<Create>(::dlsym(RTLD_NEXT, "pthread_create"));
    if (threadsBeforeRefusal >= 0 && threadsBeforeRefusal-- == 0) return EAGAIN;
    return create(thread, attributes, run, argument);
}

namespace vdb_nns::testing {

namespace {

const EstimatedGrid& problem()
{
    static const SceneGrid kScene("spray", 12000);
    static const EstimatedGrid kProblem(kScene.grid);
    return kProblem;
}

std::uint64_t trueChecksum()
{
    static const std::uint64_t kChecksum = SearchEngine().search(problem().grid, {}).checksum();
    return kChecksum;
}

// What a test wants of all devices of a run, and what it sees of them.
struct Wish {
    StepTimes times;                                // of each block
    std::chrono::milliseconds opening{0}, sleep{0}; // sleep: in wait()
    std::function<void(int block)> onSearch;        // may throw; the blocks are counted as they come
    int threadsBeforeRefusal = -1;                  // for the buffers; negative: all of them

    std::atomic<int> blocks{0}, inside{0}, destroyed{0};
    std::atomic<bool> wasInsideAtEnd{false};
    std::mutex mutex;
    std::map<int, std::set<std::thread::id>> threads; // by buffer
};

class RealDevice final : public SimulatedDevice {
public:
    RealDevice(const DeviceLimits& limits, const SearchRun& run, ThreadStates& states, Wish& wish)
        : SimulatedDevice(limits.name, limits.memoryBytes, run, states), mWish(wish)
    {
    }
    ~RealDevice() override
    {
        if (mWish.inside > 0) mWish.wasInsideAtEnd = true;
        ++mWish.destroyed;
    }

    bool isSimulated() const override { return false; }
    std::byte* allocateStaging(std::uint64_t bytes) override
    {
        threadsBeforeRefusal = mWish.threadsBeforeRefusal; // threads are next
        return SimulatedDevice::allocateStaging(bytes);
    }
    void search(int buffer, const BlockSearch& block) override
    {
        const Inside inside(mWish);
        {
            const std::lock_guard<std::mutex> lock(mWish.mutex);
            mWish.threads[buffer].insert(std::this_thread::get_id());
        }
        const int number = mWish.blocks++;
        if (mWish.onSearch) mWish.onSearch(number);
        SimulatedDevice::search(buffer, block);
    }
    StepTimes wait(int) override
    {
        const Inside inside(mWish);
        std::this_thread::sleep_for(mWish.sleep);
        return mWish.times;
    }

private:
    struct Inside {
        explicit Inside(Wish& w) : wish(w) { ++wish.inside; }
        ~Inside() { --wish.inside; }
        Wish& wish;
    };

    Wish& mWish;
};

struct RealRun {
    explicit RealRun(BoundaryMode boundary, std::uint64_t divisor = 8)
    {
        devices = {deviceOf(problem().need(Encoding::kMask) / divisor)};
        options.schedule.boundary = boundary;
        options.schedule.useCpu = false;
    }

    Schedule schedule() const
    {
        const WorkloadTree one = problem().tree(Encoding::kMask, ~0ull);
        const std::uint64_t bytes =
            nodeBytesFor(problem().grid, problem().estimate, one.options.model, devices, options.schedule);
        return makeSchedule(problem().grid, problem().tree(Encoding::kMask, bytes), devices,
                            options.schedule);
    }

    // Throws what the run throws; the device is gone by then, and nobody was using it.
    ScheduleRun run(Wish& wish)
    {
        const DeviceMaker maker = [&](const DeviceLimits& limits, const SearchRun& search,
                                      ThreadStates& states) {
            std::this_thread::sleep_for(wish.opening);
            return std::make_unique<RealDevice>(limits, search, states, wish);
        };
        EngineState engine; // keeps the device until here, for a next run
        ScheduleRun report;
        const NeighborLists lists =
            runSchedule(engine, problem().grid, schedule(), devices, options, report, maker);
        EXPECT_EQ(lists.checksum(), trueChecksum());
        std::uint64_t queries = report.cpuParticles;
        for (const DeviceRun& device : report.devices) queries += device.particles;
        EXPECT_EQ(queries, problem().grid.particleCount());
        return report;
    }

    std::vector<DeviceLimits> devices;
    RunOptions options;
};

TEST(RealDevice, RunsItsBlocksOnThreadsOfItsOwn)
{
    for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
        for (const int threads : {1, 2}) {
            SCOPED_TRACE(std::string(boundaryModeName(boundary)) + " " + std::to_string(threads));
            RealRun real(boundary);
            Wish wish;
            // With one thread, nobody else serves what blocks in flight hand over.
            runOnThreads(threads, [&] { real.run(wish); });
            EXPECT_GT(wish.threads.size(), 1u);
            std::set<std::thread::id> all;
            for (const auto& [buffer, ids] : wish.threads) {
                EXPECT_EQ(ids.size(), 1u) << "buffer " << buffer;
                all.insert(ids.begin(), ids.end());
            }
            EXPECT_EQ(all.size(), wish.threads.size()) << "buffers share a thread";
            EXPECT_EQ(all.count(std::this_thread::get_id()), 0u);
            EXPECT_EQ(wish.destroyed, 1);
        }
    }
}

TEST(RealDevice, DoesWithoutBuffersWhoseThreadsAreRefused)
{
    RealRun real(BoundaryMode::kHalo);
    Wish two;
    two.threadsBeforeRefusal = 2;
    const ScheduleRun report = real.run(two);
    EXPECT_TRUE(report.devices[0].failure.empty()) << report.devices[0].failure;
    EXPECT_EQ(report.devices[0].particles, problem().grid.particleCount());
    EXPECT_EQ(two.threads.size(), 2u);

    Wish none;
    none.threadsBeforeRefusal = 0;
    EXPECT_THROW(real.run(none), DeviceError);
    real.options.onFailure = DeviceFailure::kUseCpu;
    const ScheduleRun failed = real.run(none);
    EXPECT_NE(failed.devices[0].failure.find("no thread"), std::string::npos) << failed.devices[0].failure;
    EXPECT_EQ(failed.cpuParticles, problem().grid.particleCount());
    EXPECT_EQ(none.blocks, 0);
}

TEST(RealDevice, WhatItMeasuresIsReported)
{
    RealRun real(BoundaryMode::kHalo);
    Wish wish;
    wish.times = {0.25, 0.5, 0.125};
    const ScheduleRun report = real.run(wish);
    const DeviceRun& device = report.devices[0];
    ASSERT_GT(device.blocks, 3u);
    EXPECT_EQ(device.blocks, static_cast<std::uint64_t>(wish.blocks));
    // Results whose length is not known before are waited for twice; the search is in the first time.
    const double waits = device.uploadSeconds / 0.25;
    EXPECT_GE(waits, static_cast<double>(device.blocks));
    EXPECT_DOUBLE_EQ(device.busySeconds, 0.5 * waits);
    EXPECT_DOUBLE_EQ(device.downloadSeconds, 0.125 * waits);
    EXPECT_GT(device.bytesUp, 0u);
    EXPECT_GT(device.bytesDown, 0u);
    EXPECT_GT(device.peakBytes, 0u);
    EXPECT_LT(report.seconds, 0.5 * waits) << "the clock on the wall";
    EXPECT_GT(report.seconds, 0);
}

// The plan takes the device to be far faster than the CPU; what is measured says who takes the rest.
TEST(RealDevice, TakesWhatItsMeasuredSpeedIsWorth)
{
    const auto runWith = [](double seconds) {
        RealRun real(BoundaryMode::kHalo, 12);
        real.options.schedule.useCpu = true;
        real.devices[0].rates = {1e-9, 1e15, 1e18, 1e18};
        // Not measured in such a small run, where every block is in flight at once.
        if (seconds < 1) real.options.schedule.cpuTestsPerSecond = 1;
        Wish wish;
        wish.times.searchSeconds = seconds;
        return real.run(wish);
    };
    const ScheduleRun slow = runWith(100), fast = runWith(1e-9);
    EXPECT_LE(slow.devices[0].blocks, 5u) << "those that were in flight before anything was known";
    EXPECT_GT(slow.cpuParticles, problem().grid.particleCount() / 2);
    EXPECT_GT(fast.devices[0].blocks, 20u);
    EXPECT_EQ(fast.cpuParticles, fast.tooLargeQueries);
    EXPECT_LT(fast.tooLargeQueries, problem().grid.particleCount() / 10);
}

// While devices are opened nobody has been waiting for work: that time must not be made up for by the CPU.
TEST(RealDevice, TheTimeOfOpeningItIsNobodysWork)
{
    RealRun real(BoundaryMode::kHalo, 12);
    constexpr double kOpening = 0.4;
    real.options.schedule.useCpu = true;
    real.options.schedule.cpuTestsPerSecond =
        static_cast<double>(problem().estimate.total.candidateTests) / kOpening;
    real.devices[0].rates = {1e-9, 1e15, 1e18, 1e18};
    Wish wish;
    wish.opening = std::chrono::milliseconds(static_cast<int>(1e3 * kOpening));
    wish.times.searchSeconds = 1e-9;
    const ScheduleRun report = real.run(wish);
    EXPECT_GT(report.devices[0].particles, problem().grid.particleCount() / 2);
    EXPECT_GT(report.seconds, kOpening);
}

TEST(Dispatcher, ObservedRatesChangeWhoTakesTheNextBlock)
{
    std::vector<DeviceLimits> devices = {deviceOf(1000, 2)};
    devices[0].rates = {0, 1e6, 1e12, 1e12};
    ScheduleOptions options;
    options.cpuTestsPerSecond = 1e5;
    const auto dispatcher = [&] {
        Dispatcher made(devices, {1000}, options);
        std::vector<Dispatcher::Item> items;
        for (std::size_t b = 0; b < 6; ++b) items.push_back({b, 1'000'000, 0, {100, 100, 0}});
        made.setItems(items);
        EXPECT_EQ(made.next()->executor, 0) << "a tenth as fast, the CPU would end later";
        made.finish(0, 100);
        return made;
    };
    Dispatcher slow = dispatcher();
    slow.observe(0, 1, {0, 1e3, 1e12, 1e12}); // 1000 s a block, and 10 s on the CPU
    EXPECT_EQ(slow.next()->executor, Block::kOnCpu);
    Dispatcher same = dispatcher();
    same.observe(0, 1, devices[0].rates);
    EXPECT_EQ(same.next()->executor, 0);
    Dispatcher quickCpu = dispatcher();
    quickCpu.observe(0, 1, devices[0].rates);
    quickCpu.observeCpu(1, 0, 1e9);
    EXPECT_EQ(quickCpu.next()->executor, Block::kOnCpu);
    Dispatcher busyCpu = dispatcher();
    busyCpu.addCpuTests(2'000'000'000);
    busyCpu.observe(0, 1, devices[0].rates);
    busyCpu.observeCpu(1, 0, 1e9); // two seconds of work are open
    EXPECT_EQ(busyCpu.next()->executor, 0);
}

TEST(Dispatcher, MostBytesAreOfDevicesInUse)
{
    Dispatcher dispatcher({deviceOf(1000), deviceOf(1000)}, {300, 200}, {});
    EXPECT_EQ(dispatcher.mostBytes(), 300u);
    dispatcher.retire(0);
    EXPECT_EQ(dispatcher.mostBytes(), 200u);
    dispatcher.retire(1);
    EXPECT_EQ(dispatcher.mostBytes(), 0u);
}

// ---- runs that end early ---------------------------------------------------------------------------------------------

TEST(RealDevice, AnyExceptionOfABlockEndsTheRunAfterTheOthers)
{
    for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
        for (const int failing : {0, 1, 4}) {
            SCOPED_TRACE(std::string(boundaryModeName(boundary)) + " " + std::to_string(failing));
            RealRun real(boundary);
            real.options.onFailure = DeviceFailure::kUseCpu; // of a device, which this is not
            Wish wish;
            wish.sleep = std::chrono::milliseconds(5);
            wish.onSearch = [&](int number) {
                if (number == failing) throw std::runtime_error("not the device's");
            };
            EXPECT_THROW(real.run(wish), std::runtime_error);
            EXPECT_EQ(wish.destroyed, 1);
            EXPECT_FALSE(wish.wasInsideAtEnd);
            Wish sound;
            real.run(sound); // and the engine is as good as new
        }
    }
}

// The decider throws, not a job: other blocks in flight are still staged, and hand their boundary over.
TEST(RealDevice, AFailureThatStopsTheRunWaitsForTheOtherBlocks)
{
    for (const BoundaryMode boundary : {BoundaryMode::kCpu, BoundaryMode::kHalo}) {
        for (const int failing : {0, 1, 2, 3, 7}) {
            RealRun real(boundary);
            Wish wish;
            wish.sleep = std::chrono::milliseconds(failing);
            wish.onSearch = [&](int number) {
                if (number == failing) throw DeviceError("injected");
            };
            EXPECT_THROW(real.run(wish), DeviceError);
            EXPECT_EQ(wish.destroyed, 1);
            EXPECT_FALSE(wish.wasInsideAtEnd);
            real.options.onFailure = DeviceFailure::kUseCpu;
            Wish again;
            again.onSearch = wish.onSearch;
            const ScheduleRun report = real.run(again);
            EXPECT_NE(report.devices[0].failure.find("test, block "), std::string::npos);
            EXPECT_NE(report.devices[0].failure.find(": injected"), std::string::npos);
            EXPECT_GT(report.cpuParticles, 0u);
        }
    }
}

class StopsAfter final : public Progress {
public:
    explicit StopsAfter(int calls) : mLeft(calls) {}
    void update(const char*, double) override {}
    bool cancelled() const override { return mLeft-- <= 0; }
    int left() const { return mLeft; }

private:
    mutable std::atomic<int> mLeft;
};

TEST(RealDevice, CanBeCancelledAnywhere)
{
    RealRun real(BoundaryMode::kCpu);
    constexpr int kNever = 1 << 30;
    StopsAfter never(kNever);
    real.options.search.progress = &never;
    Wish all;
    real.run(all);
    const int calls = kNever - never.left();
    ASSERT_GT(calls, 50);
    for (int stop = 0; stop < calls * 9 / 10; stop += 1 + calls / 40) {
        StopsAfter progress(stop);
        real.options.search.progress = &progress;
        Wish wish;
        EXPECT_THROW(real.run(wish), Cancelled) << stop << " of " << calls;
        EXPECT_FALSE(wish.wasInsideAtEnd);
    }
    real.options.search.progress = nullptr;
    Wish sound;
    real.run(sound);
}

} // namespace

} // namespace vdb_nns::testing
