// The order in which the candidates of a cell are visited: what the bits of a mask row stand for, and what every list
// follows. (dx, dy) lexicographic, z ascending, by slot inside a cell. Any compiler.
#pragma once

#include "shared/annotation.h"
#include "shared/block_view.h"

#include <cstdint>

namespace vdb_nns {

VDB_NNS_HOST_DEVICE static inline std::uint32_t countBits(std::uint64_t word)
{
#if defined(__CUDA_ARCH__)
    return static_cast<std::uint32_t>(__popcll(word));
#else
    return static_cast<std::uint32_t>(__builtin_popcountll(word));
#endif
}

// The place of the lowest bit; there is one.
VDB_NNS_HOST_DEVICE static inline int lowestBit(std::uint64_t word)
{
#if defined(__CUDA_ARCH__)
    return __ffsll(static_cast<long long>(word)) - 1;
#else
    return __builtin_ctzll(word);
#endif
}

struct SlotRange {
    std::uint32_t begin, end;
};

// The particles of the cells z0 to z1 of one column of a leaf stand together.
VDB_NNS_HOST_DEVICE static inline SlotRange columnRange(const BlockView& block, std::uint32_t leafIndex,
                                                        int x, int y, int z0, int z1)
{
    const LeafRecord& leaf = block.leaves[leafIndex];
    const std::uint64_t word = leaf.occupancy[x];
    const int low = 8 * y + z0;
    const std::uint64_t bits = word >> low & ((std::uint64_t(2) << (z1 - z0)) - 1);
    if (!bits) return {0, 0};
    std::uint32_t cell = leaf.firstCell;
    for (int w = 0; w < 7; ++w) {
        if (w < x) cell += countBits(leaf.occupancy[w]);
    }
    cell += countBits(word & ((std::uint64_t(1) << low) - 1));
    return {block.cellStart[cell], block.cellStart[cell + countBits(bits)]};
}

// The part of a column of candidates that is in one leaf: its cells z0 to z1, and where that leaf is, in leaves from the
// query's, -1 to 1. None when z0 > z1.
struct ColumnPiece {
    int leafX, leafY, leafZ, z0, z1;
};

// Piece `part`, 0 or 1 from below, of the column through the cell (cx, cy, z) of the query's leaf; cx and cy may be in leaves
// beside it.
VDB_NNS_HOST_DEVICE static inline ColumnPiece columnPiece(int cx, int cy, int z, int reach, int part)
{
    const int bottom = (z - reach + 8) >> 3, top = (z + reach + 8) >> 3, leaf = bottom + part;
    if (leaf > top) return {0, 0, 0, 1, 0};
    const int low = z - reach + 8 - 8 * leaf, high = z + reach + 8 - 8 * leaf;
    return {((cx + 8) >> 3) - 1, ((cy + 8) >> 3) - 1, leaf - 1, low > 0 ? low : 0, high < 7 ? high : 7};
}

// All candidates of a cell are at most so many pieces, in visiting order.
VDB_NNS_HOST_DEVICE static inline int pieceCount(int reach)
{
    return 2 * (2 * reach + 1) * (2 * reach + 1);
}
constexpr int kMostPieces = 2 * 7 * 7;

VDB_NNS_HOST_DEVICE static inline ColumnPiece pieceOf(int x, int y, int z, int reach, int number)
{
    const int side = 2 * reach + 1, column = number >> 1;
    return columnPiece(x - reach + column / side, y - reach + column % side, z, reach, number & 1);
}

// The number of a leaf around another in its neighborhood.
VDB_NNS_HOST_DEVICE static inline int neighborIndex(int leafX, int leafY, int leafZ)
{
    return (leafX + 1) * 9 + (leafY + 1) * 3 + leafZ + 1;
}

} // namespace vdb_nns
