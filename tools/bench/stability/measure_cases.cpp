// Cases about measures: those of other groups, and what only measures can fail at: shapes without an area or a volume, scales,
// masses, values of attributes.
#include "bench/stability/case_points.h"
#include "bench/stability/measure_task.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN(),
                 kInfinity = std::numeric_limits<double>::infinity();

std::size_t candidatesOf(const CaseParticles& particles)
{
    return searchOf(particles).candidates.view.size();
}

CaseParticles withTask(CaseParticles particles, MeasureTask task)
{
    particles.measures = std::make_shared<const MeasureTask>(std::move(task));
    return particles;
}

CaseParticles measured(CaseParticles particles, bool mayPassRange = false)
{
    MeasureTask task = makeMeasureTask(candidatesOf(particles));
    task.mayPassRange = mayPassRange;
    return withTask(std::move(particles), std::move(task));
}

void add(std::vector<StabilityCase>& cases, const std::string& name, const char* what,
         const std::function<CaseParticles()>& make)
{
    cases.push_back({"measures", "measures-" + name, what, make});
}

// ---- cases of other groups ----------------------------------------------------------------------------------

void addOthers(std::vector<StabilityCase>& cases)
{
    std::vector<StabilityCase> all;
    for (const auto part : {precisionCases, shapeCases, inputCases, setCases, vdbCases}) {
        const std::vector<StabilityCase> more = part();
        all.insert(all.end(), more.begin(), more.end());
    }
    const auto addOne = [&](const std::string& name, bool mayPassRange) {
        const auto found =
            std::find_if(all.begin(), all.end(), [&](const StabilityCase& c) { return c.name == name; });
        if (found == all.end()) throw std::logic_error("no case '" + name + "' to be measured");
        cases.push_back({"measures", "measures-" + name, "measures of the case " + name,
                         [make = found->make, mayPassRange] { return measured(make(), mayPassRange); }});
    };
    for (const char* name : {"empty",
                             "one",
                             "two",
                             "two-apart",
                             "diagonal",
                             "twice",
                             "plane",
                             "axis-line",
                             "tie-0.125",
                             "far-1e7",
                             "far-1e7-floats",
                             "far-voxels",
                             "far-transform",
                             "non-uniform",
                             "sheared",
                             "reflected",
                             "nan",
                             "infinite",
                             "nan-double",
                             "nan-alone",
                             "nan-in-grid",
                             "offset-outside",
                             "radii-bad-gather",
                             "radii-bad-scatter",
                             "radii-bad-symmetric",
                             "radii-huge-symmetric",
                             "radii-1e4-gather",
                             "radii-1e4-scatter",
                             "radii-1e4-symmetric",
                             "radii-tie-symmetric",
                             "sets-on-top",
                             "sets-overlap",
                             "sets-apart",
                             "groups-disjoint",
                             "groups-same",
                             "groups-no-query",
                             "groups-no-candidate",
                             "nearest-8",
                             "nearest-coincident",
                             "nearest-sets",
                             "nearest-radii"})
        addOne(name, false);
    for (const char* name : {"scale-1e-40", "scale-1e-25", "scale-1e25"}) addOne(name, true);
}

// ---- shapes -------------------------------------------------------------------------------------------------

// Turned by 30 degrees about z, then by 17 about x, so that no coordinate is exact.
CasePoints tilted(CasePoints points)
{
    const double a = 30 * M_PI / 180, b = 17 * M_PI / 180;
    for (Vec3d& at : points.at) {
        const double x = std::cos(a) * at[0] - std::sin(a) * at[1],
                     y = std::sin(a) * at[0] + std::cos(a) * at[1], z = at[2];
        at = {x, std::cos(b) * y - std::sin(b) * z, std::sin(b) * y + std::cos(b) * z};
    }
    return points;
}

CasePoints lattice(const Vec3i& n, double radius)
{
    CasePoints points;
    CaseRandom unused(1);
    addLattice(points.at, {0, 0, 0}, n, 0, unused);
    points.radius = radius;
    return points;
}

