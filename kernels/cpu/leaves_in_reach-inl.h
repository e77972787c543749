// Which of the 27 leaves around a leaf some of its cells reach: on sparse scenes few, and the others need not be read.
// Internal linkage; see simd.h.
#pragma once

#include "shared/block_view.h"

#include <cstdint>

namespace vdb_nns {
namespace {

constexpr std::uint32_t kOwnLeafAlone = 1u << kOwnLeaf;

// Of the leaves around, as in LeafNeighborhood, those that hold cells within `reach` cells of `cells`: 8 words of bits as in
// LeafRecord::occupancy.
inline std::uint32_t leavesInReach(const std::uint64_t* cells, int reach)
{
    constexpr std::uint64_t kAll = ~std::uint64_t(0);
    const std::uint64_t lowZ = 0x0101010101010101u * ((1u << reach) - 1), highZ = lowZ << (8 - reach);
    const std::uint64_t lowY = kAll >> 8 * (8 - reach), highY = kAll << 8 * (8 - reach);
    std::uint64_t slabs[3] = {}; // of the cells that reach the leaves below, any, above in x
    for (int x = 0; x < 8; ++x) {
        slabs[1] |= cells[x];
        if (x < reach) slabs[0] |= cells[x];
        if (x >= 8 - reach) slabs[2] |= cells[x];
    }
    std::uint32_t leaves = kOwnLeafAlone;
    if (!(slabs[0] | slabs[2] | (slabs[1] & (lowY | highY | lowZ | highZ)))) return leaves;
    const std::uint64_t yMask[3] = {lowY, kAll, highY}, zMask[3] = {lowZ, kAll, highZ};
    for (int x = 0; x < 3; ++x) {
        if (!slabs[x]) continue;
        for (int y = 0; y < 3; ++y) {
            for (int z = 0; z < 3; ++z) {
                const bool any = slabs[x] & yMask[y] & zMask[z];
                leaves |= std::uint32_t(any) << (x * 9 + y * 3 + z);
            }
        }
    }
    return leaves;
}

} // namespace
} // namespace vdb_nns
