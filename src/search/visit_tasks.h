// A pass over all rows of a search that holds none of them.
#pragma once

#include "search/engine_state.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"
#include "util/isolate.h"

namespace vdb_nns {

// Runs all tasks of a part; makeCallback(run, state) is what takes the rows of a task, a RowCallback.
template <typename MakeCallback>
void visitTasks(EngineState& engine, const SearchRun& run, MakeCallback&& makeCallback)
{
    forEachTask(run.queries, run.candidates, run.pieces, engine.states, run.cancel,
                [&](ThreadState& state, const SearchTask& task) {
                    auto&& callback = makeCallback(run, state);
                    state.beginCallbacks(callback, task);
                    // Once a task, for the kernel calls the visitor too.
                    isolated([&] {
                        run.makeRows(RowKind::kVisit, task, state, state.visited);
                        state.flushRows();
                    });
                });
}

} // namespace vdb_nns
