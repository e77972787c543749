// From the stored positions of a view to cell coordinates of a lattice, with a bound on the rounding.
//
// The true cell coordinate of a particle is tau = linear * (stored - reference) * cellsPerUnit, in real arithmetic; t is
// what locate() computes. Per axis |t - tau| <= errorCells(most), where most bounds |t|, and |stored - reference| through M's
// inverse:
//   arrays: c = stored - reference (1 rounding), c * cellsPerUnit (1)
//   grids:  c (1), each product m * c with m = linear * cellsPerUnit (1 for m, 1 for the product), two sums (2)
//   both:   the leaf is the nearest integer to t / 8 - 1/2, whose difference may round (1)
// so at most 6 relative roundings of u = 2^-53 of sum |m| |c|; 7 u covers their products. What follows, t - 8 leaf - 4,
// is exact to 2^-51.
// Where the lattice is counted in the coordinates of another source (`home`), positions are taken about a reference of their
// own, and t = fl(sum + offset) with the offset of the two references in cells, within 3 u of the true one: 4 u (|t| + |offset|)
// more, and sum |m| |c| is bounded from |t| + |offset|.
// What the bound is for stands in lattice.h.
#pragma once

#include "cpu/kernels.h"
#include "grid/lattice.h"
#include "points/particle_source.h"
#include "vdb_nns/error.h"

#include <cmath>
#include <cstdint>
#include <optional>

namespace vdb_nns {

struct CellMap {
    // `home`: in whose stored coordinates the lattice's reference is; the source itself unless told.
    // `limit`: cell coordinates stay inside.
    CellMap(const ParticleSource& source, const Lattice& lattice, SimdLevel simd,
            const ParticleSource* home = nullptr, double limit = kCellLimit);

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

    // Says how far the particles reach and which radius works, with so many cells a radius; or which cells do, where they were
    // given and not chosen for a radius. `coordinateError` is what errorCells() gave, or 0 when cell coordinates are out of range.
    InputError rangeError(const ParticleSource& source, double coordinateError,
                          std::optional<double> cellsPerRadius) const;

    Vec3d reference;

private:
    double cell(int axis, double cx, double cy, double cz) const
    {
        const auto& m = mMatrix[axis];
        return m[0] * cx + m[1] * cy + m[2] * cz;
    }
    void setHome(const ParticleSource& source, const ParticleSource& home);

    double mRadius; // of the lattice
    double mCellsPerUnit, mLimit;
    Matrix3 mMatrix;        // linear * cells in a unit
    Matrix3 mSpread;        // |mMatrix| |its inverse|
    Vec3d mOffset{};        // of the reference from the lattice's, in cells
    bool mIsArray, mIsHome; // whether the offset is 0 by definition
    LocateAxisFunction mLocateAxis;
};

// Cell 0 to 7 of a leaf-local coordinate. 2^-21 low, so that the sum cannot round up to 8.
inline unsigned cellInLeaf(float local)
{
    return static_cast<unsigned>(static_cast<int>(local + (4 - 0x1p-21f)));
}

// Bound on the cell coordinates of a leaf along an axis, from the number of the leaf.
inline double mostCellsOf(std::int32_t leaf)
{
    return std::fabs(leaf * 8.0 + 4) + 4;
}

struct Bounds {
    Vec3d low, high;
};

// Bounding box of the finite particles in stored coordinates less `reference`; zero without any. One pass.
Bounds boundsOf(const ParticleSource& source, const Vec3d& reference);

} // namespace vdb_nns
