// Cases about where particles are: faces of cells and nodes, sparse domains, sheets, clusters, particles at one place.
#include "bench/stability/case_points.h"

#include <cmath>

namespace vdb_nns::cli {
namespace {

// Blocks across a face of nodes on every axis, of both signs, some particles on the face and an ulp beside it: on the face of
// cells of the radius, and on that of ours, which are 1/65536 wider.
CasePoints seam(double faceCells)
{
    constexpr double kCellPadding = 1.0 / 65536;
    CasePoints points;
    CaseRandom random(3);
    const double face = faceCells * points.radius;
    for (const double at : {face, -face}) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            Vec3d center = random.point(3);
            center[axis] = at;
            addLattice(points.at, center, {6, 6, 6}, kJitter, random);
            for (int k = 0; k < 30; ++k) {
                const Vec3d off = random.point(2);
                Vec3d on = {center[0] + off[0], center[1] + off[1], center[2] + off[2]};
                const double face = k < 15 ? at : at * (1 + kCellPadding);
                on[axis] = k % 3 == 0 ? face : std::nextafter(face, k % 3 == 1 ? -1e9 : 1e9);
                points.at.push_back(on);
            }
        }
    }
    return points;
}

CasePoints mirrored()
{
    CasePoints points;
    CaseRandom random(4);
    for (int k = 0; k < 300; ++k) {
        const Vec3d p = random.point(6);
        for (int signs = 0; signs < 8; ++signs) {
            points.at.push_back(
                {signs & 1 ? -p[0] : p[0], signs & 2 ? -p[1] : p[1], signs & 4 ? -p[2] : p[2]});
        }
    }
    return points;
}

// A block and one particle so many cells away.
CasePoints outlier(double cells)
{
    CasePoints points = blockPoints(12);
    points.at.push_back({cells * points.radius, -cells * points.radius / 3, cells * points.radius / 7});
    return points;
}

CasePoints islands()
{
    CasePoints points;
    CaseRandom random(5);
    addLattice(points.at, {-1e6, 10, 0}, {9, 9, 9}, kJitter, random);
    addLattice(points.at, {1e6, -4e5, 2e5}, {9, 9, 9}, kJitter, random);
    return points;
}

// Pairs of particles along a diagonal that no box of cells holds.
CasePoints diagonal()
{
    CasePoints points;
    for (int k = 0; k < 1500; ++k) {
        points.at.push_back({3e3 * k, 2e3 * k, 1e3 * k});
        points.at.push_back({3e3 * k + 1, 2e3 * k + 1, 1e3 * k + 1});
    }
    return points;
}

CasePoints filament()
{
    CasePoints points;
    CaseRandom random(6);
    for (int k = 0; k < 4000; ++k) {
        const double t = 0.25 * k;
        points.at.push_back({t + random.uniform(-0.1, 0.1), 3 * std::sin(0.05 * t), 3 * std::cos(0.04 * t)});
    }
    return points;
}

CasePoints plane()
{
    CasePoints points;
    CaseRandom random(7);
    addLattice(points.at, {0, 0, 0.25}, {60, 60, 1}, kJitter, random);
    for (Vec3d& at : points.at) at[2] = 0.25;
    return points;
}

CasePoints axisLine()
{
    CasePoints points;
    for (int k = 0; k < 4000; ++k) points.at.push_back({0.5 * (k - 2000), 0, 0});
    return points;
}

CasePoints clusterInCloud()
{
    CasePoints points;
    CaseRandom random(8);
    for (int k = 0; k < 3000; ++k) points.at.push_back(random.point(60));
    for (int k = 0; k < 2000; ++k) {
        const Vec3d off = random.point(0.5);
        points.at.push_back({20 + off[0], -13 + off[1], 7 + off[2]});
    }
    return points;
}

// Each of 1 / rank as many particles in a ball of its own.
CasePoints zipf()
{
    CasePoints points;
    CaseRandom random(9);
    for (int rank = 1; rank <= 300; ++rank) {
        const Vec3d center = random.point(30);
        for (int k = 0; k < 1200 / rank; ++k) {
            const Vec3d off = random.point(0.9);
            points.at.push_back({center[0] + off[0], center[1] + off[1], center[2] + off[2]});
        }
    }
    return points;
}

