// The float32 filter and its bound, bit by bit: pairs within a few ulps of the radius on both sides, near and far from the
// origin, at faces of cells and leaves, with denormal differences and with the smallest and largest radii. Sparse leaves
// and dense ones take different code, so each case runs in both: the dense one has company.
#include "agreement/point_views.h"
#include "support/comparator.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>
#include <string>

namespace vdb_nns::testing {

namespace {

constexpr double kLeast = std::numeric_limits<double>::denorm_min();
constexpr double kMost = std::numeric_limits<double>::max();
constexpr int kCompany = 300; // more than a sparse leaf may hold with its halo (kSparseMost)

double nudged(double x, int ulps)
{
    for (; ulps > 0; --ulps) x = std::nextafter(x, kMost);
    for (; ulps < 0; ++ulps) x = std::nextafter(x, -kMost);
    return x;
}

ExactPoint at(double x, double y, double z)
{
    return {{0, 0, 0}, {x, y, z}};
}

constexpr int kReaches[] = {1, 2, 3};

// Every instruction set and encoding. Returns how many ordered pairs went beyond the filter in the last run.
std::uint64_t expectOracle(const PointSet& set, Form form = Form::kDoubles,
                           Span<const int> reaches = {kReaches, 3})
{
    const SetView input(set, form);
    const Lists oracle = oracleLists(set);
    SearchEngine engine;
    for (const int reach : reaches) {
        for (const SimdLevel simd : simdLevels()) {
            for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
                SearchOptions options;
                options.encoding = encoding;
                options.cellSize = 1.0 / reach;
                options.simd = simd;
                const NeighborLists lists = engine.findNeighbors(input.view(), set.radius, options);
                SCOPED_TRACE(set.name + ", reach " + std::to_string(reach) + ", " + simdLevelName(simd));
                EXPECT_TRUE(sameCounts(lists.counts(), oracle));
                if (encoding == Encoding::kNone) continue;
                EXPECT_TRUE(sameLists(lists, oracle, set));
            }
        }
    }
    return engine.statistics().doublePairs;
}

class Random {
public:
    explicit Random(std::uint64_t seed) : mBits(seed) {}

