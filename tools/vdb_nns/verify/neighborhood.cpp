#include "neighborhood.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

namespace {

// Of positions: a few roundings of each term, and what a factor of two is worth.
constexpr Real kPositionError = 0x1p-50L;

struct World {
    Vector3 place{};
    Real terms = 0; // the largest sum of absolute values that a coordinate is made of
};

World worldOf(const ParticleView& view, const AffineMap& map, std::uint64_t i)
{
    const StoredPosition at = view.stored(i);
    World world;
    for (std::size_t k = 0; k < 3; ++k) {
        Real terms = std::fabs(map.translation[k]);
        world.place[k] = map.translation[k];
        for (std::size_t c = 0; c < 3; ++c) {
            const Real voxel = static_cast<Real>(at.voxel[c]), m = map.linear[k][c];
            world.place[k] += m * (voxel + at.offset[c]);
            terms += std::fabs(m) * (std::fabs(voxel) + std::fabs(static_cast<Real>(at.offset[c])));
        }
        world.terms = std::max(world.terms, terms);
    }
    return world;
}

Vector3 offsetInOneSet(const SearchJudge& judge, std::uint64_t i, std::uint64_t j)
{
    const ParticleView& view = judge.terms().candidates.view;
    const StoredPosition a = view.stored(i), b = view.stored(j);
    const Matrix3& m = judge.candidateMap().linear;
    Vector3 offset{};
    for (std::size_t c = 0; c < 3; ++c) {
        const Real step =
            static_cast<Real>(b.voxel[c] - a.voxel[c]) + (static_cast<Real>(b.offset[c]) - a.offset[c]);
        for (std::size_t k = 0; k < 3; ++k) offset[k] += m[k][c] * step;
    }
    return offset;
}

Vector3 offsetBetweenSets(const SearchJudge& judge, const World& query, std::uint64_t j)
{
    const World candidate = worldOf(judge.terms().candidates.view, judge.candidateMap(), j);
    Vector3 offset{};
    for (std::size_t k = 0; k < 3; ++k) offset[k] = candidate.place[k] - query.place[k];
    return offset;
}

} // namespace

Neighborhood neighborhoodOf(const SearchJudge& judge, std::uint32_t query,
                            const std::vector<std::uint32_t>& row)
{
    Neighborhood result;
    result.query = query;
    result.isQuery = judge.isQuery(query);
    if (!judge.isFiniteQuery(query)) return result;
    const World world = worldOf(judge.terms().queries.view, judge.queryMap(), query);
    result.position = world.place;
    result.positionError = kPositionError * world.terms;
    for (const std::uint32_t j : row) {
        Near near{j, {}, 0, judge.radius(query, j), 0};
        near.offset = judge.isOneSet() ? offsetInOneSet(judge, query, j) : offsetBetweenSets(judge, world, j);
        for (const Real step : near.offset) near.distance += step * step;
        near.distance = std::sqrt(near.distance);
        const Interval enclosed = judge.distance(query, j);
        near.error = static_cast<Real>(enclosed.high) - enclosed.low;
        result.neighbors.push_back(near);
    }
    result.all = result.neighbors;
    const bool countsItself =
        judge.isOneSet() && result.isQuery && judge.isCandidate(query) && judge.radius(query, query) > 0;
    if (countsItself) result.all.push_back({query, {}, 0, judge.radius(query, query), 0});
    return result;
}

} // namespace vdb_nns::cli
