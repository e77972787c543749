// What a search sees of the sparse grid: plain pointers, trivially copyable. Any compiler.
//
//   slot        0        1        2        3        4 ...            particles, by leaf, then cell, then number
//   x y z     [float]  ...                                           about the centre of the slot's leaf, in cells
//   number    [u32]    ...                                           the caller's number of the particle
//   leaves    [firstSlot firstCell occupancy*] ... [end end null]    one more than there are leaves
//   cellStart [firstSlot of each occupied cell] ... [end]            leaf after leaf, one more than occupied cells
//
// Occupancy: bit (y * 8 + z) of word x. The k-th set bit of a leaf is its cell firstCell + k.
#pragma once

#include <cstdint>

namespace vdb_nns {

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

} // namespace vdb_nns
