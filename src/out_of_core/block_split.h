// What is left of a block of the schedule while a run goes on, and how a block that is too large falls apart. Pure functions
// of the grid, the memory model and what is known of the block: nothing runs here, nothing is kept. Knows no devices but the
// bytes that the largest of them offers.
#pragma once

#include "grid/sparse_grid_data.h"
#include "out_of_core/block_image.h"
#include "plan/dispatcher.h"
#include "vdb_nns/planning/schedule.h"

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace vdb_nns {

// All of a block of the schedule, or a part of it after a split.
struct PendingBlock {
    std::size_t block = 0; // of the schedule
    Dispatcher::Item item;
    BlockPart part;
    int log2Cells = 0;
    bool withHalo = true;
    bool isStaged = false; // the part's halo is made, or its boundary region handed to TBB workers
    double expectedPairs = 0;
    double undecidedPerQuery = 0; // pairs, where known from an overflow

    // Those that others have included.
    std::uint64_t queries() const { return part.endSlot - part.firstSlot; }
    // TBB workers have the queries outside of it now.
    void leaveOutside() { item.tests -= std::exchange(item.outsideTests, 0); }
};

// The blocks of a schedule, none of them staged. Throws InvalidInput for a schedule of another grid.
std::vector<PendingBlock> pendingBlocksOf(const SparseGridData& grid, const Schedule& schedule);

// Makes the halo of a block, or finds the cells whose queries are left to TBB workers. Not for a block that is staged.
void makeHalo(const SparseGridData& grid, PendingBlock& block);

// The cells of a leaf whose queries a part has, in `cells`; null where it has all of them.
const std::uint64_t* wantedCells(const SparseGridData& grid, const BlockPart& part, std::uint32_t leaf,
                                 std::uint64_t (&cells)[8]);

// Queries of a part, without those that others have.
std::uint64_t wantedQueries(const SparseGridData& grid, const BlockPart& part);

// Neighbors of queries, by slot of the grid, where an overflow has told them.
struct KnownCounts {
    const std::uint32_t* count = nullptr; // null: nothing is known
    std::uint32_t firstSlot = 0;

    std::uint64_t sum(std::uint32_t begin, std::uint32_t end) const;
};

// What becomes of a block.
struct BlockSplit {
    std::vector<PendingBlock> parts;    // for devices, with their halo; the last one is next
    std::vector<PendingBlock> tooLarge; // for TBB workers: no smaller parts are made, and no device has room
};

// Two halves of a block, and halves of those where what is known says that they do not fit either: between leaves as long as
// there are several, then between the queries of a leaf, down to Block::kFewestQueries. A block with as few stays one part.
// `mostBytes`: the most that a device in use has for a block; 0 where there is none, and then nothing needs to fit. The block
// is staged.
BlockSplit splitBlock(const SparseGridData& grid, const MemoryModel& model, const PendingBlock& whole,
                      const KnownCounts& counts, std::uint64_t mostBytes);

} // namespace vdb_nns
