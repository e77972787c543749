// Jobs of the arena and of threads beside it: all are run, on any number of threads; errors and the end drop what has not
// begun, and wait for what has.
#include "agreement/point_views.h"
#include "out_of_core/job_queue.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>

namespace vdb_nns::testing {

namespace {

// A thread beside the arena has no workers to spawn to: with one thread in all, the owner must serve its jobs.
TEST(JobQueue, RunsWhatThreadsBesideTheArenaAdd)
{
    for (const int threads : {1, 2, 5}) {
        for (int round = 0; round < 50; ++round) {
            std::atomic<int> ran{0};
            runOnThreads(threads, [&] {
                JobQueue jobs;
                const std::size_t thread = jobs.addThread();
                jobs.addTo(thread, [&] {
                    for (int k = 0; k < 10; ++k) jobs.add([&] { ++ran; });
                });
                jobs.add([&] { jobs.add([&] { ++ran; }); });
                jobs.runAll();
                EXPECT_EQ(ran, 11);
            });
        }
    }
}

TEST(JobQueue, WaitsAtItsEndForWhatHasBegunAndDropsTheRest)
{
    for (int round = 0; round < 20; ++round) {
        std::atomic<int> begun{0}, ended{0}, late{0};
        {
            JobQueue jobs;
            const std::size_t thread = jobs.addThread();
            std::atomic<bool> isEnding{false};
            jobs.addTo(thread, [&] {
                ++begun;
                while (!isEnding) std::this_thread::yield();
                std::this_thread::sleep_for(std::chrono::milliseconds(2));
                jobs.add([&] { ++late; }); // the queue is at its end
                ++ended;
            });
            jobs.addTo(thread, [&] { ++late; });
            while (begun == 0) std::this_thread::yield();
            isEnding = true;
        }
        EXPECT_EQ(ended, 1);
        EXPECT_EQ(late, 0);
    }
}

TEST(JobQueue, AnErrorOfAnyJobIsThrownAndNoMoreBegin)
{
    for (const bool beside : {false, true}) {
        JobQueue jobs;
        const std::size_t thread = jobs.addThread();
        const auto fails = [] { throw std::runtime_error("job"); };
        if (beside) {
            jobs.addTo(thread, fails);
        } else {
            jobs.add(fails);
        }
        EXPECT_THROW(jobs.runUntil([] { return false; }), std::runtime_error);
        std::atomic<int> late{0};
        jobs.add([&] { ++late; });
        jobs.addTo(thread, [&] { ++late; });
        EXPECT_THROW(jobs.runAll(), std::runtime_error);
        EXPECT_EQ(late, 0);
    }
}

} // namespace

} // namespace vdb_nns::testing
