// Jobs on the caller's TBB arena, and a way to wait for some of them that works on others meanwhile. Jobs that sleep most of
// their time, while a device works, have threads of their own.
//
// Threads: the one that makes the queue, in whose arena jobs run, calls addThread(), addTo(), runUntil() and the destructor.
// add() may be called by any job. A thread outside of the arena must not spawn there: TBB would put the task into an arena of
// that thread, which nobody may ever serve. So what such a thread adds is spawned by the owner, who is waiting.
#pragma once

#include <tbb/task_group.h>

#include <algorithm>
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

    // Drops jobs that have not begun, also those that running jobs still add, and waits for those that have.
    ~JobQueue()
    {
        {
            const std::lock_guard<std::mutex> lock(mMutex);
            mEnding = true;
            dropJobs();
            mChanged.notify_all();
        }
        for (DeviceThread& worker : mDeviceThreads) worker.handle.join();
        mGroup.wait();
    }

    // Jobs may add jobs.
    void add(std::function<void()> job)
    {
        {
            const std::lock_guard<std::mutex> lock(mMutex);
            if (mError || mEnding) return;
            mJobs.push_back(std::move(job));
            ++mOpen;
            if (isDeviceThread()) {
                ++mUnspawned;
                mChanged.notify_all();
                return;
            }
        }
        spawn();
    }

    // Starts a thread, which runs the jobs of addTo() one after the other. Returns its number.
    std::size_t addThread()
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        DeviceThread& worker = mDeviceThreads.emplace_back();
        try {
            worker.handle = std::thread([this, &worker] { serve(worker); });
        } catch (...) {
            mDeviceThreads.pop_back(); // nothing to join
            throw;
        }
        return mDeviceThreads.size() - 1;
    }

    void addTo(std::size_t thread, std::function<void()> job)
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        if (mError || mEnding) return;
        mDeviceThreads[thread].jobs.push_back(std::move(job));
        ++mOpen;
        mChanged.notify_all();
    }

    // Returns once done() is true, which is asked whenever a job has ended. Throws what a job threw; then no more begin.
    template <typename Done>
    void runUntil(Done&& done)
    {
        for (;;) {
            std::function<void()> job;
            std::size_t unspawned = 0;
            {
                std::unique_lock<std::mutex> lock(mMutex);
                while (!mError && !done() && mJobs.empty()) mChanged.wait(lock);
                if (mError) std::rethrow_exception(mError);
                unspawned = std::exchange(mUnspawned, 0);
                if (!done()) {
                    job = std::move(mJobs.front());
                    mJobs.pop_front();
                }
            }
            for (; unspawned > 0; --unspawned) spawn();
            if (!job) return;
            run(job);
        }
    }

    void runAll()
    {
        runUntil([this] { return mOpen == 0; });
    }

private:
    struct DeviceThread {
        std::thread handle;
        std::deque<std::function<void()>> jobs;
    };

    void serve(DeviceThread& worker)
    {
        for (;;) {
            std::function<void()> job;
            {
                std::unique_lock<std::mutex> lock(mMutex);
                while (!mEnding && worker.jobs.empty()) mChanged.wait(lock);
                if (worker.jobs.empty()) return;
                job = std::move(worker.jobs.front());
                worker.jobs.pop_front();
            }
            run(job);
        }
    }

    // A task for a worker. It takes whatever there is: jobs of other threads may wait to be spawned.
    void spawn()
    {
        mGroup.run([this] {
            std::function<void()> next;
            while (take(next)) run(next);
        });
    }

    // The caller is not of the arena. Under the lock.
    bool isDeviceThread() const
    {
        return std::any_of(mDeviceThreads.begin(), mDeviceThreads.end(), [](const DeviceThread& worker) {
            return worker.handle.get_id() == std::this_thread::get_id();
        });
    }

    // Under the lock.
    void dropJobs()
    {
        mJobs.clear();
        for (DeviceThread& worker : mDeviceThreads) worker.jobs.clear();
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
        if (mError) dropJobs();
        --mOpen;
        mChanged.notify_all();
    }

    std::mutex mMutex;
    std::condition_variable mChanged;
    std::deque<std::function<void()>> mJobs; // not begun
    std::deque<DeviceThread> mDeviceThreads; // stay where they are
    bool mEnding = false;
    std::size_t mOpen = 0;      // not ended
    std::size_t mUnspawned = 0; // jobs that no task of the arena was made for
    std::exception_ptr mError;
    tbb::task_group mGroup;
};

} // namespace vdb_nns
