// What a SearchEngine keeps between runs, and the steps that every way of running a search shares: whether lists fit, and
// what follows once all rows are there.
#pragma once

#include "cpu/kernels.h"
#include "cpu/search_task.h"
#include "exact/exact_test.h"
#include "grid/sparse_grid_data.h"
#include "lists/neighbor_lists_data.h"
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

// One search: what all its tasks share. The particles whose neighbors are wanted, and those among which they are
// looked for, are two sets of points on one lattice.
struct SearchRun {
    const SparseGridData& queries;
    const SparseGridData& candidates;
    const double radius; // world units, at most the lattice's
    SearchContext context;
    ExactTest exact;
    const Kernels& kernels;
    CancelCheck cancel;
    std::vector<Piece> pieces;

    // Throws InvalidInput for sets that share no lattice, and for a radius above the lattice's.
    SearchRun(const SparseGridData& queries, const SparseGridData& candidates, const SearchOptions& options);
    SearchRun(const SearchRun&) = delete; // the context points into it
    SearchRun& operator=(const SearchRun&) = delete;

    // The kernel that makes rows of an encoding.
    SearchTaskFunction rowKernel(Encoding encoding) const;
};

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
    void runTask(const SearchRun& run, SearchTaskFunction kernel, ThreadState& state, const SearchTask& task);

    // Empty lists of a grid and a radius, in the memory of the last ones where nobody else reads those.
    std::shared_ptr<NeighborListsData> beginLists(const SparseGrid& grid, double radius, Encoding encoding);
    // Makes the arrays by slot, and hands what lists may use beside `otherBytes` of the run to `pool`. Returns those bytes; 0
    // without lists. Throws CapacityError.
    std::uint64_t allowRows(const SearchRun& run, const SearchOptions& options, std::uint64_t otherBytes,
                            NeighborListsData& result, ChunkPool& pool);
    // The rows of a task, in its encoding, to memory of `pool`. Throws ChunkPool::Exhausted.
    void makeRows(const SearchRun& run, const SearchTask& task, ThreadState& state, ChunkPool& pool,
                  NeighborListsData& result);
    // Once all rows are made: statistics, the order of mask rows, the way from a particle's number to its slot.
    void finishLists(const SearchRun& run, ChunkPool& pool, NeighborListsData& result);

private:
    void checkCapacity(const SearchRun& run, Encoding encoding, std::uint64_t allowed, std::uint32_t* counts);
};

struct SearchEngine::Impl : EngineState {};

} // namespace vdb_nns
