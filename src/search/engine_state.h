// What a SearchEngine keeps between runs, and the steps that every way of running a search shares: whether lists fit, and
// what follows once all rows are there.
#pragma once

#include "cpu/kernels.h"
#include "cpu/search_task.h"
#include "exact/exact_test.h"
#include "grid/search_sets_data.h"
#include "lists/neighbor_lists_data.h"
#include "search/layered_rows.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"
#include "shared/block_device.h"
#include "util/cancel.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns {

// The search of one part of two sets: what all its tasks share. The sets outlive it.
struct SearchRun {
    const SparseGridData& queries;
    const SparseGridData& candidates;
    const SearchPart& part;
    const std::uint32_t firstRow; // SearchPart::firstRow
    SearchContext context;        // among the candidates of SearchPart::own
    std::vector<LayerRun> layers; // those, and the others; empty where there are no others
    ExactTest exact;
    const RowKernels& kernels;
    CancelCheck cancel;
    std::vector<Piece> pieces;

    // `options.radius` is not read.
    SearchRun(const SearchSetsData& sets, const SearchPart& part, const SearchOptions& options);
    SearchRun(const SearchRun&) = delete; // the context points into it
    SearchRun& operator=(const SearchRun&) = delete;

    // Whether every particle is query and candidate and one radius serves all: what devices search.
    bool isPlain() const { return mIsPlain; }

    // Makes the rows of a task, to `sink`. What mustn't be streamed past the caches may go there too, where a part has layers.
    void makeRows(RowKind kind, const SearchTask& task, ThreadState& state, RowSink& sink) const;

private:
    const bool mIsPlain;
};

// All parts of two sets.
class SearchRuns {
public:
    SearchRuns(const SearchSets& sets, const SearchOptions& options);

    const SearchSets& sets() const { return mSets; }
    std::size_t size() const { return mRuns.size(); }
    const SearchRun& operator[](std::size_t part) const { return *mRuns[part]; }
    // Queries that have a row.
    std::uint64_t rowCount() const { return mSets.data().rowCount(); }

    // f(run) for each part.
    template <typename F>
    void forEach(F&& f) const
    {
        for (const std::unique_ptr<SearchRun>& run : mRuns) f(*run);
    }

private:
    class PartProgress;
    struct Deleter {
        void operator()(PartProgress* progress) const;
    };

    const SearchSets mSets;
    std::vector<std::unique_ptr<PartProgress, Deleter>> mProgress; // each part's share of the whole
    std::vector<std::unique_ptr<SearchRun>> mRuns;
};

// What follows from the cells alone, on all layers.
struct ListWork {
    std::uint64_t candidateTests = 0; // queries times the particles of the cells in their reach
    std::uint64_t maskBytes = 0;      // of mask rows
};
ListWork listWork(const SearchRun& run, const SearchTask& task);
// Of all tasks.
ListWork countListWork(const SearchRuns& runs);

// Throws InvalidInput.
void checkOptions(const SearchOptions& options);

CapacityError listsDoNotFit(Encoding encoding, bool counted, std::uint64_t needed, std::uint64_t allowed);

// A device that was opened for a run, with the memory that it took.
struct OpenedDevice {
    DeviceLimits limits;
    std::unique_ptr<BlockDevice> device;
    std::uint64_t hostBytes; // staging memory that it holds
};

struct EngineState {
    GridScratch scratch;
    std::shared_ptr<SparseGridData> grid;
    std::shared_ptr<NeighborListsData> lists;
    ThreadStates states;
    SearchStatistics statistics;
    std::vector<OpenedDevice> devices; // of the last run on devices; not the simulated ones

    void beginStatistics(const SearchOptions& options);
    TaskStatistics sumStatistics();

    // Empty lists of two sets, in the memory of the last ones where nobody else reads those. `options`: what rows are cut to.
    std::shared_ptr<NeighborListsData> beginLists(const SearchSets& sets, Encoding encoding,
                                                  const SearchOptions& options);
    // Makes the arrays by slot, and hands what lists may use beside `otherBytes` of the run to `pool`. Returns those bytes; 0
    // without lists. Throws CapacityError.
    std::uint64_t allowRows(const SearchRuns& runs, const SearchOptions& options, std::uint64_t otherBytes,
                            NeighborListsData& result, ChunkPool& pool);
    // The rows of a task, in its encoding, to memory of `pool`. Throws ChunkPool::Exhausted.
    void makeRows(const SearchRun& run, const SearchTask& task, ThreadState& state, ChunkPool& pool,
                  NeighborListsData& result);
    // Once all rows are made: statistics, the order of mask rows, the way from a particle's number to its slot.
    void finishLists(const SearchRuns& runs, ChunkPool& pool, NeighborListsData& result);

private:
    void checkCapacity(const SearchRuns& runs, Encoding encoding, std::uint64_t allowed,
                       std::uint32_t* counts);
};

struct SearchEngine::Impl : EngineState {};

} // namespace vdb_nns
