// ExactTest against the oracle's integers of unlimited size (Boost.Multiprecision): stored positions with exponents wide
// apart, matrices that fit the fast path and matrices that do not, ties, and radii whose last bit is finer or coarser than
// that of the coordinates.
#include "agreement/point_views.h"
#include "exact/exact_test.h"

#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace vdb_nns::testing {

namespace {

constexpr double kMost = std::numeric_limits<double>::max();

class ExactTests : public ::testing::Test {
protected:
    std::mt19937_64 bits{4711};

    int integer(int low, int high)
    {
        return low + static_cast<int>(bits() % static_cast<std::uint64_t>(high - low + 1));
    }

    // mantissaBits random bits times a power of two; one time in eight zero.
    double number(int mantissaBits, int lowExponent, int highExponent)
    {
        if (integer(0, 7) == 0) return 0;
        const auto mantissa = static_cast<double>(bits() >> (64 - mantissaBits));
        return std::ldexp(integer(0, 1) ? mantissa : -mantissa, integer(lowExponent, highExponent));
    }

    ExactPoint point(std::int64_t voxels, int mantissaBits, int lowExponent, int highExponent)
    {
        ExactPoint p;
        for (std::size_t k = 0; k < 3; ++k) {
            if (voxels) p.voxel[k] = static_cast<std::int64_t>(bits() % (2 * voxels)) - voxels;
            p.offset[k] = number(mantissaBits, lowExponent, highExponent);
        }
        return p;
    }

    // The distance of the pair, rounded, and up to 2 ulps more or less; a positive finite number.
    double radiusNear(const PointSet& set)
    {
        double radius = describePair(set, 0, 1).distance;
        if (!(radius > 0)) radius = std::numeric_limits<double>::denorm_min();
        if (!(radius < kMost)) radius = kMost;
        for (int step = integer(-2, 2); step != 0; step -= step > 0 ? 1 : -1) {
            const double next = std::nextafter(radius, step > 0 ? kMost : 0.0);
            if (next > 0) radius = next;
        }
        return radius;
    }

    // Both tests, both ways round. Returns the verdict.
    bool expectRight(const PointSet& set, Form form)
    {
        const bool expected = withinExactly(set.points[0], set.points[1], set.linear, set.radius);
        const SetView input(set, form);
        const ExactTest test(input.view(), set.radius);
        const ParticleSource& source = input.view().source();
        EXPECT_EQ(test.isNeighborExactly(source.stored(0), source.stored(1), set.radius), expected)
            << textOf(set);
        EXPECT_EQ(test.isNeighborExactly(source.stored(1), source.stored(0), set.radius), expected)
            << textOf(set);
        ExactTestMemory memory;
        for (int k = 0; k < 2; ++k) { // the second time from memory
            EXPECT_EQ(test.isNeighbor(0, 1, memory, exactPairs), expected) << textOf(set);
            EXPECT_EQ(test.isNeighbor(1, 0, memory, exactPairs), expected) << textOf(set);
        }
        return expected;
    }

    // `count` random pairs near the radius, some within it and some not.
    template <typename MakePair>
    void expectRightForAll(int count, const Linear& linear, Form form, MakePair&& makePair)
    {
        int within = 0;
        for (int k = 0; k < count; ++k) {
            PointSet set{"pair " + std::to_string(k), 0, {}, linear};
            set.points = {makePair(), makePair()};
            set.radius = radiusNear(set);
            within += expectRight(set, form);
            if (HasFailure()) return;
        }
        EXPECT_GT(within, count / 10);
        EXPECT_LT(within, count - count / 10);
    }

