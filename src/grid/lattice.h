// The arithmetic of a lattice: its cells in units of space, and why no pair is lost at their faces.
//
// Positions are multiplied by cellsPerUnit(), and the edge of a cell is that factor's real reciprocal. In
// units of it the cell coordinate of a particle is tau in real arithmetic and t as computed, |t - tau| <= E
// (cell_map.h). Two particles within the radius differ by at most rho = radius * cellsPerUnit in tau, so by
// rho + 2 (E + 2^-23 + 2^-22 + 2^-21) in the coordinate that decides the cell (t rounded to float about the
// leaf's centre, then cellInLeaf). A lattice's radius is at most spanOfCells(), so rho <= reach / (1 + 2^-16)
// but for 1e-12 of it, and with E <= 6.7e-6 the sum is below reach by 1e-7: their cells differ by at most
// reach, and no pair is lost. For the voxels of a file file_leaves.h has a proof of its own.
#pragma once

#include "points/particle_source.h"
#include "vdb_nns/lattice.h"

namespace vdb_nns {

constexpr double kCellPadding = 1.0 / 65536;
constexpr double kMaxErrorCells = 6.7e-6;          // E
constexpr double kCellLimit = 2147483648.0 - 4096; // cell coordinates stay inside
constexpr double kSmallestEdge = 1e-289;           // world units; its reciprocal is a normal number
constexpr double kUnevenVoxels = 1e-12; // relative: transforms that were composed have rounded entries

// Whether a radius is below the edge of a voxel, by enough that neither rounding nor uneven edges matter.
inline bool voxelsSpan(double edge, double radius)
{
    return radius / edge < 1 - 2 * kUnevenVoxels;
}

inline double cellsPerUnit(const Lattice& lattice)
{
    return 1 / lattice.cellSize;
}

// A radius in cells, with a relative error of at most 2^-49.
inline double radiusInCells(const Lattice& lattice, double radius)
{
    return radius * cellsPerUnit(lattice);
}

// How cells follow from a radius.
struct CellChoice {
    double perRadius = 1; // cells
    int reach = 1;        // the next whole number
};

// Sizes a hundredth below 1, 1/2 and 1/3 of the radius are rounded up to them: no decimal fraction is a
// third.
CellChoice cellsOfSize(double cellSize);

// Counted from the reference of the source. Where the edge or its reciprocal would overflow, cells are wider
// than they need be.
Lattice latticeOf(const ParticleSource& source, double radius, const CellChoice& cells);

// Throw InvalidInput: for a radius that is no positive finite number; for a lattice that no search could use.
void checkRadius(double radius);
void checkLattice(const Lattice& lattice);

// The radius of a search that was asked for `radius`, 0 for the lattice's. Throws InvalidInput above that.
double searchRadius(const Lattice& lattice, double radius);

} // namespace vdb_nns
