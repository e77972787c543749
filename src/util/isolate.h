// Keeps the parallel work of the library and that of its callers apart.
//
// A thread that waits for a parallel loop takes other tasks meanwhile. Were these a caller's, a thread inside of an engine
// could enter the same engine again; were they ours while a visitor waits for a loop of its own, a thread could begin another
// task with the scratch memory of the one that it is in. So every entry of the library that runs parallel loops is isolated,
// and so is every call of the caller's code from inside of them. What is called meanwhile holds no lock.
#pragma once

#include <tbb/task_arena.h>

#include <utility>

namespace vdb_nns {

// Returns f(). As long as it runs, its thread takes no tasks but those that f made.
template <typename F>
auto isolated(F&& f) -> decltype(f())
{
    return tbb::this_task_arena::isolate(std::forward<F>(f));
}

} // namespace vdb_nns
