// Error of a coordinate. s_c = (voxel - reference voxel) + offset has |error| <= u |s_c|, u = 2^-53. p_k is the sum of three
// products m_kc s_c and of D_k, which is where the reference voxel of the set is about the common reference, rounded once
// (0 for one set: the reference is that voxel then). Each product errs by u of itself and takes 1 more u from s_c, D_k errs by
// u of itself, and three additions add 3 u at most of the sum of the absolute values A = sum_c |m_kc| |s_c| + |D_k|. So
// |error p_k| <= 5.01 u A + a few denormal steps (products that underflow); `error` is 8 u max A + 2^-1068, more than that.
//
// Cells. Two points within r of each other differ by at most r + 2 error in a computed coordinate. floor(p / edge) adds the
// rounding of the quotient, u |p| / edge, which is below error / 8 / edge. With edge >= r (1 + 1e-9) + 4 error the quotients
// differ by less than 1, the floors by at most 1. |p| / edge <= 2^48: the floors are exact integers.
//
// Bounds. The difference of two computed coordinates is within 2 error + u |difference| of the true one, the distance
// within 2 sqrt(3) error + a few u of itself. With delta = 4 error + 1e-14 (r + error): a computed squared distance up to
// (r - delta)^2 (1 - 1e-14) is a neighbor's, one above (r + delta)^2 (1 + 1e-14) is not. Squares below 1e-280 may have lost
// bits to underflow: none of them is sure to be within, and none is beyond.
#include "search_clouds.h"

#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

namespace {

constexpr std::size_t kChunk = 8192; // particles a task: fits the second-level cache
constexpr double kSmallestSquare = 1e-280;

struct Frame {
    const ParticleView& view;
    StoredPosition reference; // its voxel is read
    Vec3d place;              // of that voxel about the common reference
};

Frame frameOf(const ParticleView& view)
{
    return {view, view.size() == 0 ? StoredPosition{} : view.stored(view.size() / 2), {}};
}

// Fills positions; isWanted(i) of finite points. Returns the largest A (see above) of those that are wanted.
template <typename IsWanted>
double readPositions(const Frame& frame, const IsWanted& isWanted, SearchCloud& cloud)
{
    const ParticleView& view = frame.view;
    const Matrix3& m = view.linear();
    for (auto* axis : {&cloud.x, &cloud.y, &cloud.z}) axis->resize(view.size());
    const double largest = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, view.size(), kChunk), 0.0,
        [&](const tbb::blocked_range<std::size_t>& range, double most) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                const StoredPosition at = view.stored(i);
                double s[3], p[3];
                for (std::size_t k = 0; k < 3; ++k)
                    s[k] = static_cast<double>(at.voxel[k] - frame.reference.voxel[k]) + at.offset[k];
                const bool isThere =
                    std::isfinite(s[0]) && std::isfinite(s[1]) && std::isfinite(s[2]) && isWanted(i);
                for (std::size_t k = 0; k < 3; ++k) {
                    double terms = std::fabs(frame.place[k]);
                    p[k] = 0;
                    for (std::size_t c = 0; c < 3; ++c) {
                        p[k] += m[k][c] * s[c];
                        terms += std::fabs(m[k][c] * s[c]);
                    }
                    p[k] = isThere ? p[k] + frame.place[k] : std::nan("");
                    if (isThere) most = std::max(most, terms);
                }
                cloud.x[i] = p[0], cloud.y[i] = p[1], cloud.z[i] = p[2];
            }
            return most;
        },
        [](double a, double b) { return std::max(a, b); });
    for (std::size_t i = 0; i < view.size(); ++i) {
        if (!std::isnan(cloud.x[i])) cloud.numbers.push_back(static_cast<std::uint32_t>(i));
    }
    return largest;
}

void scaleBy(int scale, SearchCloud& cloud)
{
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, cloud.x.size(), kChunk), [&](const auto& range) {
        for (auto* axis : {&cloud.x, &cloud.y, &cloud.z}) {
            for (std::size_t i = range.begin(); i < range.end(); ++i)
                (*axis)[i] = std::ldexp((*axis)[i], scale);
        }
    });
}

// The largest radius of a point that has a role it is read for, or 0.
double largestRadius(const SearchJudge& judge, const SearchClouds& clouds)
{
    double largest = 0;
    for (const std::uint32_t i : clouds.queries->numbers) largest = std::max(largest, judge.queryRadius(i));
    for (const std::uint32_t j : clouds.candidates->numbers)
        largest = std::max(largest, judge.candidateRadius(j));
    return largest;
}

} // namespace

double SearchClouds::scaled(double radius) const
{
    return radius > 0 ? std::ldexp(std::min(radius, cap), scale) : 0;
}

Bounds SearchClouds::bounds(double radius) const
{
    if (!(radius > 0)) return {};
    const double r = scaled(radius);
    const double delta = 4 * error + 1e-14 * (r + error);
    const double inner = r - delta, outer = r + delta;
    const double within = inner > 0 ? inner * inner * (1 - 1e-14) : -1;
    return {within < kSmallestSquare ? -1 : within, std::max(outer * outer * (1 + 1e-14), kSmallestSquare)};
}

double SearchClouds::cellEdge(double scaledRadius) const
{
    constexpr double kSmallest = 0x1p-40; // the largest edge is about 1; no tiny radius gets cells of its own
    return std::max(scaledRadius * (1 + 1e-9) + 4 * error, kSmallest);
}

SearchClouds makeClouds(const SearchJudge& judge)
{
    const SearchTerms& terms = judge.terms();
    SearchClouds clouds;
    Frame queries = frameOf(terms.queries.view), candidates = frameOf(terms.candidates.view);
    if (!judge.isOneSet()) {
        const Vec3d origin = worldOffset(judge.candidateMap(), candidates.reference.voxel, {});
        candidates.place = worldOffset(judge.candidateMap(), candidates.reference.voxel, origin);
        queries.place = worldOffset(judge.queryMap(), queries.reference.voxel, origin);
    }
    clouds.candidates = std::make_shared<SearchCloud>();
    double most = readPositions(
        candidates, [&](std::size_t j) { return judge.isCandidate(j); }, *clouds.candidates);
    const bool isShared = judge.isOneSet() && terms.queries.chosen.empty() && terms.candidates.chosen.empty();
    clouds.queries = isShared ? clouds.candidates : std::make_shared<SearchCloud>();
    if (!isShared) {
        const auto isQuery = [&](std::size_t i) { return judge.isQuery(i); };
        most = std::max(most, readPositions(queries, isQuery, *clouds.queries));
    }
    const double error = 0x1p-50 * most + 0x1p-1068;
    if (!(most < 1e299)) {
        throw InputError("verify: positions are beyond 1e299, too large for the double arithmetic of verify");
    }
    clouds.cap = 16 * (most + error); // coordinates are below most + error
    const double radius = std::min(largestRadius(judge, clouds), clouds.cap);
    clouds.scale = -std::ilogb(radius * (1 + 1e-9) + 4 * error);
    clouds.error = std::ldexp(error, clouds.scale);
    clouds.largestRadius = clouds.scaled(radius);
    scaleBy(clouds.scale, *clouds.candidates);
    if (!isShared) scaleBy(clouds.scale, *clouds.queries);
    return clouds;
}

} // namespace vdb_nns::cli
