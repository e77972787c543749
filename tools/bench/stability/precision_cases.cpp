// Cases about rounding: pairs exactly at the radius, positions far from the origin, lengths of all orders.
#include "bench/stability/case_points.h"

#include <cmath>
#include <limits>

namespace vdb_nns::cli {
namespace {

// A lattice that touches the origin, at multiples of h as they are rounded. No jitter: all is ties.
CasePoints tiePoints(int edge, double h, double radius)
{
    CasePoints points;
    for (int x = 0; x < edge; ++x) {
        for (int y = 0; y < edge; ++y) {
            for (int z = 0; z < edge; ++z) points.at.push_back({x * h, y * h, z * h});
        }
    }
    points.radius = radius;
    return points;
}

// Hubs with satellites whose distance is the radius but for the rounding of their coordinates.
CasePoints nearRadius()
{
    CasePoints points;
    CaseRandom random(2);
    for (int hub = 0; hub < 150; ++hub) {
        const Vec3d center = random.point(40);
        points.at.push_back(center);
        for (int k = 0; k < 24; ++k) {
            const Vec3d way = random.point(1);
            const double stretch = points.radius / std::hypot(way[0], way[1], way[2]);
            points.at.push_back(
                {center[0] + way[0] * stretch, center[1] + way[1] * stretch, center[2] + way[2] * stretch});
        }
    }
    return points;
}

void addTies(std::vector<StabilityCase>& cases)
{
    constexpr int kEdge = 14;
    const auto add = [&cases](const char* name, const char* what, double h, double radius) {
        cases.push_back({"ties", name, what, [=] { return asFloats(tiePoints(kEdge, h, radius)); }});
    };
    const auto below = [](double x) { return std::nextafter(x, 0.0); };
    const auto above = [](double x) { return std::nextafter(x, 2 * x); };
    add("tie-0.1", "lattice of h = 0.1 in floats, radius 2 h: scikit-learn #7700 takes some of the boundary",
        0.1, 0.2);
    cases.push_back(
        {"ties", "tie-0.1-double",
         "the same in doubles, the rounding of k h decides: TreeNSearch README, floats misclassify these",
         [] { return asDoubles(tiePoints(kEdge, 0.1, 0.2)); }});
    add("tie-0.125",
        "lattice of h = 0.125, radius 2 h, every tie exact, where peers split on < and <=: Redis #3698, "
        "kd-tree (Rust) #21",
        0.125, 0.25);
    add("tie-below", "the same, radius an ulp less: a radius rounded to float takes ties that are none",
        0.125, below(0.25));
    add("tie-above", "the same, radius an ulp more: a squared radius rounds it away", 0.125, above(0.25));
    add("tie-h", "the same, radius h: pairs lost on both sides of a wrap, LAMMPS #2759", 0.125, 0.125);
    add("tie-sqrt2", "the same, radius the double nearest to sqrt(2) h: asymmetric lists, SPH-EXA #629",
        0.125, std::sqrt(2.0) * 0.125);
    add("tie-sqrt3", "the same, radius the double nearest to sqrt(3) h: asymmetric lists, hoomd-tf #307",
        0.125, std::sqrt(3.0) * 0.125);
    add("tie-3-4-5",
        "the same, radius 5 h, with ties off the axes: two searches of PCL's GPU module differ, #4338", 0.125,
        0.625);
    cases.push_back({"ties", "near-radius",
                     "satellites at the radius but for rounding: Atomistica #30, 1e-52 decides",
                     [] { return asDoubles(nearRadius()); }});
}

void addOffsets(std::vector<StabilityCase>& cases)
{
    constexpr int kEdge = 14;
    const auto far = [](double offset) { return blockPoints(kEdge, {offset, -offset, offset / 3}); };
    for (const int power : {3, 4, 5, 6, 7}) {
        const double offset = std::pow(10.0, power);
        cases.push_back({"offset", "far-1e" + std::to_string(power),
                         "block at 1e" + std::to_string(power) +
                             " spacings in doubles: float32 positions, PCL #4756, masbcpp #1, OpenVDB in "
                             "Houdini (dneg #34)",
                         [=] { return asDoubles(far(offset)); }});
    }
    cases.push_back(
        {"offset", "far-1e7-floats",
         "block at 1e7 in floats, whose step is the spacing: Blender's manual warns of such positions",
         [=] { return asFloats(far(1e7)); }});
}

void addScales(std::vector<StabilityCase>& cases)
{
    constexpr int kEdge = 12;
    const auto floats = [&](const char* name, const char* what, double scale) {
        cases.push_back({"scale", name, what, [=] { return asFloats(scaled(blockPoints(kEdge), scale)); }});
    };
    const auto doubles = [&](const char* name, const char* what, double scale) {
        cases.push_back({"scale", name, what, [=] { return asDoubles(scaled(blockPoints(kEdge), scale)); }});
    };
    floats("scale-1e-12", "spacing 1e-12: MDAnalysis #2670 hangs for very small boxes", 1e-12);
    floats("scale-1e12", "spacing 1e12: positions past any 32-bit integer", 1e12);
    floats("scale-1e-25", "spacing 1e-25: squares vanish in float32", 1e-25);
    floats("scale-1e25", "spacing 1e25: squares are infinite in float32", 1e25);
    floats("scale-1e-40", "spacing 1e-40: subnormal floats, which flush to zero", 1e-40);
    doubles("scale-1e-170", "spacing 1e-170: squares vanish in double", 1e-170);
    doubles("scale-1e170", "spacing 1e170: squares are infinite in double", 1e170);
}

} // namespace

std::vector<StabilityCase> precisionCases()
{
    std::vector<StabilityCase> cases;
    addTies(cases);
    addOffsets(cases);
    addScales(cases);
    return cases;
}

} // namespace vdb_nns::cli
