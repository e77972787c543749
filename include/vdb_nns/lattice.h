// The lattice: where the cells of a search are. Plain data, known before any particle is sorted, so that
// several sets of particles can be sorted into the same cells.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

namespace vdb_nns {

/// Cubic cells along the axes of world space, numbered by integer cell coordinates. A particle at the stored
/// position p is in the cell floor(linear() * (p - reference) / cellSize) on each axis, up to
/// rounding.
///
/// Views can share a lattice if they have the same linear map and the same translation: arrays, or VDB grids
/// with one transform.
struct Lattice {
    /// The corner at which cell coordinates are 0, in the stored coordinates of the views that share the
    /// lattice (StoredPosition): world units for arrays; for VDB grids voxels, and then whole numbers.
    Vec3d reference{};
    double cellSize = 1; ///< edge of a cell, world units
    int reach = 1;       ///< cells that the radius spans, 1 to 3
    /// The largest radius that a search in these cells may have, and the one that it has unless told
    /// otherwise (SearchOptions::radius). World units, > 0, at most spanOfCells(cellSize, reach) up to rounding;
    /// with `usesVoxels` below cellSize.
    double radius = 0;
    /// The cells are the voxels of VDB grids, with the coordinates of voxels: the leaves of a file are taken
    /// over, and nothing is sorted. Then `cellSize` is the edge of a voxel, `reach` is 1, `radius` is below
    /// the edge, and `reference` is not read. For grids whose transform does nothing but scale, mirror and
    /// translate, with every offset P within 1/2.
    bool usesVoxels = false;

    friend bool operator==(const Lattice& a, const Lattice& b)
    {
        return (a.reference == b.reference || a.usesVoxels) && a.cellSize == b.cellSize &&
               a.reach == b.reach && a.radius == b.radius && a.usesVoxels == b.usesVoxels;
    }
    friend bool operator!=(const Lattice& a, const Lattice& b) { return !(a == b); }
};

/// The largest radius that `reach` cells are guaranteed to cover, rounding included: reach * cellSize
/// / (1 + 2^-16).
double spanOfCells(double cellSize, int reach);

/// The lattice that SearchEngine::buildGrid() takes for a view and a radius; `radius` is the lattice's.
/// Cost: what buildGrid() does to choose cells (a look at a thousand particles; where they are not dense, a
/// pass over all), and one more pass to see that they fit, which buildGrid() with a radius sees as it sorts
/// them.
/// @param radius world units, > 0 and finite.
/// @param options read as buildGrid() reads them; the memory of the grid is not checked.
/// @throws InvalidInput for a bad radius or option
/// @throws InputError as SearchEngine::buildGrid() when a cell coordinate would be out of range
/// @throws Cancelled
Lattice chooseLattice(const ParticleView& view, double radius, const SearchOptions& options = {});

} // namespace vdb_nns
