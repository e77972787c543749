// From stored positions to cell coordinates, with a bound on the rounding.
//
// The true cell coordinate of a particle is tau = linear * (stored - reference) * cellsPerUnit, in real arithmetic; t is
// what toCells() computes. Per axis |t - tau| <= errorCells(most), where most bounds |stored - reference|:
//   arrays: c = stored - reference (1 rounding), c * cellsPerUnit (1)
//   grids:  c (1), each product m * c with m = linear * cellsPerUnit (1 for m, 1 for the product), two sums (2)
// so at most 5 relative roundings of u = 2^-53 of sum |m| |c|; 6 u covers their products.
//
// A cell is a hair wider than radius / reach: two particles within the radius differ by at most radiusCells in tau, so
// by radiusCells + 2 (E + 2^-23 + 2^-22) in the coordinate that decides the cell (t rounded to float about the leaf's
// centre, then + 4 rounded again, see cellInLeaf). radiusCells = reach / (1 + 2^-16), so with E <= 7e-6 that is below
// reach, and their cells differ by at most reach: no pair is lost at a cell face.
#pragma once

#include "particles/particle_source.h"
#include "vdb_nns/error.h"

#include <cstdint>

namespace vdb_nns {

struct CellMap {
    static constexpr double kHair = 1.0 / 65536;
    static constexpr double kMaxErrorCells = 7e-6;
    static constexpr double kLimit = 2147483648.0 - 4096; // cell coordinates stay inside

    CellMap(const ParticleSource& source, double radius, int reach);

    void toCells(const double* cx, const double* cy, const double* cz, std::size_t count, double* tx, double* ty,
                 double* tz) const;

    double errorCells(const double most[3]) const;

    // False for NaN too.
    static bool inRange(double t) { return t > -kLimit && t < kLimit; }

    InputError rangeError(const double most[3]) const;

    Vec3d reference;
    double cellsPerUnit;

private:
    double mRadius;
    Matrix3 mMatrix; // linear * cellsPerUnit
    bool mIsArray;
};

inline std::int32_t floorToInt(double t)
{
    const auto i = static_cast<std::int32_t>(t);
    return i - (t < i);
}

// The coordinate about the centre of its leaf, in cells: |.| <= 4. Exact but for the rounding to float (2^-23).
inline float leafLocal(double t)
{
    return static_cast<float>(t - ((floorToInt(t) & ~7) + 4));
}

// Cell 0 to 7 of a leaf-local coordinate. The sum may round up to 8.
inline unsigned cellInLeaf(float local)
{
    const int cell = static_cast<int>(local + 4.0f);
    return static_cast<unsigned>(cell > 7 ? 7 : cell);
}

// Middle of the finite particles' bounding box in stored coordinates. One pass.
Vec3d middleOf(const ParticleSource& source);

} // namespace vdb_nns
