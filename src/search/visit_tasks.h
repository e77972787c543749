// A pass over all rows of a search that holds none of them.
#pragma once

#include "search/engine_state.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"
#include "util/isolate.h"

namespace vdb_nns {

// Runs all tasks of a part; makeCallback(run, task, state) is what takes the rows of a task, a RowCallback. `kind`: kVisit, or kSmaller
// or kHalf where the run has a kernel for it.
template <typename MakeCallback>
void visitTasks(EngineState& engine, const SearchRun& run, RowKind kind, MakeCallback&& makeCallback)
{
    forEachTask(run.queries, run.candidates, run.pieces, engine.states, run.cancel,
                [&](ThreadState& state, const SearchTask& task) {
                    auto&& callback = makeCallback(run, task, state);
                    const auto makeRows = [&](RowKind ofKind) {
                        state.beginCallbacks(callback, task, ofKind, run.queries.number.data());
                        run.makeRows(ofKind, task, state, state.visited);
                        state.flushRows();
                    };
                    // Once a task, for the kernel calls the visitor too.
                    isolated([&] {
                        const TaskStatistics before = state.statistics;
                        const std::uint64_t exactBefore = state.exactPairs;
                        makeRows(kind);
                        if (callback.finish()) return;
                        state.statistics = before;
                        state.exactPairs = exactBefore;
                        makeRows(RowKind::kVisit);
                    });
                });
}

} // namespace vdb_nns
