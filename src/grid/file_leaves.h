// Takes over the leaves of a VDB point file as leaves of the grid, where its voxels serve as cells: nothing is sorted.
//
// Cell coordinates are then tau = voxel + P + 1/2, in units of the voxel's edge s, which needs a transform that scales
// alone (and mirrors), the same on each axis; the radius in cells is rho = radius / s. Every |P| <= 1/2 puts a particle
// into the closed cell of its voxel, so particles within the radius have voxels that differ by at most rho + 1 < 2 on each
// axis: by one at most, and no pair is lost.
#pragma once

#include "grid/lattice.h"
#include "grid/sparse_grid_data.h"
#include "util/cancel.h"
#include "vdb_nns/search_options.h"

#include <optional>

namespace vdb_nns {

// The voxels as a lattice, if transform and radius permit it and the search would not be slower than in sorted cells.
std::optional<Lattice> latticeOfVoxels(const ParticleSource& source, double radius);

// Whether the voxels of a grid are the cells of such a lattice, as far as its transform says.
bool areCells(const ParticleSource& source, const Lattice& lattice);

// Whether the leaves serve: all are in range and every particle is in its voxel. One pass over the particles.
bool particlesAreInVoxels(const ParticleSource& source, const CancelCheck& cancel);

// Makes the grid; the voxels are the cells of the lattice. False, with the grid in any state, when the leaves do not serve.
// Throws CapacityError and Cancelled as SearchEngine::buildGrid().
bool takeOverLeaves(const ParticleView& view, const Lattice& lattice, const SearchOptions& options,
                    SparseGridData& grid);

} // namespace vdb_nns
