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
#include "util/progress_share.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace vdb_nns {

// The search of one part of two sets: what all its tasks share. The sets outlive it.
struct SearchRun {
    const SparseGridData& queries;
    const SparseGridData& candidates;
    const SearchSetsData& sets;
    const SearchPart& part;
    const std::uint32_t firstRow; // SearchPart::firstRow
    SearchContext context;        // among the candidates of SearchPart::own
    std::vector<LayerRun> layers; // those, and the others; empty where there are no others
    ExactTest exact;
    const RowKernels& kernels;
    CancelCheck cancel;
    std::vector<Piece> pieces;

    // `options.radius` is not read.
    SearchRun(const SearchSetsData& searchSets, const SearchPart& searchPart, const SearchOptions& options);
    SearchRun(const SearchRun&) = delete; // the context points into it
    SearchRun& operator=(const SearchRun&) = delete;

    // Whether every particle is query and candidate and one radius serves all: what devices search.
    bool isPlain() const { return mIsPlain; }

    // Of a row that has so many entries, those that are left once it is cut to the nearest.
    std::uint32_t entriesKept(std::uint32_t slot, std::uint32_t entries) const;

    // Makes the rows of a task, to `sink`.
    void makeRows(RowKind kind, const SearchTask& task, ThreadState& state, RowSink& sink) const;

private:
    const bool mIsPlain;
};

// Whether every particle of a part is query and candidate, one radius serves all, and rows are whole and without the query.
bool isPlainSearch(const SearchSetsData& sets, const SearchPart& part, const SearchOptions& options);

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

    // What a pass over a part tells of a step: its share of `whole`, which may be null. `share` has it as long as it is used.
    Progress* progressOf(const SearchRun& run, Progress* whole, std::optional<ProgressShare>& share) const;

private:
    ProgressShare shareOf(const SearchPart& part, Progress& whole) const;

    const SearchSets mSets;
    std::vector<std::unique_ptr<ProgressShare>> mProgress; // of each part, if there are several
    std::vector<std::unique_ptr<SearchRun>> mRuns;
};

// What follows from the cells alone, on all layers.
struct ListWork {
    std::uint64_t candidateTests = 0; // queries times the particles of the cells in their reach
    std::uint64_t maskBytes = 0;      // of mask rows
};
ListWork listWork(const SearchRun& run, const SearchTask& task);
// Of all tasks. `progress` is told of `step`; may be null.
ListWork countListWork(const SearchRuns& runs, Progress* progress, const char* step);

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
    PageArray<char> positions[2];      // of candidates and queries, for measures
    PageArray<char> clusters[2];       // 4 bytes a particle each
    std::vector<std::shared_ptr<PageBlock>>
        results; // of measures; those that nobody else holds are used again

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
