// Cases about input that is small, out of scale or broken.
#include "bench/stability/case_points.h"

#include <cmath>
#include <limits>

namespace vdb_nns::cli {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN(),
                 kInfinity = std::numeric_limits<double>::infinity();

CasePoints someOf(std::vector<Vec3d> at)
{
    CasePoints points;
    points.at = std::move(at);
    return points;
}

CasePoints withRadius(CasePoints points, double radius, KnownRows known)
{
    points.radius = radius;
    points.known = known;
    return points;
}

// A block, every 97th particle of which has those values in place of some coordinates.
CasePoints spoilt(const std::vector<double>& values)
{
    CasePoints points = blockPoints(14);
    for (std::size_t i = 5, k = 0; i < points.at.size(); i += 97, ++k) {
        points.at[i][k % 3] = values[k % values.size()];
        if (k % 4 == 3) points.at[i] = {values[0], values[0], values[0]};
    }
    return points;
}

// Pairs of coincident particles, 0 and 1, 2 and 3 and so on.
CasePoints twins(double radius, KnownRows known)
{
    const CasePoints once = blockPoints(6);
    CasePoints points;
    for (const Vec3d& at : once.at) points.at.insert(points.at.end(), 2, at);
    return withRadius(std::move(points), radius, known);
}

void addFew(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, std::vector<Vec3d> at) {
        cases.push_back({"few", name, what, [=] { return asFloats(someOf(at)); }});
    };
    add("empty", "no particle", {});
    add("one", "one particle: a grid of no cells, PDAL #4971", {{0.3, -0.7, 5}});
    add("two", "two particles within the radius: FLANN #159, r for r^2", {{0.3, -0.7, 5}, {0.3, 0.7, 5.5}});
    add("two-apart", "two particles far apart", {{0.3, -0.7, 5}, {-1e5, 7, 5.5}});
}

void addRadii(std::vector<StabilityCase>& cases)
{
    cases.push_back({"radius", "radius-covers-all",
                     "radius 1e3 times the domain: scikit-learn #22531 runs out of memory",
                     [] { return asFloats(withRadius(blockPoints(11), 1e4, KnownRows::kAllOthers)); }});
    cases.push_back({"radius", "radius-1e30",
                     "radius 1e30 on a block of size 10: jax-md #195, one cell for all",
                     [] { return asFloats(withRadius(blockPoints(11), 1e30, KnownRows::kAllOthers)); }});
    cases.push_back({"radius", "radius-tiny",
                     "radius 1e-6 of the spacing, only twins are neighbors: MDAnalysis #2670",
                     [] { return asFloats(twins(1e-6, KnownRows::kTwin)); }});
    cases.push_back(
        {"radius", "radius-subnormal", "the smallest radius that doubles have, on twins at the origin", [] {
             return asDoubles(withRadius(someOf({{0, 0, 0}, {0, 0, 0}, {5e-324, 0, 0}, {0, 1e-323, 0}}),
                                         5e-324, KnownRows::kUnknown));
         }});
}

void addNonFinite(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, const std::vector<double>& values) {
        cases.push_back({"non-finite", name, what, [=] { return asFloats(spoilt(values)); }});
    };
    add("nan", "1 % NaN: nanoflann #149 loses valid pairs, rtabmap #168 aborts, matscipy invents pairs",
        {kNan});
    add("infinite", "1 % infinite: PCL #5058, TreeNSearch ends by a segmentation fault",
        {kInfinity, -kInfinity});
    cases.push_back(
        {"non-finite", "nan-double", "NaN and both infinities among doubles: gz-sensors #179", [] {
             return asDoubles(spoilt({kInfinity, kNan, -kInfinity}));
         }});
    cases.push_back({"non-finite", "nan-alone", "nothing but NaN: no box, no cell", [] {
                         return asFloats(someOf(std::vector<Vec3d>(200, {kNan, 1, 2})));
                     }});
}

// What a definition by d <= r gives is beside the point for ours: it refuses. Others are held to it.
void addBadRadii(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, double radius, KnownRows known) {
        cases.push_back({"bad radius",
                         name,
                         what,
                         [=] { return asFloats(twins(radius, known)); },
                         {},
                         [](const MethodSpec&) { return RightOutcome::kRefusal; },
                         "is not a positive finite number"});
    };
    add("radius-0", "radius 0: TreeNSearch ends the program with status -1, MDAnalysis #2657 dies", 0,
        KnownRows::kTwin);
    add("radius-negative", "radius below 0: OpenVDB answers garbage; a square forgets the sign, FLANN #100",
        -2, KnownRows::kNobody);
    add("radius-nan", "radius NaN: freud #825", kNan, KnownRows::kNobody);
    add("radius-infinite", "radius infinite: freud #825", kInfinity, KnownRows::kAllOthers);
}

} // namespace

std::vector<StabilityCase> inputCases()
{
    std::vector<StabilityCase> cases;
    addFew(cases);
    addRadii(cases);
    addNonFinite(cases);
    addBadRadii(cases);
    return cases;
}

} // namespace vdb_nns::cli
