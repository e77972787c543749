//
// Error of a coordinate. s_c = (voxel - reference voxel) + offset has |error| <= u |s_c|, u = 2^-53. p_k is the sum of three
// products m_kc s_c: each product errs by u of itself and takes 1 more u from s_c, two additions add 2 u at most of the
// sum of the absolute values A = sum_c |m_kc| |s_c|. So |error p_k| <= 4.01 u A + a few denormal steps (products that
// underflow); `error` is 8 u max A + 2^-1068, more than that.
//
// Cells. Two neighbors differ by at most r + 2 error in a computed coordinate. floor(p / edge) adds the rounding of the
// quotient, u |p| / edge, which is below error / 8 / edge. With edge >= r (1 + 1e-9) + 4 error the quotients differ by less
// than 1, the floors by at most 1. |p| / edge <= 2^48: the floors are exact integers.
//
// Bounds. The difference of two computed coordinates is within 2 error + u |difference| of the true one, the distance
// within 2 sqrt(3) error + a few u of itself. With delta = 4 error + 1e-14 (r + error): a computed squared distance up to
// (r - delta)^2 (1 - 1e-14) is a neighbor's, one above (r + delta)^2 (1 + 1e-14) is not.
#include "point_cells.h"

#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

namespace {

constexpr std::size_t kChunk = 8192; // particles a task: fits the second-level cache

// Fills world positions about the reference; returns the largest A (see above) of the finite points.
double readPositions(const ParticleView& view, PointCloud& cloud)
{
    if (view.size() == 0) return 0;
    const StoredPosition reference = view.stored(view.size() / 2);
    const Matrix3& m = view.linear();
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, view.size(), kChunk), 0.0,
        [&](const tbb::blocked_range<std::size_t>& range, double largest) {
            double* p[3] = {cloud.x.data() + range.begin(), cloud.y.data() + range.begin(),
                            cloud.z.data() + range.begin()};
            for (std::size_t i = 0; i < range.size(); ++i) {
                const StoredPosition at = view.stored(range.begin() + i);
                double s[3];
                for (std::size_t k = 0; k < 3; ++k) {
                    s[k] = static_cast<double>(at.voxel[k] - reference.voxel[k]) + at.offset[k];
                }
                const bool finite = std::isfinite(s[0]) && std::isfinite(s[1]) && std::isfinite(s[2]);
                for (std::size_t k = 0; k < 3; ++k) {
                    double position = 0, terms = 0;
                    for (std::size_t c = 0; c < 3; ++c) {
                        position += m[k][c] * s[c];
                        terms += std::fabs(m[k][c] * s[c]);
                    }
                    p[k][i] = finite ? position : std::nan("");
                    if (finite) largest = std::max(largest, terms);
                }
            }
            return largest;
        },
        [](double a, double b) { return std::max(a, b); });
}

} // namespace

PointCloud makeCloud(const ParticleView& view, double radius)
{
    PointCloud cloud;
    for (auto* axis : {&cloud.x, &cloud.y, &cloud.z}) axis->resize(view.size());
    const double error = 0x1p-50 * readPositions(view, cloud) + 0x1p-1068;
    const double edge = radius * (1 + 1e-9) + 4 * error;
    if (!(edge < 1e300)) {
        throw InputError(
            "verify: positions or radius are beyond 1e300, too large for the double arithmetic of verify");
    }
    const int scale = -std::ilogb(edge);
    cloud.error = std::ldexp(error, scale);
    cloud.radius = std::ldexp(radius, scale);
    cloud.edge = std::ldexp(edge, scale);
    const double delta = 4 * cloud.error + 1e-14 * (cloud.radius + cloud.error);
    const double inner = cloud.radius - delta, outer = cloud.radius + delta;
    cloud.sureWithin = inner > 0 ? inner * inner * (1 - 1e-14) : -1;
    cloud.sureBeyond = outer * outer * (1 + 1e-14);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, view.size(), kChunk), [&](const auto& range) {
        for (auto* axis : {&cloud.x, &cloud.y, &cloud.z}) {
            for (std::size_t i = range.begin(); i < range.end(); ++i)
                (*axis)[i] = std::ldexp((*axis)[i], scale);
        }
    });
    cloud.finite.reserve(view.size());
    for (std::size_t i = 0; i < view.size(); ++i) {
        if (!std::isnan(cloud.x[i])) cloud.finite.push_back(static_cast<std::uint32_t>(i));
    }
    return cloud;
}

