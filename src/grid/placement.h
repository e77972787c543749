// Where the particles are: their leaves, found in parallel by chunks of particles, and the leaves' order. The first two steps of
// the sort (sparse_grid.cpp), for cells of a given size; and that size, where nobody has chosen it.
#pragma once

#include "grid/cell_map.h"
#include "grid/leaf_table.h"
#include "grid/sparse_grid_data.h"
#include "util/cancel.h"
#include "vdb_nns/error.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// A range of particles, and the leaves that they are in.
struct Chunk {
    std::size_t begin = 0, end = 0;
    LeafTable leaves;
    std::vector<std::uint32_t> cursor; // by local leaf: next slot to write
    std::uint64_t nonfinite = 0;
    bool outOfRange = false;
};

// How cells follow from a radius.
struct CellChoice {
    double perRadius = 1; // cells
    int reach = 1;        // the next whole number
};

// Sizes a hundredth below 1, 1/2 and 1/3 of the radius are rounded up to them: no decimal fraction is a third.
CellChoice cellsOfSize(double cellSize);

struct Placement {
    CellMap map;
    std::vector<Chunk> chunks;
    std::uint64_t nonfinite = 0;
};

// Finds the leaf of every particle: leafOf[i] is a number in its chunk's table. Cells are counted from the middle of the
// particles where they would be too many from the origin.
// Throws InputError where a cell coordinate passes the limit, CapacityError where the leaves pass options.hostMemoryBytes.
Placement placeParticles(const ParticleSource& source, double radius, const CellChoice& cells,
                         const SearchOptions& options, std::uint32_t* leafOf, const CancelCheck& cancel);

// Leaves of all chunks in Morton order; sets the chunks' cursors and the leaves' first slots.
void mergeLeaves(std::vector<Chunk>& chunks, SparseGridData& grid);

// The size, in radii, that a search of these particles is fastest with; above 1 only where it may be. The same for any number of
// threads and any instruction set. Throws Cancelled.
// Cost: a look at a thousand particles, or a thousandth of them; and where they are not dense a pass over all.
double chooseCellSize(const ParticleSource& source, double radius, SimdLevel simd, bool mayBeWide,
                      const CancelCheck& cancel);

CapacityError gridDoesNotFit(std::size_t particles, std::size_t leaves, std::uint64_t needed,
                             std::uint64_t allowed);

} // namespace vdb_nns
