// See cell_map.h.
#include "grid/cell_map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

namespace vdb_nns {

CellMap::CellMap(const ParticleSource& source, double radius, int reach)
    : reference(source.reference()), mRadius(radius), mIsArray(source.isArray())
{
    // Where the reciprocal would leave the normal numbers, cells are wider than they need be, which is always correct.
    cellsPerUnit = radius > 1e300    ? std::ldexp(1.0, -1025)
                   : radius < 1e-290 ? 1e289
                                     : reach / (radius * (1 + kHair));
    for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 3; ++c) mMatrix[k][c] = source.linear()[k][c] * cellsPerUnit;
    }
}

void CellMap::toCells(const double* cx, const double* cy, const double* cz, std::size_t count, double* tx, double* ty,
                      double* tz) const
{
    const double* const in[3] = {cx, cy, cz};
    double* const out[3] = {tx, ty, tz};
    for (int k = 0; k < 3; ++k) {
        if (mIsArray) {
            for (std::size_t i = 0; i < count; ++i) out[k][i] = in[k][i] * cellsPerUnit;
        } else {
            const double m0 = mMatrix[k][0], m1 = mMatrix[k][1], m2 = mMatrix[k][2];
            for (std::size_t i = 0; i < count; ++i) out[k][i] = m0 * cx[i] + m1 * cy[i] + m2 * cz[i];
        }
    }
}

double CellMap::errorCells(const double most[3]) const
{
    double worst = 0;
    for (int k = 0; k < 3; ++k) {
        double sum = 0;
        for (int c = 0; c < 3; ++c) sum += most[c] == 0 ? 0 : std::fabs(mMatrix[k][c]) * most[c];
        worst = std::max(worst, sum);
    }
    return 6 * 0x1p-53 * worst;
}

InputError CellMap::rangeError(const double most[3]) const
{
    const double extentCells = errorCells(most) / (6 * 0x1p-53);
    std::ostringstream text;
    text.precision(9);
    text << "the particles reach " << extentCells << " cells from the middle (" << extentCells / cellsPerUnit
         << " world units, cell edge " << 1 / cellsPerUnit << " for radius " << mRadius
         << "), the limit is 2^31 - 4096 cells: remove the outliers or use a radius of at least "
         << mRadius * (extentCells / kLimit) * 1.001;
    return InputError(text.str());
}

Vec3d middleOf(const ParticleSource& source)
{
    constexpr std::size_t kBatch = 512;
    constexpr double inf = std::numeric_limits<double>::infinity();
    double low[3] = {inf, inf, inf}, high[3] = {-inf, -inf, -inf}, c[3][kBatch];
    for (std::size_t begin = 0; begin < source.size(); begin += kBatch) {
        const std::size_t n = std::min(kBatch, source.size() - begin);
        source.read(begin, n, Vec3d{}, c[0], c[1], c[2]);
        for (std::size_t i = 0; i < n; ++i) {
            if (!std::isfinite(c[0][i]) || !std::isfinite(c[1][i]) || !std::isfinite(c[2][i])) continue;
            for (int k = 0; k < 3; ++k) {
                low[k] = std::min(low[k], c[k][i]);
                high[k] = std::max(high[k], c[k][i]);
            }
        }
    }
    Vec3d middle{};
    for (int k = 0; k < 3; ++k) middle[k] = low[k] <= high[k] ? low[k] / 2 + high[k] / 2 : 0;
    return middle;
}

} // namespace vdb_nns
