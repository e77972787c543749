// Takes over the leaves of a VDB point file as leaves of the grid, where its voxels serve as cells: nothing is sorted.
//
// Cell coordinates are then tau = voxel + P + 1/2, in units of the voxel's edge s, which needs a transform that scales
// alone (and mirrors), the same on each axis; the radius in cells is rho = radius / s. Every |P| <= 1/2 puts a particle
// into the closed cell of its voxel, so particles within the radius have voxels that differ by at most rho + 1 < 2 on each
// axis: by one at most, and no pair is lost.
#pragma once

#include "grid/sparse_grid_data.h"
#include "vdb_nns/search_options.h"

namespace vdb_nns {

// False, with the grid in any state, when the file's leaves do not serve or would make the search slower than sorting.
// Throws CapacityError and Cancelled as SearchEngine::buildGrid().
bool takeOverLeaves(const ParticleView& view, double radius, const SearchOptions& options,
                    SparseGridData& grid);

} // namespace vdb_nns