StoredPoint PairJudge::point(std::uint64_t i) const
{
    const StoredPosition stored = mView.stored(i);
    StoredPoint point{};
    for (int k = 0; k < 3; ++k) {
        point.voxel[k] = stored.voxel[k];
        point.offset[k] = stored.offset[k];
    }
    return point;
}

bool PairJudge::within(std::uint32_t i, std::uint32_t j) const
{
    return withinRadius(point(i), point(j), mView.linear(), mRadius);
}

CellHash::CellHash(const PointCloud& cloud)
    : CellHash(cloud.x.data(), cloud.y.data(), cloud.z.data(), cloud.finite, cloud.edge)
{
}

CellHash::CellHash(const double* x, const double* y, const double* z,
                   const std::vector<std::uint32_t>& numbers, double edge)
    : mEdge(edge)
{
    struct Place {
        CellKey key;
        std::uint32_t number;
        bool operator<(const Place& other) const
        {
            return key != other.key ? key < other.key : number < other.number;
        }
    };
    std::vector<Place> places(numbers.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, places.size(), kChunk), [&](const auto& range) {
        const auto cell = [&](double p) { return static_cast<std::int64_t>(std::floor(p / edge)); };
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
            const std::uint32_t i = numbers[k];
            places[k] = {{cell(x[i]), cell(y[i]), cell(z[i])}, i};
        }
    });
    tbb::parallel_sort(places.begin(), places.end());
    mNumbers.resize(places.size());
    for (std::size_t k = 0; k < places.size(); ++k) {
        mNumbers[k] = places[k].number;
        if (k > 0 && places[k].key == places[k - 1].key) continue;
        mKeys.push_back(places[k].key);
        mBegin.push_back(k);
    }
    mBegin.push_back(places.size());
    hashKeys();
}

namespace {

// Odd multipliers of 64 bits, mixed so that neighbors in space are far apart in the table.
std::size_t hashOf(const CellKey& key)
{
    std::uint64_t h = static_cast<std::uint64_t>(key[0]) * 0x9e3779b97f4a7c15ULL;
    h = (h ^ (h >> 32)) + static_cast<std::uint64_t>(key[1]);
    h *= 0xc2b2ae3d27d4eb4fULL;
    h = (h ^ (h >> 29)) + static_cast<std::uint64_t>(key[2]);
    h *= 0x165667b19e3779f9ULL;
    return static_cast<std::size_t>(h ^ (h >> 32));
}

} // namespace

void CellHash::hashKeys()
{
    std::size_t places = 16;
    while (places < 2 * mKeys.size()) places *= 2;
    mTable.assign(places, 0);
    for (std::size_t cell = 0; cell < mKeys.size(); ++cell) {
        std::size_t at = hashOf(mKeys[cell]) & (places - 1);
        while (mTable[at]) at = (at + 1) & (places - 1);
        mTable[at] = static_cast<std::uint32_t>(cell + 1);
    }
}

std::size_t CellHash::find(const CellKey& key) const
{
    const std::size_t mask = mTable.size() - 1;
    for (std::size_t at = hashOf(key) & mask; mTable[at]; at = (at + 1) & mask) {
        if (mKeys[mTable[at] - 1] == key) return mTable[at] - 1;
    }
    return kNone;
}

} // namespace vdb_nns::cli
