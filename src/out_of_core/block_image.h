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
#include "plan/block_halo.h"
#include "shared/block_view.h"
#include "vdb_nns/planning/workload_tree.h"
#include "vdb_nns/search_options.h"

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

// Bytes of the image of a part: BlockBytes::up of its block.
std::uint64_t imageBytes(const SparseGridData& grid, const BlockPart& part);

// Writes the image to `staging`, with the addresses that it has once it is at `device`. Both are aligned to 16 bytes.
BlockImage writeImage(const SparseGridData& grid, const BlockPart& part, std::byte* staging,
                      std::byte* device);

} // namespace vdb_nns
