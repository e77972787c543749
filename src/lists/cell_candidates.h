// The candidates of a cell in visiting order: what the bits of a mask row stand for. Shared by everything that decodes.
#pragma once

#include "grid/sparse_grid_data.h"

#include <cstdint>

namespace vdb_nns {

// Calls f(first slot, end slot) for each run of candidates of the cell (x, y, z), 0 to 7, of the leaf that `neighborhood`
// surrounds: (dx, dy) lexicographic, z ascending.
template <typename F>
void forEachCandidateRun(const BlockView& block, const LeafNeighborhood& neighborhood, int x, int y, int z,
                         F&& f)
{
    const int reach = block.reach;
    for (int cx = x - reach; cx <= x + reach; ++cx) {
        const int nx = (cx + 8) >> 3;
        for (int cy = y - reach; cy <= y + reach; ++cy) {
            const int ny = (cy + 8) >> 3;
            for (int nz = (z - reach + 8) >> 3; nz <= (z + reach + 8) >> 3; ++nz) {
                const std::uint32_t leafIndex = neighborhood.leaf[nx * 9 + ny * 3 + nz];
                if (leafIndex == kNoLeaf) continue;
                const LeafRecord& leaf = block.leaves[leafIndex];
                const int z0 = nz == 0 ? z - reach + 8 : nz == 1 ? (z > reach ? z - reach : 0) : 0;
                const int z1 = nz == 2 ? z + reach - 8 : nz == 1 ? (z + reach < 7 ? z + reach : 7) : 7;
                const std::uint64_t word = leaf.occupancy[cx & 7];
                const int low = 8 * (cy & 7) + z0;
                const std::uint64_t bits = word >> low & ((std::uint64_t(2) << (z1 - z0)) - 1);
                if (!bits) continue;
                std::uint32_t cell = leaf.firstCell;
                for (int w = 0; w < (cx & 7); ++w) {
                    cell += static_cast<std::uint32_t>(__builtin_popcountll(leaf.occupancy[w]));
                }
                cell +=
                    static_cast<std::uint32_t>(__builtin_popcountll(word & ((std::uint64_t(1) << low) - 1)));
                f(block.cellStart[cell], block.cellStart[cell + __builtin_popcountll(bits)]);
            }
        }
    }
}

inline BlockView blockViewOf(const SparseGridData& grid)
{
    return {grid.x.data(),      grid.y.data(),         grid.z.data(), grid.number.data(),
            grid.leaves.data(), grid.cellStart.data(), grid.reach};
}

// An occupied cell of a leaf: its slots, the particles of the cells in its reach, and where it stands in the occupancy.
struct OccupiedCell {
    std::uint32_t begin, end;
    std::uint64_t candidates;
    int x;
    std::uint64_t bit;

    std::uint64_t rowWords() const { return (candidates + 31) / 32; } // of a mask row
};

// Calls f(OccupiedCell) for each occupied cell of a leaf, in the order of slots.
template <typename F>
void forEachOccupiedCell(const BlockView& block, std::uint32_t leafIndex,
                         const LeafNeighborhood& neighborhood, F&& f)
{
    const LeafRecord& leaf = block.leaves[leafIndex];
    const std::uint32_t* cell = block.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
            const int bit = __builtin_ctzll(word);
            std::uint64_t candidates = 0;
            forEachCandidateRun(
                block, neighborhood, x, bit >> 3, bit & 7,
                [&](std::uint32_t runBegin, std::uint32_t runEnd) { candidates += runEnd - runBegin; });
            f(OccupiedCell{cell[0], cell[1], candidates, x, word & -word});
        }
    }
}

} // namespace vdb_nns