    double uniform(double low, double high)
    {
        return low + (high - low) * (static_cast<double>(mBits() >> 11) * 0x1p-53);
    }
    int integer(int low, int high)
    {
        return low + static_cast<int>(mBits() % static_cast<std::uint64_t>(high - low + 1));
    }
    ExactPoint around(const ExactPoint& center, double half)
    {
        ExactPoint point = center;
        for (double& x : point.offset) x += uniform(-half, half);
        return point;
    }
    // At about `distance` in any direction.
    ExactPoint away(const ExactPoint& center, double distance)
    {
        double way[3];
        for (double& w : way) w = uniform(-1, 1);
        const double length = std::hypot(way[0], way[1], way[2]);
        ExactPoint point = center;
        for (std::size_t k = 0; k < 3; ++k) point.offset[k] += way[k] / length * distance;
        return point;
    }

private:
    std::mt19937_64 mBits;
};

// Points 0 and 1, and the verdict of one search on them, which must be symmetric.
bool areNeighbors(SearchEngine& engine, const ParticleView& view, double radius, const SearchOptions& options)
{
    const NeighborLists lists = engine.findNeighbors(view, radius, options);
    std::vector<std::uint32_t> row;
    bool found[2];
    for (std::uint32_t i = 0; i < 2; ++i) {
        lists.neighbors(i, row);
        found[i] = std::find(row.begin(), row.end(), 1 - i) != row.end();
    }
    EXPECT_EQ(found[0], found[1]);
    return found[0];
}

// A pair and a radius that differs from its distance by up to 4 ulps, with company or without.
PointSet randomPair(Random& random, Form form)
{
    PointSet set{"random pair", 0, {}, kIdentity};
    if (form == Form::kVoxels) {
        const std::vector<NamedLinear>& maps = linearMaps();
        set.linear =
            maps[static_cast<std::size_t>(random.integer(0, static_cast<int>(maps.size()) - 1))].linear;
    }
    const double distance =
        form == Form::kVoxels ? 2 : std::ldexp(random.uniform(1, 2), random.integer(-40, 40));
    const double reachOfCenters[] = {0, 3, 1e3, 1e6, 1e8};
    const int farthest = form == Form::kVoxels   ? 1
                         : form == Form::kFloats ? 3
                                                 : 4; // where pairs keep a distance
    const double spread = distance * reachOfCenters[random.integer(0, farthest)];
    const ExactPoint center = random.around(at(0, 0, 0), spread);
    set.points = {center, random.away(center, distance)};
    if (random.integer(0, 1) == 1) {
        for (int k = 0; k < kCompany; ++k) set.points.push_back(random.around(center, 0.4 * distance));
    }
    for (ExactPoint& point : set.points) {
        if (form == Form::kDoubles) continue;
        for (std::size_t k = 0; k < 3; ++k) {
            if (form == Form::kVoxels) {
                const double voxel = std::floor(point.offset[k] + 0.5);
                point.voxel[k] = static_cast<std::int64_t>(voxel) + 100000;
                point.offset[k] -= voxel;
            }
            point.offset[k] = roundedToFloat(point.offset[k]);
        }
    }
    set.radius = nudged(describePair(set, 0, 1).distance, random.integer(-4, 4));
    return set;
}

void expectRandomPairsRight(Form form, int count, std::uint64_t seed)
{
    Random random(seed);
    SearchEngine engine;
    std::uint64_t within = 0, beyondFilter = 0, exact = 0;
    const std::vector<SimdLevel> levels = simdLevels();
    for (int k = 0; k < count; ++k) {
        const PointSet set = randomPair(random, form);
        const SetView input(set, form);
        SearchOptions options;
        constexpr double kCellSizes[] = {1, 1.0 / 2, 1.0 / 3, 0.7, 1.5, 4};
        options.cellSize = kCellSizes[random.integer(0, 5)];
        options.simd =
            levels[static_cast<std::size_t>(random.integer(0, static_cast<int>(levels.size()) - 1))];
        options.encoding = random.integer(0, 2) == 0 ? Encoding::kMask : Encoding::kIndex;
        const bool expected = withinExactly(set.points[0], set.points[1], set.linear, set.radius);
        ASSERT_EQ(areNeighbors(engine, input.view(), set.radius, options), expected)
            << "pair " << k << ", seed " << seed << ", cells of " << options.cellSize << " radii"
            << ", " << simdLevelName(options.simd) << ", " << describePair(set, 0, 1).ulps
            << " ulps from the radius " << set.radius;
        within += expected;
        beyondFilter += engine.statistics().doublePairs > 0;
        exact += engine.statistics().exactPairs > 0;
    }
    // The cases are hard ones, on both sides: no filter in float32 can decide them.
    const auto all = static_cast<std::uint64_t>(count);
    EXPECT_GT(within, all / 5);
    EXPECT_LT(within, all - all / 5);
    EXPECT_GT(beyondFilter, all * 9 / 10);
    EXPECT_GT(exact, all / 5);
}

TEST(Filter, RandomPairsOfDoubles)
{
    expectRandomPairsRight(Form::kDoubles, 4000, 11);
}

TEST(Filter, RandomPairsOfFloats)
{
    expectRandomPairsRight(Form::kFloats, 2000, 12);
}

TEST(Filter, RandomPairsOfVoxels)
{
    expectRandomPairsRight(Form::kVoxels, 2000, 13);
}

// Hubs with satellites at the radius but for an ulp or two, in a volume of a few radii.
PointSet hubs(double radius, int satellites, std::uint64_t seed)
{
    Random random(seed);
    PointSet set{"hubs, radius " + std::to_string(std::ilogb(radius)) + " bits", radius, {}, kIdentity};
    for (int hub = 0; hub < 4; ++hub) {
        const ExactPoint center = random.around(at(0, 0, 0), radius);
        set.points.push_back(center);
        for (int k = 0; k < satellites; ++k) {
            ExactPoint point = random.away(center, radius);
            double& x = point.offset[static_cast<std::size_t>(random.integer(0, 2))];
            x = nudged(x, random.integer(-2, 2));
            set.points.push_back(point);
        }
    }
    return set;
}

TEST(Filter, SmallAndLargeRadii)
{
    const double radii[] = {1e-300, 1e-292, 1e-289, 1e-12, 0.1, 1, 1e12, 9e299, 1e300, 2e300, 1e307};
    for (const double radius : radii) {
        SCOPED_TRACE(radius);
        EXPECT_GT(expectOracle(hubs(radius, 10, 5)), 0u); // 44 particles: sparse leaves
        EXPECT_GT(expectOracle(hubs(radius, 60, 6)), 0u); // 244: a dense one
    }
}

TEST(Filter, DenormalRadiiAndDifferences)
{
    for (const double radius : {kLeast, 2 * kLeast, 3 * kLeast, 5 * kLeast, 1e-310}) {
        PointSet set{"denormal radius", radius, {}, kIdentity};
        for (int x = -3; x <= 3; ++x) {
            for (int y = -3; y <= 3; ++y) {
                for (int z = -1; z <= 2; ++z) {
                    set.points.push_back(at(x * kLeast, y * kLeast, z * kLeast));
                    if (radius == 1e-310)
                        set.points.push_back(at(radius + x * kLeast, y * kLeast, z * radius));
                }
            }
        }
        expectOracle(set);
        set.points.resize(100); // a sparse leaf
        expectOracle(set);
    }
}

TEST(Filter, ADenormalBeyondTheRadiusIsBeyond)
{
    for (const double radius : {1e-100, 0.1, 1.0, 1e100}) {
        PointSet set{"denormal beside the radius", radius, {}, kIdentity};
        set.points = {at(0, 0, 0), at(radius, 0, 0), at(radius, kLeast, 0), at(0, -radius, kLeast),
                      at(0, 0, -radius)};
        EXPECT_EQ(oracleLists(set)[0], (std::vector<std::uint32_t>{1, 4}));
        expectOracle(set);
        Random random(3);
        for (int k = 0; k < kCompany; ++k) set.points.push_back(random.around(at(0, 0, 0), radius / 4));
        expectOracle(set);
    }
    PointSet floats{"denormal floats", 0.5, {}, kIdentity};
    constexpr double kLeastFloat = 0x1p-149;
    floats.points = {at(0, 0, 0), at(0.5, 0, 0), at(0.5, kLeastFloat, 0), at(kLeastFloat, 0, -0.5),
                     at(-kLeastFloat, 0, 0)};
    expectOracle(floats, Form::kFloats);
    floats.points = {at(0, 0, 0), at(kLeastFloat, 0, 0), at(2 * kLeastFloat, 0, 0),
                     at(2 * kLeastFloat, kLeastFloat, 0)};
    floats.radius = 2 * kLeastFloat;
    expectOracle(floats, Form::kFloats);
}

TEST(Filter, TheLargestNumbers)
{
    PointSet set{"largest", kMost, {}, kIdentity};
    set.points = {at(kMost, 0, 0), at(-kMost, 0, 0), at(0, 0, 0), at(0, kMost, 0),
                  at(0, nudged(kMost, -1), kLeast)};
    expectOracle(set);
    set.radius = kMost / 2;
    expectOracle(set);
}

// Triples at the radius exactly, and one step of the coordinates beside it, far from the origin.
TEST(Filter, TiesFarFromTheOrigin)
{
    for (const double far : {0.0, 1e3, -1e6, 1e8}) {
        for (const int company : {0, kCompany}) {
            PointSet set{"ties far out at " + std::to_string(far), 5, {}, kIdentity};
            const double unit = std::max(nudged(std::fabs(far), 1) - std::fabs(far), 0x1p-50);
            const double ways[][3] = {{3, 4, 0}, {-4, 0, 3}, {0, -3, -4}, {5, 0, 0}, {0, 0, -5}, {0, 5, 0}};
            set.points.push_back(at(far, -far, 2 * far));
            for (const auto& way : ways) {
                for (const int step : {-1, 0, 1}) {
                    ExactPoint point = set.points[0];
                    for (std::size_t k = 0; k < 3; ++k) point.offset[k] += way[k];
                    point.offset[way[0] != 0 ? 0 : 1] += step * 4 * unit;
                    set.points.push_back(point);
                }
            }
            Random random(8);
            for (int k = 0; k < company; ++k) set.points.push_back(random.around(set.points[0], 2));
            const Lists oracle = oracleLists(set);
            EXPECT_GT(oracle[0].size(), static_cast<std::size_t>(company) + 5);
            EXPECT_LT(oracle[0].size(), set.points.size() - 4);
            EXPECT_GT(expectOracle(set), 0u);
        }
    }
}

// A particle at a face between cells or leaves, a few ulps to either side, and partners a radius away.
PointSet facePairs(double radius, double face, std::size_t axis, int copies)
{
    PointSet set{"face at " + std::to_string(face / radius) + " radii, axis " + std::to_string(axis),
                 radius,
                 {},
                 kIdentity};
    Random random(21);
    for (int copy = 0; copy < copies; ++copy) {
        ExactPoint base = random.around(at(0, 0, 0), copy ? radius : 0);
        for (int step = -2; step <= 2; ++step) {
            base.offset[axis] = nudged(face, step);
            set.points.push_back(base);
            for (const double way : {-radius, radius}) {
                ExactPoint partner = base;
                partner.offset[axis] = nudged(face + way, step);
                set.points.push_back(partner);
            }
        }
    }
    return set;
}

TEST(Filter, PairsAcrossFacesOfCellsAndLeaves)
{
    for (const double radius : {1.0, 0.3, 7e-5}) {
        for (int reach = 1; reach <= 3; ++reach) {
            const double edge = radius * (1 + 0x1p-16) / reach;
            for (const int cell : {-1024, -8, -3, -1, 0, 1, 7, 8, 16, 1 << 20}) {
                const auto axis = static_cast<std::size_t>(std::abs(cell) + reach) % 3;
                const Span<const int> own(&reach, 1); // the one that has faces there
                expectOracle(facePairs(radius, cell * edge, axis, 1), Form::kDoubles,
                             own); // 15 particles: sparse
                expectOracle(facePairs(radius, cell * edge, axis, 15), Form::kDoubles, own); // 225: dense
            }
        }
    }
}

} // namespace

} // namespace vdb_nns::testing
