#include "grid/cell_map.h"

#include "points/pair_geometry.h"

#include <Eigen/Dense>

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

namespace vdb_nns {

CellMap::CellMap(const ParticleSource& source, const Lattice& lattice, SimdLevel simd,
                 const ParticleSource* home, double limit)
    : reference(lattice.reference),
      mRadius(lattice.radius),
      mCellsPerUnit(cellsPerUnit(lattice)),
      mLimit(limit),
      mIsArray(source.isArray()),
      mIsHome(!home || haveSameCoordinates(source, *home)),
      mLocateAxis(kernelsFor(simd).locateAxis)
{
    for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 3; ++c) mMatrix[k][c] = source.linear()[k][c] * mCellsPerUnit;
    }
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const Eigen::Map<const RowMajor> linear(source.linear()[0].data());
    Eigen::Map<RowMajor>(mSpread[0].data()) = linear.cwiseAbs() * linear.inverse().cwiseAbs();
    if (!mIsHome) setHome(source, *home);
}

// The reference becomes a place that the source can store, near that of the lattice.
void CellMap::setHome(const ParticleSource& source, const ParticleSource& home)
{
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const auto matrixOf = [](const ParticleSource& s) {
        return Eigen::Map<const RowMajor>(s.linear()[0].data());
    };
    const auto vectorOf = [](const Vec3d& v) { return Eigen::Map<const Eigen::Vector3d>(v.data()); };
    const Vec3d latticeReference = reference;
    const Eigen::Vector3d world = matrixOf(home) * vectorOf(latticeReference) + vectorOf(home.translation());
    const Eigen::Vector3d stored = matrixOf(source).inverse() * (world - vectorOf(source.translation()));
    for (int k = 0; k < 3; ++k) {
        const double rounded = mIsArray ? stored[k] : std::nearbyint(stored[k]);
        reference[k] = std::fabs(rounded) < kCellLimit || (mIsArray && std::isfinite(rounded))
                           ? rounded
                           : source.reference()[k];
    }
    const Vec3d offset = worldOffset(source, reference, home, latticeReference);
    for (int k = 0; k < 3; ++k) mOffset[k] = offset[k] * mCellsPerUnit;
}

bool CellMap::locate(const double (*stored)[kBatch], std::size_t count, Located& out) const
{
    bool inside = true;
    for (int k = 0; k < 3; ++k) {
        double t[kBatch];
        if (mIsArray) {
            for (std::size_t i = 0; i < count; ++i) t[i] = stored[k][i] * mCellsPerUnit;
        } else {
            for (std::size_t i = 0; i < count; ++i) t[i] = cell(k, stored[0][i], stored[1][i], stored[2][i]);
        }
        if (!mIsHome) {
            for (std::size_t i = 0; i < count; ++i) t[i] += mOffset[k];
        }
        inside &= mLocateAxis(t, count, mLimit, out.leaf[k], out.local[k]);
    }
    return inside;
}

bool CellMap::inRange(double cx, double cy, double cz) const
{
    const double stored[3] = {cx, cy, cz};
    for (int k = 0; k < 3; ++k) {
        double t = mIsArray ? stored[k] * mCellsPerUnit : cell(k, cx, cy, cz);
        if (!mIsHome) t += mOffset[k];
        if (!(std::fabs(t) < mLimit)) return false;
    }
    return true;
}

double CellMap::errorCells(const double mostCells[3]) const
{
    double worst = 0;
    for (int k = 0; k < 3; ++k) {
        double sum = 0;
        for (int c = 0; c < 3; ++c) {
            const double most = mostCells[c] + std::fabs(mOffset[c]);
            sum += mSpread[k][c] == 0 ? 0 : mSpread[k][c] * most;
        }
        const double shift = mIsHome ? 0 : mostCells[k] + std::fabs(mOffset[k]);
        worst = std::max(worst, 7 * sum + 4 * shift);
    }
    return 0x1p-53 * worst;
}

InputError CellMap::rangeError(const ParticleSource& source, double coordinateError,
                               std::optional<double> cellsPerRadius) const
{
    const Bounds bounds = boundsOf(source, reference);
    const Matrix3& m = source.linear();
    double extent = 0; // world units: cells may be too many for a double
    for (int corner = 0; corner < 8; ++corner) {
        const double c[3] = {(corner & 1 ? bounds.high : bounds.low)[0],
                             (corner & 2 ? bounds.high : bounds.low)[1],
                             (corner & 4 ? bounds.high : bounds.low)[2]};
        for (const auto& row : m) {
            extent = std::max(extent, mIsArray ? std::max({std::fabs(c[0]), std::fabs(c[1]), std::fabs(c[2])})
                                               : std::fabs(row[0] * c[0] + row[1] * c[1] + row[2] * c[2]));
        }
    }
    // A little more than needed, so that no rounding of the text undoes it.
    constexpr double kMore = 1.001;
    double smallest = extent / kCellLimit * kMore; // edge of a cell
    std::ostringstream text;
    text.precision(9);
    text << "the particles reach " << extent << " world units from the "
         << (cellsPerRadius ? "middle, " : "reference of the lattice, ") << (extent * mCellsPerUnit)
         << " cells of edge " << 1 / mCellsPerUnit << " for radius " << mRadius << "; ";
    if (coordinateError > kMaxErrorCells) {
        // With cells f times as large the bound is at most coordinateError / f, and what rounding up to leaves adds.
        constexpr double kLeaf[3] = {8, 8, 8};
        const double left = kMaxErrorCells - errorCells(kLeaf);
        smallest = left > 0 ? std::max(smallest, coordinateError / left / mCellsPerUnit * kMore)
                            : std::numeric_limits<double>::infinity();
        text << "the transform is so nearly singular there that a cell coordinate may be wrong by "
             << coordinateError << " cells, the limit is " << kMaxErrorCells;
    } else {
        text << "the limit is 2^31 - 4096 cells";
    }
    text << ": remove the outliers or use ";
    if (cellsPerRadius) {
        text << "a radius of at least " << smallest * *cellsPerRadius;
    } else {
        text << "a lattice with cells of at least " << smallest;
    }
    return InputError(text.str());
}

Bounds boundsOf(const ParticleSource& source, const Vec3d& reference)
{
    constexpr std::size_t kBatch = CellMap::kBatch;
    constexpr double inf = std::numeric_limits<double>::infinity();
    Bounds bounds{{inf, inf, inf}, {-inf, -inf, -inf}};
    double c[3][kBatch];
    for (std::size_t begin = 0; begin < source.size(); begin += kBatch) {
        const std::size_t n = std::min(kBatch, source.size() - begin);
        source.read(begin, n, reference, c[0], c[1], c[2]);
        for (std::size_t i = 0; i < n; ++i) {
            if (!std::isfinite(c[0][i]) || !std::isfinite(c[1][i]) || !std::isfinite(c[2][i])) continue;
            for (int k = 0; k < 3; ++k) {
                bounds.low[k] = std::min(bounds.low[k], c[k][i]);
                bounds.high[k] = std::max(bounds.high[k], c[k][i]);
            }
        }
    }
    if (bounds.low[0] > bounds.high[0]) bounds = {};
    return bounds;
}

} // namespace vdb_nns