// All within less than the radius of each other.
CasePoints oneTrial(int count)
{
    CasePoints points;
    CaseRandom random(10);
    for (int k = 0; k < count; ++k) {
        const Vec3d off = random.point(0.45);
        points.at.push_back({1 + off[0], 1 + off[1], 1 + off[2]});
    }
    points.known = KnownRows::kAllOthers;
    return points;
}

CasePoints coincident(int count)
{
    CasePoints points;
    points.at.assign(static_cast<std::size_t>(count), {-4.3, 0.2, 7.9});
    points.known = KnownRows::kAllOthers;
    return points;
}

CasePoints repeated(int places, int times)
{
    CasePoints points = blockPoints(places);
    const std::vector<Vec3d> once = points.at;
    for (int k = 1; k < times; ++k) points.at.insert(points.at.end(), once.begin(), once.end());
    return points;
}

// Lists of numbers for all pairs need more than a cell may have; masks and counts do not.
RightOutcome unlessIndex(const MethodSpec& spec)
{
    return spec.encoding == Encoding::kIndex && !spec.visits ? RightOutcome::kAnswerOrRefusal
                                                             : RightOutcome::kAnswer;
}

constexpr char kCapacity[] = "more host memory"; // the last of the ways out that the engine names

// Room on the device for a block of many particles that are all neighbors.
RunCondition hugeCondition()
{
    RunCondition condition;
    condition.hostRoom = HostRoom::kOfTrial;
    condition.addressBytes = std::uint64_t(2) << 30; // a fraction of what lists of numbers take: sooner full
    condition.deviceBytes = 64u << 20;
    return condition;
}

using PointsMaker = CasePoints (*)();

StabilityCase floatCase(const char* group, const char* name, const char* what, PointsMaker make)
{
    return {group, name, what, [=] { return asFloats(make()); }};
}

StabilityCase doubleCase(const char* group, const char* name, const char* what, PointsMaker make)
{
    return {group, name, what, [=] { return asDoubles(make()); }};
}

// In cells of the radius, so that the seam is where the faces of nodes are.
StabilityCase seamCase(const char* name, const char* what, PointsMaker make)
{
    StabilityCase result = doubleCase("seams", name, what, make);
    result.condition.cellSize = 1;
    return result;
}

void addSeams(std::vector<StabilityCase>& cases)
{
    cases.push_back(
        seamCase("seam-0", "blocks across zero: int(x) for floor(x), warp #1256", [] { return seam(0); }));
    cases.push_back(
        seamCase("seam-8", "blocks across faces of leaves, both signs: warp #283", [] { return seam(8); }));
    cases.push_back(seamCase("seam-128", "the same of internal nodes: AMReX #5702, boxes that disagree",
                             [] { return seam(128); }));
    cases.push_back(seamCase("seam-4096", "the same of upper nodes", [] { return seam(4096); }));
    cases.push_back(
        doubleCase("seams", "mirrored",
                   "a cloud and its mirror images: hashes of |x| collide, Ten Minute Physics #26, "
                   "PointNeXt #130",
                   mirrored));
    // A mirrored scene has the same lists, though its cells are cut elsewhere.
    StabilityCase negative = floatCase(
        "seams", "negative", "a block with all coordinates below 0, and its mirror images: warp #1256", [] {
            return blockPoints(14, {-60.3, -41.7, -1000.2});
        });
    negative.condition.mirrored = true;
    cases.push_back(negative);
    StabilityCase images = floatCase("seams", "mirror-images",
                                     "clusters and their mirror images: lists do not know left from right",
                                     [] { return scenePoints("clusters", 4000); });
    images.condition.mirrored = true;
    cases.push_back(images);
    StabilityCase ties = floatCase("seams", "mirror-ties", "a lattice of ties and its mirror images", [] {
        CasePoints points;
        CaseRandom random(18);
        addLattice(points.at, {-7, -8, -9}, {13, 13, 13}, 0, random);
        return points;
    });
    ties.condition.mirrored = true;
    cases.push_back(ties);
}

