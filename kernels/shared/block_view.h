// What a search sees of the sparse grid, or of a block of it: plain pointers, trivially copyable. Any compiler.
//
//   slot        0        1        2        3        4 ...            particles, by leaf, then cell, then number
//   x y z     [float]  ...                                           about the centre of the slot's leaf, in cells
//   number    [u32]    ...                                           the caller's number of the particle
//   leaves    [firstSlot firstCell occupancy*] ... [end end null]    one more than there are leaves
//   cellStart [firstSlot of each occupied cell] ... [end]            leaf after leaf, one more than occupied cells
//
// Occupancy: bit (y * 8 + z) of word x. The k-th set bit of a leaf is its cell firstCell + k.
#pragma once

#include "shared/annotation.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {

constexpr std::uint32_t kNoLeaf = 0xffffffffu;
constexpr int kLeavesAround = 27; // a leaf and those that touch it, by (dx, dy, dz) lexicographic
constexpr int kOwnLeaf = 13;      // which of them is the leaf itself

struct LeafRecord {
    std::uint32_t firstSlot;        // slot of its first particle; those of the next leaf follow
    std::uint32_t firstCell;        // its first entry in cellStart; those of the next leaf follow
    const std::uint64_t* occupancy; // 8 words
};

struct BlockView {
    const float* x;
    const float* y;
    const float* z;
    const std::uint32_t* number;
    const LeafRecord* leaves;
    const std::uint32_t* cellStart;
    int reach; // cells that the radius spans, 1 to 3
};

// A block as a device holds it: own leaves, then the halo's. See src/out_of_core/block_image.h for how it stands in memory.
struct BlockImage {
    static constexpr int kNeighborhoodSize = kLeavesAround + 1; // and which of its cells are wanted

    BlockView block;
    std::uint32_t leaves;               // own ones
    std::uint32_t firstQuery, endQuery; // slots of the block
    const std::uint32_t* neighborhoods;
    const std::uint64_t* cells;
    std::uint64_t bytes;

    // The cells of an own leaf whose queries are wanted; null for all.
    VDB_NNS_HOST_DEVICE const std::uint64_t* cellsOf(std::uint32_t leaf) const
    {
        const std::uint32_t set = neighborhoods[std::size_t(leaf) * kNeighborhoodSize + kLeavesAround];
        return set == kNoLeaf ? nullptr : cells + std::size_t(set) * 8;
    }
};

} // namespace vdb_nns
