// A pass over all rows of a search that holds none of them.
#pragma once

#include "search/engine_state.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"
#include "util/isolate.h"

namespace vdb_nns {

// Runs all tasks of a part; makeCallback(run, state) is what takes the rows of a task, a RowCallback. `kind`: kVisit, or kSmaller
// where the run has a kernel for it.
template <typename MakeCallback>
void visitTasks(EngineState& engine, const SearchRun& run, RowKind kind, MakeCallback&& makeCallback)
{
    forEachTask(run.queries, run.candidates, run.pieces, engine.states, run.cancel,
                [&](ThreadState& state, const SearchTask& task) {
                    auto&& callback = makeCallback(run, state);
                    state.beginCallbacks(callback, task, kind, run.queries.number.data());
                    // Once a task, for the kernel calls the visitor too.
                    isolated([&] {
                        run.makeRows(kind, task, state, state.visited);
                        state.flushRows();
                    });
                });
}

} // namespace vdb_nns
