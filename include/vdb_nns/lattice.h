// The lattice: where the cells of a search are. Plain data that is known before any particle is sorted, so that several sets
// of particles can be sorted by the same cells.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

namespace vdb_nns {

/// Cubic cells along the axes of world space, numbered by integer cell coordinates. A particle at the stored position p is in
/// the cell floor(linear() * (p - reference) / cellSize) on each axis, but for the rounding of that.
///
/// What share a lattice are views with the same linear map and the same translation: all arrays, or VDB grids of one transform.
struct Lattice {
    /// The corner at which cell coordinates are 0, in the stored coordinates of the views that share the lattice
    /// (StoredPosition): world units for arrays; for VDB grids voxels, and then whole numbers.
    Vec3d reference{};
    double cellSize = 1; ///< edge of a cell, world units
    int reach = 1;       ///< cells that the radius spans, 1 to 3
    /// The largest radius that a search in these cells may have, and the one that it has unless told otherwise
    /// (SearchOptions::radius). World units, > 0, at most spanOfCells(cellSize, reach).
    double radius = 0;
    /// The cells are the voxels of VDB grids, and cell coordinates those of voxels: the leaves of a file are taken over and
    /// nothing is sorted. `cellSize` is a voxel's edge then, `reach` 1, `radius` below the edge, and `reference` is not read.
    /// For grids whose transform does nothing but scale, mirror and translate, with every offset P within 1/2.
    bool usesVoxels = false;

    friend bool operator==(const Lattice& a, const Lattice& b)
    {
        return a.reference == b.reference && a.cellSize == b.cellSize && a.reach == b.reach &&
               a.radius == b.radius && a.usesVoxels == b.usesVoxels;
    }
    friend bool operator!=(const Lattice& a, const Lattice& b) { return !(a == b); }
};

/// The largest radius that so many cells surely span, whatever the rounding of coordinates: reach * cellSize less a share of 2^-16.
double spanOfCells(double cellSize, int reach);

/// The lattice that SearchEngine::buildGrid() takes for a view and a radius; `radius` is the lattice's.
/// Cost: one pass over the particles, to see that they fit, besides what buildGrid() does to choose cells: a look at a thousand
/// particles, and where they are not dense a pass. buildGrid() with a radius sees whether they fit as it sorts them.
/// @param radius world units, > 0 and finite.
/// @param options read as buildGrid() reads them; the memory of the grid is not checked.
/// @throws InvalidInput for a bad radius or option
/// @throws InputError as SearchEngine::buildGrid() when a cell coordinate would be out of range
/// @throws Cancelled
Lattice chooseLattice(const ParticleView& view, double radius, const SearchOptions& options = {});

} // namespace vdb_nns
