// Jobs on the caller's TBB arena, and a way to wait for some of them that works on others meanwhile. Jobs that sleep most of
// their time, while a device works, have threads of their own.
#pragma once

#include <tbb/task_group.h>

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace vdb_nns {

class JobQueue {
public:
    JobQueue() = default;
    JobQueue(const JobQueue&) = delete;
    JobQueue& operator=(const JobQueue&) = delete;

    // Drops jobs that have not begun, and waits for those that have.
    ~JobQueue()
    {
        {
            const std::lock_guard<std::mutex> lock(mMutex);
            mJobs.clear();
            for (Sleeper& sleeper : mSleepers) sleeper.jobs.clear();
            mEnding = true;
            mChanged.notify_all();
        }
        mGroup.wait();
        for (Sleeper& sleeper : mSleepers) sleeper.thread.join();
    }

    // Jobs may add jobs. Thread-safe.
    void add(std::function<void()> job)
    {
        {
            const std::lock_guard<std::mutex> lock(mMutex);
            if (mError) return;
            mJobs.push_back(std::move(job));
            ++mOpen;
        }
        mGroup.run([this] {
            std::function<void()> next;
            if (take(next)) run(next);
        });
    }

    // Starts a thread, which runs the jobs of addTo() one after the other. Returns its number.
    std::size_t addThread()
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        Sleeper& sleeper = mSleepers.emplace_back();
        sleeper.thread = std::thread([this, &sleeper] { serve(sleeper); });
        return mSleepers.size() - 1;
    }

    void addTo(std::size_t thread, std::function<void()> job)
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        if (mError) return;
        mSleepers[thread].jobs.push_back(std::move(job));
        ++mOpen;
        mChanged.notify_all();
    }

    // Returns once done() is true, which is asked whenever a job has ended. Throws what a job threw; then no more begin.
    template <typename Done>
    void runUntil(Done&& done)
    {
        for (;;) {
            std::function<void()> job;
            {
                std::unique_lock<std::mutex> lock(mMutex);
                while (!mError && !done() && mJobs.empty()) mChanged.wait(lock);
                if (mError) std::rethrow_exception(mError);
                if (done()) return;
                job = std::move(mJobs.front());
                mJobs.pop_front();
            }
            run(job);
        }
    }

    void runAll()
    {
        runUntil([this] { return mOpen == 0; });
    }

private:
    struct Sleeper {
        std::thread thread;
        std::deque<std::function<void()>> jobs;
    };

    void serve(Sleeper& sleeper)
    {
        for (;;) {
            std::function<void()> job;
            {
                std::unique_lock<std::mutex> lock(mMutex);
                while (!mEnding && sleeper.jobs.empty()) mChanged.wait(lock);
                if (sleeper.jobs.empty()) return;
                job = std::move(sleeper.jobs.front());
                sleeper.jobs.pop_front();
            }
            run(job);
        }
    }

    bool take(std::function<void()>& job)
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        if (mJobs.empty()) return false;
        job = std::move(mJobs.front());
        mJobs.pop_front();
        return true;
    }

    void run(const std::function<void()>& job)
    {
        std::exception_ptr error;
        try {
            job();
        } catch (...) {
            error = std::current_exception();
        }
        const std::lock_guard<std::mutex> lock(mMutex);
        if (error && !mError) mError = error;
        if (mError) {
            mJobs.clear();
            for (Sleeper& sleeper : mSleepers) sleeper.jobs.clear();
        }
        --mOpen;
        mChanged.notify_all();
    }

    std::mutex mMutex;
    std::condition_variable mChanged;
    std::deque<std::function<void()>> mJobs; // not begun
    std::deque<Sleeper> mSleepers;           // stay where they are
    bool mEnding = false;
    std::size_t mOpen = 0; // not ended
    std::exception_ptr mError;
    tbb::task_group mGroup;
};

} // namespace vdb_nns
