// ExpectCellsFunction for the instruction set of the including file: what the cells around each cell of a leaf hold. Writes
// the counts of a leaf's cells and of those in reach around it into a cube; each occupied cell then sums over its reach.
// Internal linkage; see simd.h.
#pragma once

#include "execute/search_task.h"

namespace vdb_nns {
namespace {

// Adds the counts of the cells of one of the 27 leaves that are in reach to the cube.
template <int kReach>
inline void addCounts(const BlockView& block, std::uint32_t leafIndex, int n, CellCounts& cube)
{
    constexpr int kSide = 8 + 2 * kReach;
    constexpr std::uint64_t kBytes = 0x0101010101010101u, kAll = ~std::uint64_t(0);
    constexpr std::uint64_t kLow = kBytes * ((1u << kReach) - 1);
    const LeafRecord& leaf = block.leaves[leafIndex];
    const int dx = n / 9 - 1, dy = n / 3 % 3 - 1, dz = n % 3 - 1;
    const std::uint64_t zMask = dz < 0 ? kLow << (8 - kReach) : dz > 0 ? kLow : kAll;
    const std::uint64_t yMask = dy < 0 ? kAll << 8 * (8 - kReach) : dy > 0 ? kAll >> 8 * (8 - kReach) : kAll;
    const std::uint64_t mask = zMask & yMask;
    const int x0 = dx < 0 ? 8 - kReach : 0, x1 = dx > 0 ? kReach : 8;
    const std::uint32_t* cell = block.cellStart + leaf.firstCell;
    for (int x = 0; x < x0; ++x) cell += __builtin_popcountll(leaf.occupancy[x]);
    for (int x = x0; x < x1; ++x) {
        const std::uint64_t word = leaf.occupancy[x];
        const int row = (x + 8 * dx + kReach) * kSide + 8 * dy + kReach, column = 8 * dz + kReach;
        for (std::uint64_t bits = word & mask; bits; bits &= bits - 1) {
            const int bit = __builtin_ctzll(bits);
            const std::uint32_t* const start = cell + __builtin_popcountll(word & ((bits & -bits) - 1));
            const int at = (row + (bit >> 3)) * kSide + column + (bit & 7);
            cube.count[at] = start[1] - start[0];
            cube.touched[cube.touchedCount++] = static_cast<std::uint16_t>(at);
        }
        cell += __builtin_popcountll(word);
    }
}

template <int kReach>
void expectCellsAt(const BlockView& block, std::uint32_t leafIndex, const std::uint32_t* neighborhood,
                   const float* shares, CellCounts& cube, float* expected, std::uint32_t* candidates)
{
    constexpr int kSide = 8 + 2 * kReach;
    for (int n = 0; n < 27; ++n) {
        if (neighborhood[n] != 0xffffffffu) addCounts<kReach>(block, neighborhood[n], n, cube);
    }
    const LeafRecord& leaf = block.leaves[leafIndex];
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1) {
            const int bit = __builtin_ctzll(word);
            const std::uint32_t* const corner = cube.count + (x * kSide + (bit >> 3)) * kSide + (bit & 7);
            std::uint32_t total = 0;
            float weighted = 0;
            for (int dx = 0; dx <= 2 * kReach; ++dx) {
                for (int dy = 0; dy <= 2 * kReach; ++dy) {
                    const std::uint32_t* const column = corner + (dx * kSide + dy) * kSide;
                    const float* const share = shares + (dx * (2 * kReach + 1) + dy) * (2 * kReach + 1);
                    for (int dz = 0; dz <= 2 * kReach; ++dz) {
                        total += column[dz];
                        weighted += share[dz] * static_cast<float>(static_cast<std::int32_t>(column[dz]));
                    }
                }
            }
            *candidates++ = total;
            *expected++ = weighted;
        }
    }
    for (std::uint32_t i = 0; i < cube.touchedCount; ++i) cube.count[cube.touched[i]] = 0;
    cube.touchedCount = 0;
}

void expectCells(const BlockView& block, std::uint32_t leaf, const std::uint32_t* neighborhood,
                 const float* shares, CellCounts& cube, float* expected, std::uint32_t* candidates)
{
    const auto run = block.reach == 1   ? expectCellsAt<1>
                     : block.reach == 2 ? expectCellsAt<2>
                                        : expectCellsAt<3>;
    run(block, leaf, neighborhood, shares, cube, expected, candidates);
}

} // namespace
} // namespace vdb_nns
