// Where the particles are on a lattice: their leaves, found in parallel by chunks of particles, and the leaves' order. The first
// two steps of the sort (sparse_grid.cpp).
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
    std::uint64_t members = 0, nonfinite = 0;
    bool outOfRange = false;
};

struct Placement {
    std::vector<Chunk> chunks;
    std::uint64_t members = 0, nonfinite = 0; // those that are to be sorted, non-finite ones included
    bool outOfRange = false; // a cell coordinate passes the limit: then the rest means nothing
};

// Finds the leaf of every particle that is to be sorted: leafOf[i] is a number in its chunk's table, kNoLeaf for the others.
// Throws CapacityError where the leaves pass options.hostMemoryBytes.
Placement placeParticles(const GridMembers& members, const CellMap& map, const SearchOptions& options,
                         std::uint32_t* leafOf, const CancelCheck& cancel);

// Leaves of all chunks in Morton order; sets the chunks' cursors and the leaves' first slots. `around`: leaves that touch none of
// its leaves are left out, with a cursor of kNoLeaf; null: none is.
void mergeLeaves(std::vector<Chunk>& chunks, const SparseGridData* around, SparseGridData& grid);

CapacityError gridDoesNotFit(std::size_t particles, std::size_t leaves, std::uint64_t needed,
                             std::uint64_t allowed);

} // namespace vdb_nns
