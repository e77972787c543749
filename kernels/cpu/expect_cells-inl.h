// ExpectCellsFunction for the instruction set of the including file: what the cells around each cell of a leaf hold. Writes
// the counts of a leaf's cells and of those in reach around it into a cube; the cells of a column then sum over their reach
// together. Each cell adds its terms in the same order everywhere, so every instruction set gives the same bits.
// Internal linkage; see simd.h.
#pragma once

#include "cpu/leaves_in_reach-inl.h"
#include "cpu/search_task.h"

namespace vdb_nns {
namespace {

// The 8 cells of a column of a leaf: of one (x, y), by z.
using ColumnCounts = std::int32_t __attribute__((vector_size(32)));
using ColumnSums = float __attribute__((vector_size(32)));

// Bits of a slab of one x by their z and y: those below reach, those of the reach highest, all.
template <int kReach>
struct SlabMasks {
    static constexpr std::uint64_t kAll = ~std::uint64_t(0);
    static constexpr std::uint64_t kLowZ = 0x0101010101010101u * ((1u << kReach) - 1);
    static constexpr std::uint64_t kHighZ = kLowZ << (8 - kReach);
    static constexpr std::uint64_t kLowY = kAll >> 8 * (8 - kReach);
    static constexpr std::uint64_t kHighY = kAll << 8 * (8 - kReach);
};

// The cells of neighbor n of the 27 leaves that are in reach of the leaf, in each of their slabs.
template <int kReach>
inline std::uint64_t haloMask(int n)
{
    using Masks = SlabMasks<kReach>;
    const int dy = n / 3 % 3 - 1, dz = n % 3 - 1;
    return (dy < 0   ? Masks::kHighY
            : dy > 0 ? Masks::kLowY
                     : Masks::kAll) &
           (dz < 0   ? Masks::kHighZ
            : dz > 0 ? Masks::kLowZ
                     : Masks::kAll);
}

// Adds the counts of the cells of one of the 27 leaves that are in reach to the cube.
template <int kReach>
inline void addCounts(const BlockView& block, std::uint32_t leafIndex, int n, CellCounts& cube,
                      std::uint16_t* occupied)
{
    constexpr int kSide = 8 + 2 * kReach;
    const LeafRecord& leaf = block.leaves[leafIndex];
    const int dx = n / 9 - 1, dy = n / 3 % 3 - 1, dz = n % 3 - 1;
    const std::uint64_t mask = haloMask<kReach>(n);
    const int x0 = dx < 0 ? 8 - kReach : 0, x1 = dx > 0 ? kReach : 8;
    const std::uint32_t* cell = block.cellStart + leaf.firstCell;
    for (int x = 0; x < x0; ++x) cell += __builtin_popcountll(leaf.occupancy[x]);
    for (int x = x0; x < x1; ++x) {
        const std::uint64_t word = leaf.occupancy[x];
        for (std::uint64_t bits = word & mask; bits;) {
            const int y = __builtin_ctzll(bits) >> 3;
            const int rowX = x + 8 * dx + kReach, rowY = y + 8 * dy + kReach, row = rowX * kSide + rowY;
            occupied[rowX] |= static_cast<std::uint16_t>(1u << rowY);
            const auto column = static_cast<unsigned>(bits >> 8 * y) & 255;
            const std::uint32_t* start = cell + __builtin_popcountll(word & ((bits & -bits) - 1));
            std::uint32_t* const count = cube.count + row * kSide + 8 * dz + kReach;
            if (column == 255) {
                for (int z = 0; z < 8; ++z) count[z] = start[z + 1] - start[z];
            } else {
                for (unsigned left = column; left; left &= left - 1, ++start)
                    count[__builtin_ctz(left)] = start[1] - start[0];
            }
            cube.touched[cube.touchedCount++] = static_cast<std::uint16_t>(row);
            bits &= ~(std::uint64_t(255) << 8 * y);
        }
        cell += __builtin_popcountll(word);
    }
}

template <int kReach>
void expectCellsAt(const BlockView& block, std::uint32_t leafIndex, const std::uint32_t* neighborhood,
                   const float* shares, CellCounts& cube, float* expected, std::uint32_t* candidates)
{
    constexpr int kSide = 8 + 2 * kReach;
    const LeafRecord& leaf = block.leaves[leafIndex];
    std::uint16_t occupied[kSide] = {}; // by x: bits of the y that have particles
    for (std::uint32_t left = leavesInReach(leaf.occupancy, kReach); left; left &= left - 1) {
        const int n = __builtin_ctz(left);
        if (neighborhood[n] != kNoLeaf) addCounts<kReach>(block, neighborhood[n], n, cube, occupied);
    }
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word;) {
            const int y = __builtin_ctzll(word) >> 3;
            ColumnCounts total{};
            ColumnSums weighted{};
            for (int dx = 0; dx <= 2 * kReach; ++dx) {
                unsigned rows = occupied[x + dx] >> y & ((2u << 2 * kReach) - 1);
                for (; rows; rows &= rows - 1) {
                    const int dy = __builtin_ctz(rows);
                    const std::uint32_t* const counts = cube.count + ((x + dx) * kSide + y + dy) * kSide;
                    const float* const share = shares + (dx * (2 * kReach + 1) + dy) * (2 * kReach + 1);
                    for (int dz = 0; dz <= 2 * kReach; ++dz) {
                        ColumnCounts count;
                        __builtin_memcpy(&count, counts + dz, sizeof count);
                        total += count;
                        weighted += share[dz] * __builtin_convertvector(count, ColumnSums);
                    }
                }
            }
            for (auto column = static_cast<unsigned>(word >> 8 * y) & 255; column; column &= column - 1) {
                const int z = __builtin_ctz(column);
                *candidates++ = static_cast<std::uint32_t>(total[z]);
                *expected++ = weighted[z];
            }
            word &= ~(std::uint64_t(255) << 8 * y);
        }
    }
    for (std::uint32_t i = 0; i < cube.touchedCount; ++i) {
        std::uint32_t* const row = cube.count + cube.touched[i] * kSide;
        for (int z = 0; z < kSide; ++z) row[z] = 0;
    }
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
