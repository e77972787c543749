#include "points/pair_geometry.h"

#include "util/dyadic.h"

#include <cmath>

namespace vdb_nns {

bool haveSameCoordinates(const ParticleSource& a, const ParticleSource& b)
{
    return a.isArray() == b.isArray() && a.linear() == b.linear() && a.translation() == b.translation();
}

Vec3d worldOffset(const ParticleSource& sourceA, const Vec3d& a, const ParticleSource& sourceB,
                  const Vec3d& b)
{
    Vec3d offset;
    for (int k = 0; k < 3; ++k) {
        Dyadic sum = Dyadic(sourceA.translation()[k]) - Dyadic(sourceB.translation()[k]);
        for (int c = 0; c < 3; ++c) {
            sum = sum + Dyadic(sourceA.linear()[k][c]) * Dyadic(a[c]);
            sum = sum - Dyadic(sourceB.linear()[k][c]) * Dyadic(b[c]);
        }
        offset[k] = sum.toDouble();
    }
    return offset;
}

Vec3d worldOf(const ParticleSource& source, const StoredPosition& p)
{
    if (source.isArray()) return {p.offset[0], p.offset[1], p.offset[2]};
    const Matrix3& m = source.linear();
    Vec3d world;
    double stored[3];
    for (int c = 0; c < 3; ++c) stored[c] = static_cast<double>(p.voxel[c]) + p.offset[c];
    for (int k = 0; k < 3; ++k) {
        world[k] =
            ((m[k][0] * stored[0] + m[k][1] * stored[1]) + m[k][2] * stored[2]) + source.translation()[k];
    }
    return world;
}

double PairDistance::ofTwo(std::size_t query, std::size_t candidate) const
{
    const ParticleSource &queries = mQueries.source(), &candidates = mCandidates.source();
    const StoredPosition a = queries.stored(query), b = candidates.stored(candidate);
    double w[3];
    if (mIsAlike) {
        double d[3];
        for (int c = 0; c < 3; ++c)
            d[c] = static_cast<double>(b.voxel[c] - a.voxel[c]) + (b.offset[c] - a.offset[c]);
        const Matrix3& m = queries.linear();
        for (int k = 0; k < 3; ++k)
            w[k] = queries.isArray() ? d[k] : (m[k][0] * d[0] + m[k][1] * d[1]) + m[k][2] * d[2];
    } else {
        const Vec3d from = worldOf(queries, a), to = worldOf(candidates, b);
        for (int k = 0; k < 3; ++k) w[k] = to[k] - from[k];
    }
    return std::sqrt((w[0] * w[0] + w[1] * w[1]) + w[2] * w[2]);
}

} // namespace vdb_nns
