#include "search_judge.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace vdb_nns::cli {

namespace {

constexpr double kReachesNobody = -std::numeric_limits<double>::infinity();

double usable(double radius)
{
    return radius > 0 && std::isfinite(radius) ? radius : kReachesNobody;
}

StoredPoint stored(const ParticleView& view, std::uint64_t i)
{
    const StoredPosition position = view.stored(i);
    StoredPoint point{};
    for (int k = 0; k < 3; ++k) {
        point.voxel[k] = position.voxel[k];
        point.offset[k] = position.offset[k];
    }
    return point;
}

bool isFinite(const ParticleView& view, std::uint64_t i)
{
    const StoredPosition p = view.stored(i);
    return std::isfinite(p.offset[0]) && std::isfinite(p.offset[1]) && std::isfinite(p.offset[2]);
}

bool isChosen(const ParticleSet& set, std::uint64_t i)
{
    return set.chosen.empty() || set.chosen[i] != 0;
}

// With u = 2^-53: a difference of offsets errs by u of itself, adding the integer difference of voxels by u of the sum,
// product and sums by 4 u of the terms, squares, sums and root by 4 u of the result, so that 16 u of all terms is more than
// enough; the last term covers denormal steps.
constexpr double kRelativeError = 16 * 0x1p-53, kSmallestError = 0x1p-1068;

Interval enclosed(const double (&component)[3], double terms)
{
    const double distance = std::hypot(component[0], component[1], component[2]);
    const double error = kRelativeError * terms + kSmallestError;
    return {std::max(0.0, distance - error), distance + error};
}

Interval distanceInOneSet(const StoredPoint& a, const StoredPoint& b, const Matrix3& m)
{
    double component[3] = {0, 0, 0}, terms = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto voxels = static_cast<double>(b.voxel[c] - a.voxel[c]);
        const double offset = b.offset[c] - a.offset[c];
        for (std::size_t k = 0; k < 3; ++k) {
            component[k] += m[k][c] * (voxels + offset);
            terms += std::fabs(m[k][c]) * (std::fabs(voxels + offset) + std::fabs(offset));
        }
    }
    return enclosed(component, terms);
}

// Adds sign * the world position, and the absolute values of its terms.
void addWorld(const PlacedPoint& at, double sign, double (&component)[3], double& terms)
{
    for (std::size_t k = 0; k < 3; ++k) {
        component[k] += sign * at.map->translation[k];
        terms += std::fabs(at.map->translation[k]);
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const auto voxel = static_cast<double>(at.point.voxel[c]);
        const double position = voxel + at.point.offset[c];
        for (std::size_t k = 0; k < 3; ++k) {
            component[k] += sign * at.map->linear[k][c] * position;
            terms += std::fabs(at.map->linear[k][c]) * (std::fabs(voxel) + std::fabs(at.point.offset[c]));
        }
    }
}

} // namespace

SearchJudge::SearchJudge(const SearchTerms& terms)
    : mTerms(terms),
      mIsOneSet(terms.isOneSet()),
      mQueryMap{terms.queries.view.linear(), terms.queryTranslation},
      mCandidateMap{terms.candidates.view.linear(), terms.candidateTranslation}
{
}

double SearchJudge::queryRadius(std::uint64_t query) const
{
    const Radius& radius = mTerms.radius;
    if (radius.isOne()) return radius.value;
    return radius.mode == RadiusMode::kScatter ? kReachesNobody : usable(radius.ofQueries[query]);
}

double SearchJudge::candidateRadius(std::uint64_t candidate) const
{
    const Radius& radius = mTerms.radius;
    const bool isRead = !radius.isOne() && radius.mode != RadiusMode::kGather;
    return isRead ? usable(radius.ofCandidates[candidate]) : kReachesNobody;
}

double SearchJudge::radius(std::uint64_t query, std::uint64_t candidate) const
{
    return std::max(queryRadius(query), candidateRadius(candidate));
}

PlacedPoint SearchJudge::query(std::uint64_t i) const
{
    return {stored(mTerms.queries.view, i), &queryMap()};
}

PlacedPoint SearchJudge::candidate(std::uint64_t j) const
{
    return {stored(mTerms.candidates.view, j), &mCandidateMap};
}

bool SearchJudge::within(std::uint32_t i, std::uint32_t j) const
{
    const double limit = radius(i, j);
    return limit > 0 && withinRadius(query(i), candidate(j), limit);
}

Dyadic SearchJudge::squaredDistance(std::uint32_t i, std::uint32_t j) const
{
    return cli::squaredDistance(query(i), candidate(j));
}

// Between two sets the terms are those of two positions: 16 u of them is more than enough for these sums, too.
Interval SearchJudge::distance(std::uint64_t i, std::uint64_t j) const
{
    const PlacedPoint a = query(i), b = candidate(j);
    if (mIsOneSet) return distanceInOneSet(a.point, b.point, mCandidateMap.linear);
    double component[3] = {0, 0, 0}, terms = 0;
    addWorld(b, 1, component, terms);
    addWorld(a, -1, component, terms);
    return enclosed(component, terms);
}

PairDistance SearchJudge::describe(std::uint64_t i, std::uint64_t j) const
{
    return describeDistance(query(i), candidate(j), radius(i, j));
}

bool SearchJudge::isFiniteQuery(std::uint64_t i) const
{
    return isFinite(mTerms.queries.view, i);
}

bool SearchJudge::isFiniteCandidate(std::uint64_t j) const
{
    return isFinite(mTerms.candidates.view, j);
}

bool SearchJudge::isQuery(std::uint64_t i) const
{
    return isChosen(mTerms.queries, i) && isFiniteQuery(i);
}

bool SearchJudge::isCandidate(std::uint64_t j) const
{
    return isChosen(mTerms.candidates, j) && isFiniteCandidate(j);
}

} // namespace vdb_nns::cli
