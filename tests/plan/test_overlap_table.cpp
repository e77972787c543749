// The overlap shares of two cells: against closed forms worked by hand, against an adaptive quadrature that
// shares nothing with the table's but the definition, and against each other.
#include "plan/overlap_table.h"

#include <boost/math/constants/constants.hpp>
#include <boost/math/quadrature/gauss_kronrod.hpp>

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

const CancelCheck kNeverCancelled(nullptr, "test");

constexpr double kPi = boost::math::constants::pi<double>();
constexpr double kTolerance = 1e-11;   // a hundred times tighter than the header promises
constexpr double kUsual = 1 + 0x1p-16; // a cell edge is the radius / reach times this

// The radii of a reach: tiny, usual, an integer, where a kink appears at a square root, and just beside
// those.
std::vector<double> radiiOf(int reach)
{
    std::vector<double> radii{1e-3, 0.1, 0.5, 0.9, reach / kUsual};
    for (const int square : {1, 2, 4, 5, 8, 9}) {
        for (const double nudge : {-1e-2, -1e-5, -1e-9, 0.0, 1e-9, 1e-5, 1e-2}) {
            const double radius = std::sqrt(square) + nudge;
            if (radius <= reach) radii.push_back(radius);
        }
    }
    return radii;
}

template <class Check>
void forEachClass(int reach, const Check& check)
{
    for (int c = 0; c <= reach; ++c) {
        for (int b = 0; b <= c; ++b) {
            for (int a = 0; a <= b; ++a) {
                SCOPED_TRACE("offset " + std::to_string(a) + " " + std::to_string(b) + " " +
                             std::to_string(c));
                check(a, b, c);
            }
        }
    }
}

double tent(double s)
{
    return std::max(0.0, 1 - std::fabs(s));
}

// The integral of tent * function within the bound, adaptive: it is told no kink but the tent's own.
template <class Function>
double integralOverTent(double offset, double bound, const Function& function)
{
    constexpr unsigned kDepth = 12;
    constexpr double kRelative = 1e-8;
    double total = 0;
    for (const double start : {offset - 1, offset}) {
        const double low = std::max(start, -bound), high = std::min(start + 1, bound);
        if (low >= high) continue;
        total += boost::math::quadrature::gauss_kronrod<double, 15>::integrate(
            [&](double s) { return tent(s - offset) * function(s); }, low, high, kDepth, kRelative);
    }
    return total;
}

// A tent is linear on each half: the trapezoid rule is exact.
double tentBetween(double offset, double bound)
{
    double total = 0;
    for (const double start : {offset - 1, offset}) {
        const double low = std::max(start, -bound), high = std::min(start + 1, bound);
        if (low < high) total += (high - low) * (tent(low - offset) + tent(high - offset)) / 2;
    }
    return total;
}

// Over the whole ball, one variable inside the other.
double shareByDefinition(double radius, int dx, int dy, int dz)
{
    return integralOverTent(dx, radius, [&](double u) {
        const double disc = std::sqrt(std::max(0.0, radius * radius - u * u));
        return integralOverTent(dy, disc, [&](double v) {
            return tentBetween(dz, std::sqrt(std::max(0.0, disc * disc - v * v)));
        });
    });
}

} // namespace

TEST(OverlapTable, SharesSumToTheVolumeOfTheBall)
{
    for (int reach = 1; reach <= OverlapTable::kMaxReach; ++reach) {
        for (const double radius : radiiOf(reach)) {
            SCOPED_TRACE("reach " + std::to_string(reach) + ", radius " + std::to_string(radius));
            const OverlapTable table = OverlapTable::byQuadrature(radius, reach);
            EXPECT_EQ(table.reach(), reach);
            const double volume = 4.0 / 3.0 * kPi * std::pow(radius, 3);
            EXPECT_NEAR(table.sum() / volume, 1, 1e-12);
        }
    }
}

