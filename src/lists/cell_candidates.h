// The candidates of a cell in visiting order: what the bits of a mask row stand for. Shared by everything that decodes.
#pragma once

#include "grid/sparse_grid_data.h"
#include "shared/traverse.h"

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
        for (int cy = y - reach; cy <= y + reach; ++cy) {
            for (int part = 0; part < 2; ++part) {
                const ColumnPiece piece = columnPiece(cx, cy, z, reach, part);
                if (piece.z0 > piece.z1) break;
                const std::uint32_t leaf =
                    neighborhood.leaf[neighborIndex(piece.leafX, piece.leafY, piece.leafZ)];
                if (leaf == kNoLeaf) continue;
                const SlotRange range = columnRange(block, leaf, cx & 7, cy & 7, piece.z0, piece.z1);
                if (range.begin != range.end) f(range.begin, range.end);
            }
        }
    }
}

inline BlockView blockViewOf(const SparseGridData& grid)
{
    return {grid.x.data(),      grid.y.data(),         grid.z.data(), grid.number.data(),
            grid.leaves.data(), grid.cellStart.data(), grid.reach()};
}

// An occupied cell of a leaf: its slots, the particles of the cells in its reach, and where it stands in the occupancy.
struct OccupiedCell {
    std::uint32_t begin, end;
    std::uint64_t candidates;
    int x;
    std::uint64_t bit;

    std::uint64_t rowWords() const { return (candidates + 31) / 32; } // of a mask row
};

// Calls f(OccupiedCell) for each occupied cell of a leaf of the queries, in the order of slots. `neighborhood`: leaves of the
// candidates around it.
template <typename F>
void forEachOccupiedCell(const BlockView& queries, const BlockView& block, std::uint32_t leafIndex,
                         const LeafNeighborhood& neighborhood, F&& f)
{
    const LeafRecord& leaf = queries.leaves[leafIndex];
    const std::uint32_t* cell = queries.cellStart + leaf.firstCell;
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

// Where the queries are the candidates.
template <typename F>
void forEachOccupiedCell(const BlockView& block, std::uint32_t leafIndex,
                         const LeafNeighborhood& neighborhood, F&& f)
{
    forEachOccupiedCell(block, block, leafIndex, neighborhood, f);
}

} // namespace vdb_nns