    std::uint64_t exactPairs = 0;

private:
    static std::string textOf(const PointSet& set)
    {
        std::string text = set.name;
        char number[64];
        for (const ExactPoint& p : set.points) {
            for (std::size_t k = 0; k < 3; ++k) {
                std::snprintf(number, sizeof number, " %lld%+a", static_cast<long long>(p.voxel[k]),
                              p.offset[k]);
                text += number;
            }
        }
        std::snprintf(number, sizeof number, ", radius %a", set.radius);
        return text + number;
    }
};

TEST_F(ExactTests, ArraysOfEveryScale)
{
    expectRightForAll(2000, kIdentity, Form::kDoubles, [&] { return point(0, 53, -60, -50); });
    expectRightForAll(1000, kIdentity, Form::kDoubles, [&] { return point(0, 53, -1074, -1060); });
    expectRightForAll(1000, kIdentity, Form::kDoubles, [&] { return point(0, 53, 900, 960); });
    expectRightForAll(2000, kIdentity, Form::kFloats, [&] { return point(0, 24, -30, -20); });
    EXPECT_GT(exactPairs, 1000u);
}

TEST_F(ExactTests, ExponentsWideApart)
{
    // From pairs that fit 61 bits over those that just do not to those that need a thousand.
    for (const int spread : {4, 8, 30, 60, 100, 300, 900}) {
        expectRightForAll(300, kIdentity, Form::kDoubles, [&] { return point(0, 12, -spread, spread); });
        expectRightForAll(300, linearMaps()[3].linear, Form::kVoxels,
                          [&] { return point(1000, 24, -spread, spread / 9); });
    }
}

TEST_F(ExactTests, VoxelsUnderEveryMap)
{
    for (const NamedLinear& map : linearMaps()) {
        SCOPED_TRACE(map.name);
        expectRightForAll(400, map.linear, Form::kVoxels, [&] { return point(4, 24, -25, -24); });
        expectRightForAll(400, map.linear, Form::kVoxels,
                          [&] { return point(std::int64_t(1) << 31, 24, -40, -24); });
    }
}

TEST_F(ExactTests, MatricesOfAnyExponents)
{
    // Entries within 61 bits, just beyond, and far beyond: the last ones take integers of any size.
    for (const int spread : {0, 6, 9, 20, 300}) {
        for (int k = 0; k < 20; ++k) {
            Linear linear = kIdentity;
            for (auto& row : linear) {
                for (double& entry : row) entry = number(53, -spread - 50, spread - 50);
            }
            expectRightForAll(20, linear, Form::kVoxels, [&] { return point(100, 24, -30, -20); });
        }
    }
}

TEST_F(ExactTests, TiesAreNeighbors)
{
    // Whole numbers whose distance is whole, at every scale that keeps them exact.
    const double whole[][4] = {{3, 4, 0, 5},    {-2, 3, 6, 7},    {1, -4, 8, 9},
                               {2, 10, 11, 15}, {48, -64, 0, 80}, {0, 0, 1, 1}};
    for (const int scale : {-1070, -1000, -540, -60, 0, 60, 540, 1000}) {
        for (const auto& w : whole) {
            PointSet set{"tie at 2^" + std::to_string(scale), std::ldexp(w[3], scale), {}, kIdentity};
            const double unit = std::ldexp(1.0, scale);
            set.points = {{{0, 0, 0}, {unit, -unit, 2 * unit}},
                          {{0, 0, 0}, {unit + w[0] * unit, -unit + w[1] * unit, 2 * unit + w[2] * unit}}};
            EXPECT_TRUE(expectRight(set, Form::kDoubles));
            set.radius = std::nextafter(set.radius, 0.0);
            EXPECT_FALSE(expectRight(set, Form::kDoubles));
            if (std::abs(scale) > 20) continue;
            set.radius = w[3];
            for (std::size_t k = 0; k < 3; ++k) set.points[1].voxel[k] = static_cast<std::int64_t>(w[k]);
            set.points[1].offset = set.points[0].offset;
            EXPECT_TRUE(expectRight(set, Form::kVoxels));
            set.radius = std::nextafter(set.radius, 0.0);
            EXPECT_FALSE(expectRight(set, Form::kVoxels));
        }
    }
}

TEST_F(ExactTests, RadiiFinerAndCoarserThanTheCoordinates)
{
    PointSet set{"fine and coarse", 0, {{{0, 0, 0}, {0, 0, 0}}, {{0, 0, 0}, {3, 4, 0}}}, kIdentity};
    for (const double radius : {5.0, 5 + 0x1p-50, 5 - 0x1p-50, 0x1p100, 0x1p-100, 0x1.fffffffffffffp+126, 8.0,
                                4.0, kMost, std::numeric_limits<double>::denorm_min()}) {
        set.radius = radius;
        EXPECT_EQ(expectRight(set, Form::kDoubles), radius >= 5) << radius;
        EXPECT_EQ(expectRight(set, Form::kVoxels), radius >= 5) << radius;
    }
    // Coordinates with bits far below those of the radius.
    set.points[1].offset = {3, 4, 0x1p-500};
    set.radius = 5;
    EXPECT_FALSE(expectRight(set, Form::kDoubles));
    set.points[1].offset = {3, std::nextafter(4.0, 0.0), 0x1p-500};
    EXPECT_TRUE(expectRight(set, Form::kDoubles));
    // What a voxel adds, an offset may take away.
    set.points[1] = {{4, 5, 0}, {-1, -1, 0}};
    EXPECT_TRUE(expectRight(set, Form::kVoxels));
    set.points[1].offset[0] = -1 + 0x1p-24;
    EXPECT_FALSE(expectRight(set, Form::kVoxels));
}

TEST_F(ExactTests, TheSamePlaceIsWithinAnyRadius)
{
    for (const double radius : {std::numeric_limits<double>::denorm_min(), 1.0, kMost}) {
        PointSet set{
            "same place", radius, {{{0, 0, 0}, {0.1, -7, 1e30}}, {{0, 0, 0}, {0.1, -7, 1e30}}}, kIdentity};
        EXPECT_TRUE(expectRight(set, Form::kDoubles));
        EXPECT_TRUE(expectRight(set, Form::kVoxels));
        set.points = {{{0, 0, 0}, {0, -0.0, 0}}, {{0, 0, 0}, {-0.0, 0, 0}}};
        EXPECT_TRUE(expectRight(set, Form::kDoubles));
    }
}

TEST_F(ExactTests, ClearPairsNeedNoIntegers)
{
    PointSet set{"clear", 1, {{{0, 0, 0}, {0, 0, 0}}, {{0, 0, 0}, {0.999999, 0, 0}}}, kIdentity};
    EXPECT_TRUE(expectRight(set, Form::kDoubles));
    set.points[1].offset[0] = 1.000001;
    EXPECT_FALSE(expectRight(set, Form::kVoxels));
    EXPECT_EQ(exactPairs, 0u);
    set.points[1].offset[0] = 1;
    EXPECT_TRUE(expectRight(set, Form::kDoubles));
    EXPECT_EQ(exactPairs, 4u); // both ways, twice
}

} // namespace

} // namespace vdb_nns::testing