TEST(OverlapTable, SignsAndAxesDoNotMatter)
{
    const OverlapTable table = OverlapTable::byQuadrature(2.9, 3);
    EXPECT_GT(table.share(1, 2, 3), 0);
    for (const int sign : {-1, 1}) {
        EXPECT_EQ(table.share(1, 2, 3), table.share(3 * sign, 1, -2));
        EXPECT_EQ(table.share(1, 2, 3), table.share(-2, sign, 3));
        EXPECT_EQ(table.share(0, 0, 1), table.share(0, sign, 0));
    }
}

// A radius up to 1. Over one octant of the ball, with r^2 dr giving the powers and the sphere the factors:
//   volume     pi r^3 / 6
//   u          r^4/4 * pi/4         = pi r^4 / 16     (a coordinate is 1/2 on average, the octant pi/2)
//   u v        r^5/5 * 2/3 * 1/2    = r^5 / 15        (of sin^3(polar) and of sin cos(azimuth))
//   u v w      r^6/6 * 1/4 * 1/2    = r^6 / 48        (of sin^3 cos(polar) and of sin cos(azimuth))
// In it the tent of offset 0 is 1 - u and that of offset 1 is u. An offset of 0 counts both signs of its
// coordinate.
TEST(OverlapTable, ClosedFormsUpToOneCell)
{
    for (const double radius : {1e-3, 0.25, 0.5, 0.8, 1 / kUsual, 1.0}) {
        SCOPED_TRACE(radius);
        const double volume = kPi * std::pow(radius, 3) / 6, u = kPi * std::pow(radius, 4) / 16;
        const double uv = std::pow(radius, 5) / 15, uvw = std::pow(radius, 6) / 48;
        for (int reach = 1; reach <= OverlapTable::kMaxReach; ++reach) {
            const OverlapTable table = OverlapTable::byQuadrature(radius, reach);
            const auto expectShare = [&](int a, int b, int c, double expected) {
                EXPECT_NEAR(table.share(a, b, c) / expected, 1, kTolerance) << a << b << c;
            };
            expectShare(0, 0, 0, 8 * (volume - 3 * u + 3 * uv - uvw));
            expectShare(0, 0, 1, 4 * (u - 2 * uv + uvw));
            expectShare(0, 1, 1, 2 * (uv - uvw));
            expectShare(1, 1, 1, uvw);
            if (reach > 1) {
                EXPECT_EQ(table.share(0, 0, 2), 0);
            }
        }
    }
}

// Two cells along an axis, a radius r from 1 to sqrt(2): the ball reaches u in [1, r], where the tent is
// u - 1, and in the plane of u the disc's radius R = sqrt(r^2 - u^2) is at most 1. The integral of
// (1 - |v|)(1 - |w|) over the disc is
//   pi R^2 - 2 * 4/3 R^3 + R^4 / 2.
// With s = r^2 - 1 the three parts of the integral over u are
//   pi   * [r^2 (u^2/2 - u) - u^4/4 + u^3/3]            from 1 to r
//   -8/3 * [s^(5/2)/5 - J],  J = integral of (r^2 - u^2)^(3/2) = 3/8 r^4 acos(1/r) - (5 r^2 - 2) sqrt(s) / 8
//   1/2  * [s^3/6 - (r^4 u - 2/3 r^2 u^3 + u^5/5)]      the last from 1 to r.
TEST(OverlapTable, ClosedFormTwoCellsAway)
{
    for (const double r : {1.05, 1.2, 1.4, std::sqrt(2)}) {
        SCOPED_TRACE(r);
        const double r2 = r * r, s = r2 - 1;
        const auto first = [&](double u) {
            return r2 * (u * u / 2 - u) - std::pow(u, 4) / 4 + std::pow(u, 3) / 3;
        };
        const auto last = [&](double u) {
            return r2 * r2 * u - 2.0 / 3.0 * r2 * std::pow(u, 3) + std::pow(u, 5) / 5;
        };
        const double j = 3.0 / 8.0 * r2 * r2 * std::acos(1 / r) - (5 * r2 - 2) * std::sqrt(s) / 8;
        const double expected = kPi * (first(r) - first(1)) - 8.0 / 3.0 * (std::pow(s, 2.5) / 5 - j) +
                                (std::pow(s, 3) / 6 - (last(r) - last(1))) / 2;
        EXPECT_GT(expected, 0);
        for (const int reach : {2, 3}) {
            EXPECT_NEAR(OverlapTable::byQuadrature(r, reach).share(0, 0, 2), expected, kTolerance);
        }
    }
}

