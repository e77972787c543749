// A block as it travels to a device: its leaves and the halo, sorted by cell as the grid holds them, in one piece of memory
// with the addresses that it will have there. May know the grid; nothing of devices.
//
//   leaves       [LeafRecord]  own ones, then the halo's; the end
//   occupancy    [8 words]     of each leaf; of the halo only the cells in reach
//   cells        [8 words]     of each own leaf that has queries left to others: the cells whose queries are wanted
//   x y z [16 zeros] number    by slot of the block: own particles, then the halo's
//   cellStart    [slot]        of each occupied cell; the end
//   neighborhood [27 leaves, cells]  of each own leaf; kNoLeaf where there is none, and where all its cells are wanted
#pragma once

#include "grid/sparse_grid_data.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/workload_tree.h"
#include "workload/block_halo.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

// What is asked of an executor at once: the queries [firstSlot, endSlot) of some leaves.
struct BlockPart {
    std::uint32_t firstLeaf = 0, endLeaf = 0;
    std::uint32_t firstSlot = 0, endSlot = 0;
    std::vector<CellSet> halo;    // by leaf: occupied cells outside that are sent too
    std::vector<CellSet> without; // by leaf: own cells whose queries are not wanted
};

struct BlockImage {
    static constexpr int kNeighborhoodSize = 28;

    BlockView block;
    std::uint32_t leaves;               // own ones
    std::uint32_t firstQuery, endQuery; // slots of the block
    const std::uint32_t* neighborhoods;
    const std::uint64_t* cells;
    std::uint64_t bytes;

    // The cells of an own leaf whose queries are wanted; null for all.
    const std::uint64_t* cellsOf(std::uint32_t leaf) const
    {
        const std::uint32_t set = neighborhoods[leaf * kNeighborhoodSize + 27];
        return set == kNoLeaf ? nullptr : cells + std::size_t(set) * 8;
    }
};

// Bytes of the image of a part: BlockBytes::up of its block.
std::uint64_t imageBytes(const SparseGridData& grid, const BlockPart& part);

// Writes the image to `staging`, with the addresses that it has once it is at `device`. Both are aligned to 16 bytes.
BlockImage writeImage(const SparseGridData& grid, const BlockPart& part, std::byte* staging,
                      std::byte* device);

// The start of a block's result. Behind it, without padding: with masks, where the rows of each own leaf begin, in words, 64
// bits each; the counts of the queries; the rows, in the order of the queries. Cells that are not wanted have counts of 0
// and no rows.
struct ResultHead {
    std::uint64_t pairs;
    std::uint64_t rowBytes;              // of all rows, those that found no room included
    std::uint64_t bandPairs, exactPairs; // for SearchStatistics
};

// Where the parts of a result stand, in bytes from its begin.
struct ResultLayout {
    std::uint64_t leafRows, counts, rows;
};
ResultLayout resultLayout(const BlockImage& image, Encoding encoding);

} // namespace vdb_nns
