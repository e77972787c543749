// From stored positions to cell coordinates, with a bound on the rounding.
//
// The true cell coordinate of a particle is tau = linear * (stored - reference) * cellsPerUnit, in real arithmetic; t is
// what locate() computes. Per axis |t - tau| <= errorCells(most), where most bounds |t|, and |stored - reference| through M's
// inverse:
//   arrays: c = stored - reference (1 rounding), c * cellsPerUnit (1)
//   grids:  c (1), each product m * c with m = linear * cellsPerUnit (1 for m, 1 for the product), two sums (2)
//   both:   the leaf is the nearest integer to t / 8 - 1/2, whose difference may round (1)
// so at most 6 relative roundings of u = 2^-53 of sum |m| |c|; 7 u covers their products. What follows, t - 8 leaf - 4,
// is exact to 2^-51.
//
// A cell is a hair wider than radius / cellsPerRadius: two particles within the radius differ by at most radiusCells in tau,
// so by radiusCells + 2 (E + 2^-23 + 2^-22 + 2^-21) in the coordinate that decides the cell (t rounded to float about the
// leaf's centre, then cellInLeaf). radiusCells = cellsPerRadius / (1 + 2^-16) with cellsPerRadius <= reach, so with E <= 6.7e-6
// that is below reach, and their cells differ by at most reach: no pair is lost at a cell face.
#pragma once

#include "cpu/kernels.h"
#include "points/particle_source.h"
#include "vdb_nns/error.h"

#include <cstdint>

namespace vdb_nns {

struct CellMap {
    static constexpr double kCellPadding = 1.0 / 65536;
    static constexpr double kMaxErrorCells = 6.7e-6;
    static constexpr double kLimit = 2147483648.0 - 4096; // cell coordinates stay inside

    CellMap(const ParticleSource& source, double radius, double cellsPerRadius, SimdLevel simd);

    static constexpr std::size_t kBatch =
        512; // particles: what locate() works on stays in the first-level cache

    // Where a batch of particles is.
    struct Located {
        std::int32_t leaf[3][kBatch]; // units of leaves
        float local[3][kBatch];       // about the leaf's centre, in cells: |.| <= 4
    };

    // `stored` is relative to the reference. False when a coordinate is out of range or not finite; then the particles
    // for which inRange() is false have arbitrary places.
    bool locate(const double (*stored)[kBatch], std::size_t count, Located& out) const;

    bool inRange(double cx, double cy, double cz) const;

    double errorCells(const double mostCells[3]) const;

    // Says how far the particles reach and which radius works. `coordinateError` is what errorCells() gave, or 0 when cell
    // coordinates are out of range.
    InputError rangeError(const ParticleSource& source, double coordinateError) const;

    Vec3d reference;
    double cellsPerUnit;

private:
    double cell(int axis, double cx, double cy, double cz) const
    {
        const auto& m = mMatrix[axis];
        return m[0] * cx + m[1] * cy + m[2] * cz;
    }

    double mRadius;
    double mCellsPerRadius;
    Matrix3 mMatrix; // linear * cellsPerUnit
    Matrix3 mSpread; // |mMatrix| |its inverse|
    bool mIsArray;
    LocateAxisFunction mLocateAxis;
};

// Cell 0 to 7 of a leaf-local coordinate. 2^-21 low, so that the sum cannot round up to 8.
inline unsigned cellInLeaf(float local)
{
    return static_cast<unsigned>(static_cast<int>(local + (4 - 0x1p-21f)));
}

struct Bounds {
    Vec3d low, high;
};

// Bounding box of the finite particles in stored coordinates less `reference`; zero without any. One pass.
Bounds boundsOf(const ParticleSource& source, const Vec3d& reference);

} // namespace vdb_nns