// The points of two cells are at most sqrt(sum (d + 1)^2) apart, and at least sqrt(sum (d - 1)^2) over the d
// above 0.
TEST(OverlapTable, AllPairsAndNoPairs)
{
    const OverlapTable two = OverlapTable::byQuadrature(std::sqrt(3), 2);
    EXPECT_NEAR(two.share(0, 0, 0), 1, kTolerance);
    EXPECT_LT(two.share(0, 0, 1), 1 - 1e-3);
    EXPECT_NEAR(two.share(2, 2, 2), 0, kTolerance);
    EXPECT_GT(two.share(1, 2, 2), 1e-6);

    const OverlapTable three = OverlapTable::byQuadrature(3, 3);
    EXPECT_NEAR(three.share(0, 0, 1), 1, kTolerance);
    EXPECT_NEAR(three.share(0, 1, 1), 1, kTolerance);
    EXPECT_LT(three.share(1, 1, 1), 1 - 1e-4);
    EXPECT_NEAR(three.share(2, 3, 3), 0, kTolerance);
    EXPECT_EQ(three.share(3, 3, 3), 0);
}

TEST(OverlapTable, AgreesWithTheDefinition)
{
    for (const auto& [radius, reach] : {std::pair(0.999, 1), std::pair(1.37, 2), std::pair(2 / kUsual, 2),
                                        std::pair(2.3, 3), std::pair(3 / kUsual, 3)}) {
        SCOPED_TRACE(radius);
        const OverlapTable table = OverlapTable::byQuadrature(radius, reach);
        forEachClass(reach, [&, radius = radius](int a, int b, int c) {
            EXPECT_NEAR(table.share(a, b, c), shareByDefinition(radius, a, b, c), 1e-9);
        });
    }
}

TEST(OverlapTable, MonteCarloAgrees)
{
    constexpr std::uint64_t kSamples = 100000;
    for (const auto& [radius, reach] : {std::pair(1 / kUsual, 1), std::pair(1.5, 2), std::pair(2.9, 3)}) {
        SCOPED_TRACE(radius);
        const OverlapTable exact = OverlapTable::byQuadrature(radius, reach);
        const OverlapTable random = OverlapTable::byMonteCarlo(radius, reach, kSamples, 1, kNeverCancelled);
        EXPECT_EQ(random.reach(), reach);
        forEachClass(reach, [&](int a, int b, int c) {
            const double share = exact.share(a, b, c);
            // One more pair: where hardly any is expected, counts are Poisson and not normal.
            const double error =
                5 * std::sqrt(std::max(0.0, share * (1 - share)) / kSamples) + 1.0 / kSamples;
            EXPECT_NEAR(random.share(a, b, c), share, error);
        });
    }
}

TEST(OverlapTable, MonteCarloIsAFunctionOfItsSeed)
{
    constexpr std::uint64_t kSamples = 10000;
    const OverlapTable one = OverlapTable::byMonteCarlo(1, 1, kSamples, 1, kNeverCancelled);
    const OverlapTable again = OverlapTable::byMonteCarlo(1, 1, kSamples, 1, kNeverCancelled);
    const OverlapTable other = OverlapTable::byMonteCarlo(1, 1, kSamples, 2, kNeverCancelled);
    forEachClass(1, [&](int a, int b, int c) { EXPECT_EQ(one.share(a, b, c), again.share(a, b, c)); });
    EXPECT_NE(one.share(0, 0, 0), other.share(0, 0, 0));
    EXPECT_NE(one.sum(), other.sum());
}

} // namespace vdb_nns::testing
