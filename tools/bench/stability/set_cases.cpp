// Cases about who asks, among whom, how far, and how many are kept: radii of particles, roles, the nearest.
#include "bench/stability/case_points.h"

#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN(),
                 kInfinity = std::numeric_limits<double>::infinity();

// Radii of all particles, where a mode reads them: of one set they are the same in both roles.
SetPoints withRadii(CasePoints points, std::vector<double> radii, RadiusMode mode)
{
    SetPoints sets;
    sets.candidates = std::move(points);
    sets.mode = mode;
    if (mode != RadiusMode::kScatter) sets.queryRadii = radii;
    if (mode != RadiusMode::kGather) sets.candidateRadii = std::move(radii);
    return sets;
}

// Pairs of coincident particles, which a radius of 0 would reach.
CasePoints twins()
{
    CasePoints points;
    for (const Vec3d& at : blockPoints(9).at) points.at.insert(points.at.end(), 2, at);
    return points;
}

// About `ordinary`, but for every 7th particle, which has one of `others` in turn.
std::vector<double> radiiAmong(std::size_t count, double ordinary, const std::vector<double>& others)
{
    std::vector<double> radii;
    CaseRandom random(11);
    for (std::size_t i = 0; i < count; ++i) {
        radii.push_back(i % 7 == 3 ? others[i / 7 % others.size()] : ordinary * random.uniform(0.9, 1.1));
    }
    return radii;
}

SetPoints badRadii(RadiusMode mode)
{
    CasePoints points = twins();
    std::vector<double> radii =
        radiiAmong(points.at.size(), 1.6, {kNan, 0, -2, kInfinity, -kInfinity, -0.0, -1e-3});
    return withRadii(std::move(points), std::move(radii), mode);
}

SetPoints hugeRadii(RadiusMode mode)
{
    CasePoints points = blockPoints(11);
    std::vector<double> radii = radiiAmong(points.at.size(), 1.6, {1e30, 1e4, 1e300, 2});
    return withRadii(std::move(points), std::move(radii), mode);
}

// Spacing and radius over four decades: shells about the origin, each as dense as its radius asks.
SetPoints radiiOfDecades(RadiusMode mode)
{
    CasePoints points;
    std::vector<double> radii;
    CaseRandom random(12);
    for (int shell = 0; shell <= 60; ++shell) {
        const double far = std::pow(10.0, shell / 15.0 - 2);
        for (int k = 0; k < 60; ++k) {
            const Vec3d way = random.point(1);
            const double stretch = far * random.uniform(0.9, 1.1) / std::hypot(way[0], way[1], way[2]);
            points.at.push_back({way[0] * stretch, way[1] * stretch, way[2] * stretch});
            radii.push_back(0.6 * far);
        }
    }
    return withRadii(std::move(points), std::move(radii), mode);
}

// A lattice of h = 1/8, on which everything is exact.
CasePoints exactLattice(int edge)
{
    CasePoints points;
    for (int x = 0; x < edge; ++x) {
        for (int y = 0; y < edge; ++y) {
            for (int z = 0; z < edge; ++z) points.at.push_back({0.125 * x, 0.125 * y, 0.125 * z});
        }
    }
    points.radius = 0.25;
    return points;
}

// Radii of 1, 2, 3 and 5 spacings, an ulp less and an ulp more: of each particle others stand exactly at
// them.
SetPoints tiesOfEach(RadiusMode mode)
{
    CasePoints points = exactLattice(11);
    std::vector<double> radii;
    CaseRandom random(13);
    for (std::size_t i = 0; i < points.at.size(); ++i) {
        constexpr double kSpacings[] = {1, 2, 3, 5};
        const std::uint64_t draw = random.bits();
        const double radius = 0.125 * kSpacings[draw % 4];
        radii.push_back(draw / 4 % 4 == 0   ? std::nextafter(radius, 0.0)
                        : draw / 4 % 4 == 1 ? std::nextafter(radius, 1.0)
                                            : radius);
    }
    return withRadii(std::move(points), std::move(radii), mode);
}

void addRadii(std::vector<StabilityCase>& cases)
{
    using Maker = SetPoints (*)(RadiusMode);
    const auto add = [&cases](const std::string& name, const std::string& what, Maker make) {
        constexpr std::pair<const char*, RadiusMode> kModes[] = {{"gather", RadiusMode::kGather},
                                                                 {"scatter", RadiusMode::kScatter},
                                                                 {"symmetric", RadiusMode::kSymmetric}};
        for (const auto& [mode, value] : kModes) {
            cases.push_back({"radii", name + "-" + mode, what + " (" + mode + ")",
                             [make, mode = value] { return asSets(make(mode)); }});
        }
    };
    add("radii-bad",
        "radii of some particles NaN, 0, negative or infinite: a square forgets the sign, FLANN #100",
        badRadii);
    add("radii-huge", "radii of some particles 1e4 to 1e300 times the spacing: jax-md #195, one cell for all",
        hugeRadii);
    add("radii-1e4", "radii over four decades, 1 : 1e4: cells of the largest hold everything",
        radiiOfDecades);
    add("radii-tie",
        "lattice with others exactly at the radius of each particle: Redis #3698, < and <=", tiesOfEach);
}

