#include "bench/stability/case_points.h"

#include "vdb_nns/scene.h"

#include <memory>
#include <utility>

namespace vdb_nns::cli {
namespace {

template <typename Real>
CaseParticles asArray(const CasePoints& points)
{
    const auto xyz = std::make_shared<std::vector<Real>>();
    xyz->reserve(3 * points.at.size());
    for (const Vec3d& at : points.at) {
        for (const double x : at) xyz->push_back(static_cast<Real>(x));
    }
    return {ParticleView::fromArray(xyz->data(), points.at.size()), points.radius, points.known, xyz};
}

struct OwnedSets {
    std::vector<float> candidates, queries;
    SetPoints points;
};

std::vector<float> floatsOf(const std::vector<Vec3d>& at)
{
    std::vector<float> xyz;
    for (const Vec3d& p : at) {
        for (const double x : p) xyz.push_back(static_cast<float>(x));
    }
    return xyz;
}

template <typename T>
Span<const T> spanOf(const std::vector<T>& values)
{
    return {values.data(), values.size()};
}

} // namespace

void addLattice(std::vector<Vec3d>& points, const Vec3d& center, const Vec3i& n, double jitter,
                CaseRandom& random)
{
    const auto place = [&](std::size_t axis, int i) {
        return center[axis] + (i - 0.5 * (n[axis] - 1)) + (jitter > 0 ? random.uniform(-jitter, jitter) : 0);
    };
    for (int x = 0; x < n[0]; ++x) {
        for (int y = 0; y < n[1]; ++y) {
            for (int z = 0; z < n[2]; ++z) points.push_back({place(0, x), place(1, y), place(2, z)});
        }
    }
}

CasePoints blockPoints(int edge, const Vec3d& center)
{
    CasePoints points;
    CaseRandom random(1);
    addLattice(points.at, center, {edge, edge, edge}, kJitter, random);
    return points;
}

CasePoints scenePoints(const std::string& name, std::uint64_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    const Scene scene = makeScene(options);
    CasePoints points;
    points.radius = scene.suggestedRadius;
    for (std::size_t i = 0; i < scene.positions.size(); i += 3) {
        points.at.push_back({scene.positions[i], scene.positions[i + 1], scene.positions[i + 2]});
    }
    return points;
}

CasePoints scaled(CasePoints points, double factor)
{
    for (Vec3d& at : points.at) {
        for (double& x : at) x *= factor;
    }
    points.radius *= factor;
    return points;
}

CaseParticles asFloats(const CasePoints& points)
{
    return asArray<float>(points);
}

CaseParticles asDoubles(const CasePoints& points)
{
    return asArray<double>(points);
}

CaseParticles asSets(SetPoints points)
{
    const auto owned = std::make_shared<OwnedSets>();
    owned->candidates = floatsOf(points.candidates.at);
    owned->queries = floatsOf(points.queries);
    owned->points = std::move(points);
    const SetPoints& p = owned->points;
    const auto search = std::make_shared<SetSearch>();
    const ParticleView candidates = ParticleView::fromArray(owned->candidates.data(), p.candidates.at.size());
    search->candidates = {candidates, spanOf(p.candidateChosen)};
    search->queries = {p.queries.empty() ? candidates
                                         : ParticleView::fromArray(owned->queries.data(), p.queries.size()),
                       spanOf(p.queryChosen)};
    search->radius = p.candidates.radius;
    search->radius.ofQueries = spanOf(p.queryRadii);
    search->radius.ofCandidates = spanOf(p.candidateRadii);
    search->radius.mode = p.mode;
    search->nearest = p.nearest;
    return {candidates, p.candidates.radius, KnownRows::kUnknown, owned, search};
}

} // namespace vdb_nns::cli
