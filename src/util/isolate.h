// Keeps the parallel work of the library and that of its callers apart.
//
// A thread that waits for a parallel loop takes other tasks meanwhile. Were these a caller's, a thread inside of an engine
// could enter the same engine again; were they ours while a visitor waits for a loop of its own, a thread could begin another
// task with the scratch memory of the one that it is in. So every entry of the library that runs parallel loops is isolated,
// and so is every call of the caller's code from inside of them. What is called meanwhile holds no lock.
//
// A host program may flush denormal numbers to zero, or round in another direction. Tasks take over the mode that their context was made
// with, whichever thread runs them: an entry that computes has a context of its own, in IeeeMode.
#pragma once

#include "util/ieee_mode.h"

#include <tbb/task_arena.h>
#include <tbb/task_group.h>

#include <optional>
#include <type_traits>
#include <utility>

namespace vdb_nns {

// Returns f(). As long as it runs, its thread takes no tasks but those that f made.
template <typename F>
auto isolated(F&& f) -> decltype(f())
{
    return tbb::this_task_arena::isolate(std::forward<F>(f));
}

// The same, and all tasks of f compute in IeeeMode. A caller that cancels tasks of its own does not cancel those of f.
template <typename F>
auto isolatedIeee(F&& f) -> decltype(f())
{
    using Context = tbb::task_group_context;
    using Result = decltype(f());
    const auto run = [](auto&& work) {
        tbb::this_task_arena::isolate([&] {
            const IeeeMode mode;
            Context context(Context::isolated, Context::default_traits | Context::fp_settings);
            tbb::task_group(context).run_and_wait(work);
        });
    };
    if constexpr (std::is_void_v<Result>) {
        run(f);
    } else {
        std::optional<Result> result;
        run([&] { result.emplace(f()); });
        return std::move(*result);
    }
}

} // namespace vdb_nns
