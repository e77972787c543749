// How a lattice follows from a radius, and which lattices and radii are refused.
#include "grid/lattice.h"

#include "util/number_text.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

namespace vdb_nns {

namespace {

// Of a radius against what cells span: what rounding the edge and its reciprocal may add.
constexpr double kRounding = 1e-12;

} // namespace

double spanOfCells(double cellSize, int reach)
{
    return cellSize / (1 + kCellPadding) * reach;
}

CellChoice cellsOfSize(double cellSize)
{
    const double perRadius = 1 / cellSize;
    const int reach = static_cast<int>(std::ceil(0.99 * perRadius));
    return {std::min<double>(perRadius, reach), reach};
}

Lattice latticeOf(const ParticleSource& source, double radius, const CellChoice& cells)
{
    Lattice lattice;
    lattice.reference = source.reference();
    lattice.cellSize = std::clamp(radius * (1 + kCellPadding) / cells.perRadius, kSmallestEdge,
                                  std::numeric_limits<double>::max());
    lattice.reach = cells.reach;
    if (radius > spanOfCells(lattice.cellSize, lattice.reach) * (1 + kRounding))
        ++lattice.reach; // no wider cells
    lattice.radius = radius;
    return lattice;
}

void checkRadius(double radius)
{
    if (!(radius > 0) || std::isinf(radius)) {
        throw InvalidInput("radius " + std::to_string(radius) + " is not a positive finite number");
    }
}

void checkLattice(const Lattice& lattice)
{
    checkRadius(lattice.radius);
    if (!(lattice.cellSize >= kSmallestEdge) || std::isinf(lattice.cellSize)) {
        throw InvalidInput("a lattice with cells of " + shortest(lattice.cellSize) +
                           " is not possible: use a finite edge of at least " + shortest(kSmallestEdge));
    }
    const int mostReach = lattice.usesVoxels ? 1 : 3;
    if (lattice.reach < 1 || lattice.reach > mostReach) {
        throw InvalidInput("a lattice whose radius spans " + std::to_string(lattice.reach) +
                           " cells is not possible: use 1" +
                           (lattice.usesVoxels ? " with voxels as cells" : " to 3"));
    }
    for (const double x : lattice.reference) {
        if (!std::isfinite(x)) throw InvalidInput("the reference of a lattice is not finite");
    }
    const double span = lattice.usesVoxels ? lattice.cellSize : spanOfCells(lattice.cellSize, lattice.reach);
    if (lattice.usesVoxels ? !voxelsSpan(span, lattice.radius)
                           : !(lattice.radius <= span * (1 + kRounding))) {
        throw InvalidInput("a lattice whose radius spans " + std::to_string(lattice.reach) +
                           " cells of edge " + shortest(lattice.cellSize) + " is for radii " +
                           (lattice.usesVoxels ? "below " : "up to ") + shortest(span) + ", not " +
                           shortest(lattice.radius) + ": use larger cells or a longer reach");
    }
}

double searchRadius(const Lattice& lattice, double radius)
{
    if (radius == 0) return lattice.radius;
    checkRadius(radius);
    if (radius > lattice.radius) {
        throw InvalidInput("a search with radius " + shortest(radius) +
                           " is not possible on a lattice for radii up to " + shortest(lattice.radius) +
                           ": build the grid for the larger radius");
    }
    return radius;
}

} // namespace vdb_nns