// ---- roles ------------------------------------------------------------------------------------------------

// A block among others that it does not touch, or on top of itself.
SetPoints twoSets(const Vec3d& center)
{
    SetPoints sets;
    sets.candidates = blockPoints(12);
    sets.queries = blockPoints(8, center).at;
    return sets;
}

SetPoints onTop()
{
    SetPoints sets;
    sets.candidates = blockPoints(12);
    sets.queries = sets.candidates.at;
    return sets;
}

// Of one block those whose number leaves that rest, of three; 3: nobody.
SetPoints groups(std::size_t queries, std::size_t candidates)
{
    SetPoints sets;
    sets.candidates = blockPoints(12);
    for (std::size_t i = 0; i < sets.candidates.at.size(); ++i) {
        sets.queryChosen.push_back(i % 3 == queries);
        sets.candidateChosen.push_back(i % 3 == candidates);
    }
    return sets;
}

// All within a ball that each reaches across.
std::vector<Vec3d> ball(int count, std::uint64_t seed)
{
    std::vector<Vec3d> at;
    CaseRandom random(seed);
    for (int k = 0; k < count; ++k) at.push_back(random.point(0.55));
    return at;
}

SetPoints crowdedSets(RadiusMode mode)
{
    SetPoints sets;
    sets.candidates.at = ball(3000, 14);
    sets.queries = ball(300, 15);
    sets.mode = mode;
    CaseRandom random(16);
    if (mode != RadiusMode::kScatter) {
        for (std::size_t i = 0; i < sets.queries.size(); ++i)
            sets.queryRadii.push_back(random.uniform(0.7, 2));
    }
    if (mode != RadiusMode::kGather) {
        for (std::size_t j = 0; j < sets.candidates.at.size(); ++j)
            sets.candidateRadii.push_back(random.uniform(0.7, 2));
    }
    return sets;
}

void addRoles(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, const std::function<SetPoints()>& make) {
        cases.push_back({"sets", name, what, [make] { return asSets(make()); }});
    };
    add("sets-on-top", "queries on top of the candidates: Open3D drops what coincides with the query", onTop);
    add("sets-overlap", "a block of queries across the corner of one of candidates", [] {
        return twoSets({6, 6, 6});
    });
    add("sets-apart", "queries far from all candidates: nobody's neighbor is found", [] {
        return twoSets({1e5, -1e5, 3e4});
    });
    add("groups-disjoint", "a third of the particles asks, another third answers",
        [] { return groups(0, 1); });
    add("groups-same", "a third of the particles asks and answers: itself it is not",
        [] { return groups(2, 2); });
    add("groups-no-query", "no particle asks", [] { return groups(3, 1); });
    add("groups-no-candidate", "no particle answers", [] { return groups(1, 3); });
    add("sets-past-1024", "3000 candidates about each query, radii of queries: cuNSearch #5 cuts lists",
        [] { return crowdedSets(RadiusMode::kGather); });
    add("sets-past-1024-max", "the same, the larger radius of two",
        [] { return crowdedSets(RadiusMode::kSymmetric); });
}

// ---- the nearest ------------------------------------------------------------------------------------------

SetPoints nearestOf(CasePoints points, std::uint32_t nearest)
{
    SetPoints sets;
    sets.candidates = std::move(points);
    sets.nearest = nearest;
    return sets;
}

CasePoints crowd()
{
    CasePoints points;
    points.at = ball(2500, 17);
    return points;
}

CasePoints hundredfold()
{
    CasePoints points;
    const std::vector<Vec3d> once = blockPoints(3).at;
    for (int k = 0; k < 100; ++k) points.at.insert(points.at.end(), once.begin(), once.end());
    return points;
}

void addNearest(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, const std::function<SetPoints()>& make) {
        cases.push_back({"nearest", name, what, [make] { return asSets(make()); }});
    };
    add("nearest-8", "the nearest 8 of a block within the radius",
        [] { return nearestOf(blockPoints(14), 8); });
    add("nearest-past-lists", "the nearest 1000 where no list has more than 60",
        [] { return nearestOf(blockPoints(12), 1000); });
    add("nearest-equal", "the nearest 8 of a lattice, 6 at one distance and 12 at the next: by number",
        [] { return nearestOf(exactLattice(12), 8); });
    add("nearest-coincident", "the nearest 8 of a hundred at each place: all at distance 0, by number",
        [] { return nearestOf(hundredfold(), 8); });
    add("nearest-past-1024", "the nearest 1100 of 2500", [] { return nearestOf(crowd(), 1100); });
    add("nearest-sets", "the nearest 5 of other particles", [] {
        SetPoints sets = twoSets({0.3, 0.2, 0.1});
        sets.nearest = 5;
        return sets;
    });
    add("nearest-radii", "the nearest 6 within the larger radius of two", [] {
        SetPoints sets = tiesOfEach(RadiusMode::kSymmetric);
        sets.nearest = 6;
        return sets;
    });
}

} // namespace

std::vector<StabilityCase> setCases()
{
    std::vector<StabilityCase> cases;
    addRadii(cases);
    addRoles(cases);
    addNearest(cases);
    return cases;
}

} // namespace vdb_nns::cli