CasePoints coincident()
{
    CasePoints points;
    points.at.assign(500, {-4.3, 0.2, 7.9});
    return points;
}

// A few queries among more candidates within reach than the sums' largest scale has room for.
SetPoints crowd()
{
    SetPoints sets;
    CaseRandom random(18);
    for (int k = 0; k < 6000; ++k) sets.candidates.at.push_back(random.point(0.5));
    for (int k = 0; k < 40; ++k) sets.queries.push_back(random.point(0.5));
    return sets;
}

// The mean about (7, 0, 0) by the weights of pca is the origin, without a rounding: half of the radius away they are 7/8.
CasePoints meanAtOrigin()
{
    CasePoints points;
    points.radius = 32;
    points.at = {{7, 0, 0},  {-9, 0, 0},  {-9, 0, 0}, {-9, 0, 0}, {-9, 0, 0},
                 {7, 16, 0}, {7, -16, 0}, {7, 0, 16}, {7, 0, -16}};
    return points;
}

// Queries of a set of their own, whose neighbors are exactly at the radius, where all weights but one kernel's are 0.
SetPoints atRadius()
{
    SetPoints sets;
    for (int k = 0; k < 50; ++k) {
        const double x = 16 * k;
        sets.queries.push_back({x, 0, 0});
        sets.candidates.at.insert(sets.candidates.at.end(),
                                  {{x + 2, 0, 0}, {x, 2, 0}, {x, -2, 0}, {x, 0, -2}});
    }
    return sets;
}

void addShapes(std::vector<StabilityCase>& cases)
{
    add(cases, "coincident", "500 particles at one point: no direction, no extent",
        [] { return measured(asFloats(coincident())); });
    add(cases, "sheet", "a sheet on a lattice: a covariance of rank 2, with equal eigenvalues", [] {
        return measured(asFloats(lattice({30, 30, 1}, 3)));
    });
    add(cases, "sheet-tilted", "the same tilted: the third eigenvalue is a rounding, of either sign", [] {
        return measured(asDoubles(tilted(lattice({30, 30, 1}, 3))));
    });
    add(cases, "line", "a line on a lattice: a covariance of rank 1", [] {
        return measured(asFloats(lattice({600, 1, 1}, 11)));
    });
    add(cases, "line-tilted", "the same tilted: two eigenvalues are roundings", [] {
        return measured(asDoubles(tilted(lattice({600, 1, 1}, 11))));
    });
    add(cases, "isolated", "nobody has a neighbor", [] {
        return measured(asFloats(lattice({9, 9, 9}, 0.9)));
    });
    add(cases, "past-4096", "6000 candidates about each query: more terms than the scale of sums is made for",
        [] { return measured(asSets(crowd())); });
    add(cases, "mean-at-origin",
        "the weighted mean is the origin, which points::pca of OpenVDB 13.0 takes for no neighbors",
        [] { return measured(asFloats(meanAtOrigin())); });
    add(cases, "at-radius", "all neighbors exactly at the radius: weights whose sum is 0",
        [] { return measured(asSets(atRadius())); });
}

// ---- scales -------------------------------------------------------------------------------------------------

void addScales(std::vector<StabilityCase>& cases)
{
    const auto addOne = [&cases](const char* name, const char* what, double scale) {
        add(cases, name, what, [scale] { return measured(asDoubles(scaled(blockPoints(9), scale)), true); });
    };
    addOne("scale-1e-30", "spacing 1e-30: cubes vanish in float32", 1e-30);
    addOne("scale-1e-100", "spacing 1e-100: cubes vanish in float32, fourth powers in double", 1e-100);
    addOne("scale-1e30", "spacing 1e30: cubes are infinite in float32", 1e30);
    addOne("scale-1e100", "spacing 1e100: cubes are infinite in float32, fourth powers in double", 1e100);
}

// ---- masses -------------------------------------------------------------------------------------------------

using MassOf = double (*)(std::size_t i);

