// The cells around a block that its queries reach. A block is a range of leaves: a cube of cells, or all of them.
#pragma once

#include "grid/sparse_grid_data.h"
#include "vdb_nns/planning/workload_tree.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// Some cells of a leaf, as words of its occupancy.
struct CellSet {
    std::uint32_t leaf;
    std::uint64_t cells[8];
};

std::uint64_t particlesIn(const SparseGridData& grid, const CellSet& set);
std::uint64_t cellsIn(const CellSet& set);

struct BlockHalo {
    std::vector<CellSet>
        halo; // by leaf: occupied cells outside the block within reach of an occupied cell inside
    std::vector<CellSet> boundary; // by leaf: occupied cells inside with occupied cells outside in reach
    HaloSize size;
};

// `log2Cells` is that of the cube that the leaves [firstLeaf, endLeaf) fill: only leaves at its faces are looked at.
BlockHalo haloOf(const SparseGridData& grid, std::uint32_t firstLeaf, std::uint32_t endLeaf, int log2Cells);

// The cells of a leaf at (dx, dy, dz), in leaves, from the one whose cells are given, that are within reach of those.
void cellsInReach(const std::uint64_t* cells, int dx, int dy, int dz, int reach, std::uint64_t* out);

} // namespace vdb_nns
