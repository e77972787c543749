// Small point sets for tests; see distributions.h. Made in units in which the radius is 2 and the particle spacing about
// 1, then moved to arrays or to voxels.
#include "distributions.h"

#include <cmath>
#include <limits>
#include <string>

namespace vdb_nns::testing {

namespace {

using Point = std::array<double, 3>;

struct Base {
    std::string name;
    std::vector<Point> points;
    double radius = 2;
};

// SplitMix64: the tests' own random numbers, the same on every machine.
class Random {
public:
    explicit Random(std::uint64_t seed) : mState(seed) {}

    std::uint64_t bits()
    {
        std::uint64_t z = (mState += 0x9e3779b97f4a7c15ULL);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
        return z ^ (z >> 31);
    }
    double uniform(double low, double high)
    {
        return low + (high - low) * static_cast<double>(bits() >> 11) * 0x1p-53;
    }
    Point point(double half) { return {uniform(-half, half), uniform(-half, half), uniform(-half, half)}; }

private:
    std::uint64_t mState;
};

Point operator+(const Point& a, const Point& b)
{
    return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

// A jittered lattice of nx * ny * nz particles about `center`.
void addLattice(std::vector<Point>& points, Random& random, const Point& center, const std::array<int, 3>& n,
                double jitter)
{
    for (int x = 0; x < n[0]; ++x) {
        for (int y = 0; y < n[1]; ++y) {
            for (int z = 0; z < n[2]; ++z) {
                const Point at{x - 0.5 * (n[0] - 1), y - 0.5 * (n[1] - 1), z - 0.5 * (n[2] - 1)};
                points.push_back(center + at + random.point(jitter));
            }
        }
    }
}

Base makeSheet(Random& random)
{
    Base base{"sheet", {}};
    for (int x = 0; x < 20; ++x) {
        for (int y = 0; y < 20; ++y) {
            const Point at{double(x), double(y), 0.02 * (x - 10) * (y - 8)};
            base.points.push_back(at + random.point(0.2));
        }
    }
    return base;
}

Base makeSpray(Random& random)
{
    Base base{"spray", {}};
    for (int drop = 0; drop < 25; ++drop) {
        const int edge = 1 + static_cast<int>(random.bits() % 3);
        addLattice(base.points, random, random.point(400), {edge, edge, edge}, 0.2);
    }
    for (int lone = 0; lone < 60; ++lone) base.points.push_back(random.point(400));
    return base;
}

Base makeClusters(Random& random)
{
    Base base{"clusters", {}};
    for (int size = 1; size <= 256; size *= 2) {
        const Point center = random.point(12);
        for (int k = 0; k < size; ++k) base.points.push_back(center + random.point(1.5));
    }
    return base;
}

// Blocks across the faces of nodes of 8, 128 and 4096 cells of the radius, both signs, some points on the faces.
Base makeSeam(Random& random)
{
    Base base{"seam", {}};
    for (const double face : {0.0, 16.0, -16.0, 256.0, -256.0, 8192.0, -8192.0}) {
        for (int axis = 0; axis < 3; ++axis) {
            Point center = random.point(3);
            center[static_cast<std::size_t>(axis)] = face;
            addLattice(base.points, random, center, {3, 3, 3}, 0.2);
            for (int k = 0; k < 4; ++k) {
                Point on = center + random.point(2);
                on[static_cast<std::size_t>(axis)] = face;
                base.points.push_back(on);
            }
        }
    }
    return base;
}

Base makeNonFinite(Random& random)
{
    Base base{"non-finite", {}};
    constexpr double kInf = std::numeric_limits<double>::infinity();
    addLattice(base.points, random, {0, 0, 0}, {6, 6, 6}, 0.2);
    const double bad[3] = {std::numeric_limits<double>::quiet_NaN(), kInf, -kInf};
    for (std::size_t k = 0; k < 12; ++k) base.points[7 + 17 * k][k % 3] = bad[k / 3 % 3];
    base.points.push_back({bad[0], bad[1], bad[2]});
    return base;
}

// Hubs with satellites whose distance is the radius but for the rounding of their coordinates.
Base makeNearRadius(Random& random)
{
    Base base{"near the radius", {}};
    for (int hub = 0; hub < 12; ++hub) {
        const Point center = random.point(10);
        base.points.push_back(center);
        for (int k = 0; k < 24; ++k) {
            const Point way = random.point(1);
            const double length = std::hypot(way[0], way[1], way[2]);
            base.points.push_back(center +
                                  Point{2 * way[0] / length, 2 * way[1] / length, 2 * way[2] / length});
        }
    }
    return base;
}

std::vector<Base> baseSets(std::uint64_t seed)
{
    Random random(seed);
    std::vector<Base> sets;
    sets.push_back({"empty", {}});
    sets.push_back({"one", {{0.3, -0.7, 5}}});
    sets.push_back({"two coincident", {{1.25, -3.5, 0.75}, {1.25, -3.5, 0.75}}});
    sets.push_back({"all coincident", std::vector<Point>(150, Point{-4.3, 0.2, 7.9})});
    Base lattice{"lattice", {}};
    addLattice(lattice.points, random, {0, 0, 0}, {8, 8, 8}, 0);
    sets.push_back(lattice);
    Base block{"block", {}};
    addLattice(block.points, random, {0.3, -0.2, 0.1}, {9, 8, 8}, 0.2);
    sets.push_back(block);
    sets.push_back(makeSheet(random));
    sets.push_back(makeSpray(random));
    sets.push_back(makeClusters(random));
    Base islands{"two far islands", {}};
    addLattice(islands.points, random, {-3e5, 10, 0}, {5, 5, 5}, 0.2);
    addLattice(islands.points, random, {4e5, -2e5, 1e5}, {5, 5, 5}, 0.2);
    sets.push_back(islands);
    sets.push_back(makeSeam(random));
    Base far{"far", {}};
    addLattice(far.points, random, {1e6, -2e6, 3e5}, {7, 7, 7}, 0.2);
    sets.push_back(far);
    sets.push_back(makeNonFinite(random));
    sets.push_back(makeNearRadius(random));
    return sets;
}

// As voxels of size 1 and float offsets; a non-finite coordinate is voxel 0 and a non-finite offset.
ExactPoint inVoxels(const Point& point)
{
    ExactPoint exact;
    for (std::size_t k = 0; k < 3; ++k) {
        const double voxel = std::isfinite(point[k]) ? std::floor(point[k] + 0.5) : 0;
        exact.voxel[k] = static_cast<std::int64_t>(voxel);
        exact.offset[k] = static_cast<float>(point[k] - voxel);
    }
    return exact;
}

// |det|^(1/3): how long the map makes a length, on average. 1 for rotations, shears and reflections, without rounding.
double stretchOf(const Linear& m)
{
    const double determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                               m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                               m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    return std::cbrt(std::fabs(determinant));
}

bool isUniformScale(const Linear& m)
{
    double offDiagonal = 0;
    for (std::size_t k = 0; k < 9; ++k) offDiagonal += k % 4 ? std::fabs(m[k / 3][k % 3]) : 0;
    const double edge = std::fabs(m[0][0]);
    return offDiagonal == 0 && edge == std::fabs(m[1][1]) && edge == std::fabs(m[2][2]);
}

} // namespace

const std::vector<NamedLinear>& linearMaps()
{
    static const std::vector<NamedLinear> kMaps = {
        {"identity", kIdentity},
        {"scale", {{{0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}}}},
        {"non-uniform scale", {{{0.5, 0, 0}, {0, 1, 0}, {0, 0, 2.3}}}},
        {"rotation", {{{2 / 3., -1 / 3., 2 / 3.}, {2 / 3., 2 / 3., -1 / 3.}, {-1 / 3., 2 / 3., 2 / 3.}}}},
        {"shear", {{{1, 0.5, -0.3}, {0, 1, 0.7}, {0, 0, 1}}}},
        {"reflection", {{{0.3, 0, 0}, {0, -0.3, 0}, {0, 0, 0.3}}}},
        {"rotated non-uniform scale", {{{0.6, -1.6, 0}, {0.8, 1.2, 0}, {0, 0, 0.01}}}},
    };
    return kMaps;
}

std::vector<PointSet> arraySets(Precision precision, std::uint64_t seed)
{
    std::vector<PointSet> sets;
    for (const Base& base : baseSets(seed)) {
        PointSet set{base.name, base.radius, {}, kIdentity};
        for (const Point& point : base.points) {
            ExactPoint exact;
            for (std::size_t k = 0; k < 3; ++k) {
                // Through a volatile: g++ 12 at -O3 drops the rounding when it makes vectors of this loop.
                const volatile float rounded = static_cast<float>(point[k]);
                exact.offset[k] = precision == Precision::kFloat ? static_cast<double>(rounded) : point[k];
            }
            set.points.push_back(exact);
        }
        sets.push_back(set);
    }
    return sets;
}

std::vector<PointSet> gridSets(std::uint64_t seed)
{
    std::vector<PointSet> sets;
    for (const NamedLinear& map : linearMaps()) {
        // Under a uniform scale the lattice's ties stay ties: 2 * edge is exact.
        const double unit = isUniformScale(map.linear) ? std::fabs(map.linear[0][0]) : stretchOf(map.linear);
        for (const Base& base : baseSets(seed)) {
            PointSet set{base.name + ", " + map.name, base.radius * unit, {}, map.linear};
            for (const Point& point : base.points) set.points.push_back(inVoxels(point));
            sets.push_back(set);
        }
        PointSet displaced{std::string("displaced, ") + map.name, 2 * unit, {}, map.linear};
        Random random(seed + 1);
        for (int k = 0; k < 300; ++k) {
            ExactPoint point = inVoxels(random.point(5));
            for (double& x : point.offset) x = static_cast<float>(random.uniform(-3, 3));
            displaced.points.push_back(point);
        }
        sets.push_back(displaced);
    }
    return sets;
}

std::vector<double> doublesOf(const PointSet& set)
{
    std::vector<double> xyz;
    for (const ExactPoint& point : set.points)
        xyz.insert(xyz.end(), point.offset.begin(), point.offset.end());
    return xyz;
}

std::vector<float> floatsOf(const PointSet& set)
{
    std::vector<float> xyz;
    for (const double x : doublesOf(set)) xyz.push_back(static_cast<float>(x));
    return xyz;
}

PointSet shuffled(const PointSet& set, std::uint64_t seed, std::vector<std::uint32_t>& order)
{
    Random random(seed);
    order.resize(set.points.size());
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<std::uint32_t>(k);
    for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[random.bits() % k]);
    PointSet result{set.name + ", shuffled", set.radius, {}, set.linear};
    for (const std::uint32_t old : order) result.points.push_back(set.points[old]);
    return result;
}

} // namespace vdb_nns::testing