CaseParticles withMasses(CasePoints points, MassOf mass, bool mayPassRange)
{
    CaseParticles particles = asDoubles(points);
    MeasureTask task = makeMeasureTask(candidatesOf(particles));
    task.mayPassRange = mayPassRange;
    for (std::size_t i = 0; i < points.at.size(); ++i) task.masses.push_back(mass(i));
    return withTask(std::move(particles), std::move(task));
}

void addMasses(std::vector<StabilityCase>& cases)
{
    const auto addOne = [&cases](const char* name, const char* what, MassOf mass, double scale = 1) {
        add(cases, name, what,
            [mass, scale] { return withMasses(scaled(blockPoints(9), scale), mass, mass(0) > 1); });
    };
    addOne("mass-0", "masses of 0: every density is 0", [](std::size_t) { return 0.0; });
    addOne("mass-some-0", "masses of 0 and 1e-3 to 1 in turn",
           [](std::size_t i) { return i % 3 == 0 ? 0 : 1e-3 * static_cast<double>(i % 1000); });
    addOne("mass-1e300", "masses of 1e300: densities beyond the range of floats",
           [](std::size_t) { return 1e300; });
    addOne("mass-1e-300", "masses of 1e-300: densities that floats round to 0",
           [](std::size_t) { return 1e-300; });
    addOne(
        "mass-0-tiny", "masses of 0 where 1 / R^3 is infinite in double", [](std::size_t) { return 0.0; },
        1e-110);
    addOne(
        "mass-1e300-huge", "masses of 1e300 in a volume that makes up for it",
        [](std::size_t) { return 1e300; }, 1e100);
    const auto addBad = [&cases](const char* name, const char* what, MassOf mass) {
        StabilityCase bad = {"measures", name, what,
                             [mass] { return withMasses(blockPoints(6), mass, false); }};
        bad.right = [](const MethodSpec&) { return RightOutcome::kRefusal; };
        bad.refusalSays = "masses are finite and not negative";
        cases.push_back(bad);
    };
    addBad("measures-mass-nan", "a mass is NaN", [](std::size_t i) { return i == 77 ? kNan : 1; });
    addBad("measures-mass-infinite", "a mass is infinite",
           [](std::size_t i) { return i == 77 ? kInfinity : 1; });
    addBad("measures-mass-negative", "a mass is negative", [](std::size_t i) { return i == 77 ? -1.0 : 1; });
}

// ---- attributes ---------------------------------------------------------------------------------------------

void addAttributes(std::vector<StabilityCase>& cases)
{
    const auto addOne = [&cases](const char* name, const char* what, const AttributeNumber& number) {
        add(cases, name, what, [number] {
            CaseParticles particles = asFloats(blockPoints(9));
            MeasureTask task = makeMeasureTask(candidatesOf(particles), number);
            return withTask(std::move(particles), std::move(task));
        });
    };
    addOne("values-some-nan", "averages of values of which a third are NaN or infinite: those are skipped",
           [](std::size_t i, double largest) {
               constexpr double kBad[] = {kNan, kInfinity, -kInfinity};
               return i % 9 < 3 ? kBad[i % 3] : ordinaryNumber(i, largest);
           });
    addOne("values-all-nan", "averages of nothing but NaN: 0", [](std::size_t, double) { return kNan; });
    addOne("values-largest", "averages of the largest number there is: sums are infinite",
           [](std::size_t, double largest) { return largest; });
    addOne("values-both-largest", "averages of the largest numbers of both signs: infinite minus infinite",
           [](std::size_t i, double largest) { return i % 2 ? largest : -largest; });
    addOne("values-smallest", "averages of denormal numbers", [](std::size_t i, double largest) {
        return std::ldexp(static_cast<double>(i % 5), largest < 1e39 ? -147 : -1072);
    });
    addOne("values-1e-30-1e30", "averages of numbers of 60 decades",
           [](std::size_t i, double) { return std::pow(10.0, static_cast<double>(i % 61) - 30); });
}

} // namespace

std::vector<StabilityCase> measureCases()
{
    std::vector<StabilityCase> cases;
    addOthers(cases);
    addShapes(cases);
    addScales(cases);
    addMasses(cases);
    addAttributes(cases);
    return cases;
}

} // namespace vdb_nns::cli
