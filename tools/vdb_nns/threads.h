// The threads that a command may use.
#pragma once

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <utility>

namespace vdb_nns::cli {

constexpr int kMostThreads = 1024; ///< more than a machine has; an arena of a typo would take it down

/// An arena of a stated number of threads; what runs in it never uses more.
class ThreadLimit {
public:
    /// @param threads 0: all that the process may use.
    explicit ThreadLimit(int threads)
        : mCount(threads > 0 ? threads : tbb::info::default_concurrency()),
          mLimit(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(mCount)),
          mArena(mCount)
    {
    }

    int count() const { return mCount; }

    template <typename F>
    auto run(F&& work)
    {
        return mArena.execute(std::forward<F>(work));
    }

private:
    int mCount;
    tbb::global_control mLimit;
    tbb::task_arena mArena;
};

} // namespace vdb_nns::cli
