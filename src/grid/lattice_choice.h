// Which lattice a view is sorted on, where nobody has given one.
#pragma once

#include "grid/lattice.h"
#include "util/cancel.h"
#include "vdb_nns/search_options.h"

#include <functional>

namespace vdb_nns {

// What became of a lattice.
struct LatticeFit {
    bool fits = false;
    double coordinateError = 0; // where cell coordinates are in range, but may be that wrong
};

// Offers lattices for a radius, the best first, until one fits: the voxels of a file; cells of the size that
// is asked for or chosen; cells of the radius, where there would be too many smaller ones. Cells of arrays
// are counted from the origin, or from the middle of the particles where the origin is too far. Whether a
// lattice fits is left to the sort on it, which looks at all particles anyway: there is no other pass over
// them but those of chooseCellSize(), and of boundsOf() where the origin is too far.
// `placed`: whose particles `offer` sorts, for messages; voxels are offered only if that is the source itself and all of them.
// Throws InputError where none fits, Cancelled, and what `offer` throws.
void offerLattices(const ParticleSource& source, double radius, const SearchOptions& options,
                   const ParticleSource& placed, bool mayUseVoxels,
                   const std::function<LatticeFit(const Lattice&)>& offer);

// The lattice that fits, found by a pass over the particles for each that is offered. Throws as
// offerLattices().
Lattice findLattice(const ParticleSource& source, double radius, const SearchOptions& options);

// Whether a lattice fits the particles of a source; `home`: in whose stored coordinates it is, null for the source's own. A pass over
// the particles. Throws Cancelled.
LatticeFit fitOf(const ParticleSource& source, const Lattice& lattice, SimdLevel simd,
                 const CancelCheck& cancel, const ParticleSource* home = nullptr);

// The size of cells, in radii, that a search of these particles is fastest with; above 1 only where it may
// be. The same for any number of threads and any instruction set. Throws Cancelled.
// Cost: a look at a thousand particles, or a thousandth of them; and where they are not dense a pass over
// all.
double chooseCellSize(const ParticleSource& source, double radius, SimdLevel simd, bool mayBeWide,
                      const CancelCheck& cancel);

} // namespace vdb_nns
