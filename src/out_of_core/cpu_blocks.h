// The share of TBB workers in a run: blocks, and boundary regions of blocks that devices have, as jobs; and how long these
// took. Makes rows where the plain search makes them. Knows the grid and blocks; nothing of devices and of who decides.
//
// Threads: start() and stage() only add jobs, and any thread may call them, the job of a block in flight too; jobs run on any thread of the
// arena, and the counters they add to are atomic.
#pragma once

#include "cpu/search_task.h"
#include "lists/neighbor_lists_data.h"
#include "out_of_core/block_split.h"
#include "out_of_core/job_queue.h"
#include "out_of_core/run_progress.h"
#include "search/engine_state.h"

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// Where TBB workers put what they find, and tell so.
struct CpuTargets {
    EngineState& engine;
    NeighborListsData& lists;
    ChunkPool& pool;
    RunProgress& progress;
};

// What jobs have done, all workers together.
struct CpuWork {
    std::uint64_t tests = 0;
    double seconds = 0;
};

class CpuBlocks {
public:
    // All of it outlives the jobs of `jobs`, and so does this.
    CpuBlocks(const SearchRun& run, const CpuTargets& targets, JobQueue& jobs)
        : mRun(run), mTargets(targets), mJobs(jobs)
    {
    }

    // All queries of a block but those that others have.
    void start(const PendingBlock& block);
    // Makes the halo of a block, or starts its boundary region here. Once for a block, whoever runs it then.
    void stage(PendingBlock& block);

    CpuWork work() const { return {mTests, 1e-9 * static_cast<double>(mNanoseconds)}; }

private:
    // Runs a job that returns how many queries it ran.
    template <typename Job>
    void timeJob(double testsPerQuery, Job&& job);
    std::uint64_t runPieces(std::size_t block, std::size_t first, std::size_t end, const BlockPart& part);
    std::uint64_t runBoundaryLeaf(std::size_t block, const CellSet& cells, std::uint32_t firstSlot,
                                  std::uint32_t endSlot);
    std::uint64_t runTask(std::size_t block, const SearchTask& task);

    const SearchRun& mRun;
    const CpuTargets mTargets;
    JobQueue& mJobs;
    std::atomic<std::uint64_t> mTests{0}, mNanoseconds{0};
};

} // namespace vdb_nns