void addSparse(std::vector<StabilityCase>& cases)
{
    cases.push_back(doubleCase("sparse", "outlier-1e3",
                               "block and a particle 1e3 cells away: cuNSearch #10, FRNN #4",
                               [] { return outlier(1e3); }));
    cases.push_back(doubleCase("sparse", "outlier-1e6",
                               "the same, 1e6 cells: MDAnalysis #3183, SPHinXsys #395",
                               [] { return outlier(1e6); }));
    cases.push_back(doubleCase("sparse", "outlier-1e9",
                               "the same, 1e9 cells: TreeNSearch stops at 2^16 an axis",
                               [] { return outlier(1e9); }));
    StabilityCase outside =
        doubleCase("sparse", "outlier-1e12", "the same, 1e12 cells, more than 32 bits count: must not wrap",
                   [] { return outlier(1e12); });
    outside.right = [](const MethodSpec&) { return RightOutcome::kAnswerOrRefusal; };
    outside.refusalSays = "the limit is";
    cases.push_back(outside);
    cases.push_back(
        doubleCase("sparse", "islands", "two droplets 1e6 cells apart: DualSPHysics #220", islands));
    cases.push_back(
        doubleCase("sparse", "diagonal", "pairs along a diagonal of 4e6 cells: MDAnalysis #3183", diagonal));
    cases.push_back(floatCase("sparse", "spray", "spray in 0.1 % of its box: dense grids",
                              [] { return scenePoints("spray", 8000); }));
}

void addThin(std::vector<StabilityCase>& cases)
{
    cases.push_back(floatCase("thin", "sheet",
                              "curved sheets, where a mean density misleads: Cabana in ESPResSo #5144",
                              [] { return scenePoints("sheet", 6000); }));
    cases.push_back(floatCase("thin", "plane", "a plane: a box without depth", plane));
    cases.push_back(floatCase("thin", "filament", "a single curved filament: ESPResSo #5165", filament));
    cases.push_back(
        floatCase("thin", "axis-line", "a line of ties on an axis: a box without area", axisLine));
}

void addClusters(std::vector<StabilityCase>& cases)
{
    cases.push_back(floatCase("clusters", "clusters",
                              "log-normal clusters, 0 to thousands of neighbors: LAMMPS one/page, GPUMD #739",
                              [] { return scenePoints("clusters", 8000); }));
    cases.push_back(floatCase(
        "clusters", "zipf", "clusters of 1200 / k particles: Unity SPH #1 loses those of full cells", zipf));
    cases.push_back(floatCase("clusters", "cluster-in-cloud",
                              "2000 particles in a cell of a thin cloud: jax-md #165, DeePMD-kit #5616",
                              clusterInCloud));
    cases.push_back(floatCase("clusters", "rows-past-1024",
                              "3000 particles that are all neighbors: cuNSearch #5, torch_cluster #128",
                              [] { return oneTrial(3000); }));
    cases.push_back({"clusters", "rows-past-32",
                     "radius 3 h, 106 neighbors: torch_cluster #128, cuNSearch #5 cut lists", [] {
                         CasePoints points = blockPoints(16);
                         points.radius = 3;
                         return asFloats(points);
                     }});
    cases.push_back({"pairs", "pairs-past-2^31",
                     "47 000 particles in a cell, 2.2e9 pairs: ArborX #1012, fVDB #712, cuML #627",
                     [] { return asFloats(oneTrial(47000)); }, hugeCondition(), unlessIndex, kCapacity});
    cases.push_back({"pairs", "coincident-1e5",
                     "100 000 particles at one point, 1e10 pairs: finished in no peer of design 6",
                     [] { return asFloats(coincident(100000)); }, hugeCondition(), unlessIndex, kCapacity});
}

void addDuplicates(std::vector<StabilityCase>& cases)
{
    cases.push_back(floatCase("duplicates", "twice",
                              "every particle twice: Open3D drops what coincides with the query",
                              [] { return repeated(11, 2); }));
    cases.push_back(floatCase("duplicates", "hundredfold",
                              "every place a hundred times: SciPy #14799 overflows its stack",
                              [] { return repeated(3, 100); }));
    cases.push_back(floatCase("duplicates", "coincident",
                              "2000 particles at one point: SciPy #6108, CGAL #3077",
                              [] { return coincident(2000); }));
}

} // namespace

std::vector<StabilityCase> shapeCases()
{
    std::vector<StabilityCase> cases;
    addSeams(cases);
    addSparse(cases);
    addThin(cases);
    addClusters(cases);
    addDuplicates(cases);
    return cases;
}

} // namespace vdb_nns::cli
