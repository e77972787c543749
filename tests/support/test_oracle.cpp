// Hand-worked cases for the oracle, and checks that the distributions and the comparator can tell right from wrong.
#include "../support/comparator.h"
#include "../support/distributions.h"
#include "../support/oracle.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>

namespace vdb_nns::testing {

namespace {

ExactPoint at(double x, double y, double z)
{
    return {{0, 0, 0}, {x, y, z}};
}
ExactPoint voxel(std::int64_t x, std::int64_t y, std::int64_t z)
{
    return {{x, y, z}, {0, 0, 0}};
}
double below(double x)
{
    return std::nextafter(x, 0.0);
}

TEST(Oracle, TheBallIsClosed)
{
    EXPECT_TRUE(withinExactly(at(1, 1, 1), at(4, 5, 1), kIdentity, 5));
    EXPECT_FALSE(withinExactly(at(1, 1, 1), at(4, 5, 1), kIdentity, below(5)));
}

TEST(Oracle, NoRoundingDecides)
{
    // 3 * 0.1 in real numbers, with 0.1 the double, lies between the doubles 0.3 and 0.30000000000000004.
    const Linear tenth{{{0.1, 0, 0}, {0, 0.1, 0}, {0, 0, 0.1}}};
    EXPECT_FALSE(withinExactly(voxel(0, 0, 0), voxel(0, 3, 0), tenth, 0.3));
    EXPECT_TRUE(withinExactly(voxel(0, 0, 0), voxel(0, 3, 0), tenth, 0.30000000000000004));
    EXPECT_TRUE(withinExactly(voxel(7, 0, 0), voxel(9, 0, 0), tenth, 0.2));
    EXPECT_FALSE(withinExactly(voxel(7, 0, 0), voxel(9, 0, 0), tenth, below(0.2)));
    // 2^32 + 2^-30 is no double, and its excess over the radius must not be lost.
    ExactPoint b = voxel(4294967296, 0, 0);
    EXPECT_TRUE(withinExactly(voxel(0, 0, 0), b, kIdentity, 4294967296.0));
    b.offset[0] = 0x1p-30;
    EXPECT_FALSE(withinExactly(voxel(0, 0, 0), b, kIdentity, 4294967296.0));
    // A component of 2^-40 beside one that equals the radius.
    EXPECT_FALSE(withinExactly(at(0, 0, 0), at(1, 0, 0x1p-40), kIdentity, 1));
}

TEST(Oracle, TinyAndHugeNumbers)
{
    constexpr double kLeast = std::numeric_limits<double>::denorm_min();
    EXPECT_TRUE(withinExactly(at(0, 0, 0), at(0, kLeast, 0), kIdentity, kLeast));
    EXPECT_FALSE(withinExactly(at(0, 0, 0), at(0, 2 * kLeast, 0), kIdentity, kLeast));
    EXPECT_FALSE(withinExactly(at(kLeast, 0, 0), at(0, kLeast, 0), kIdentity, kLeast));
    constexpr double kMost = std::numeric_limits<double>::max();
    EXPECT_FALSE(withinExactly(at(kMost, 0, 0), at(-kMost, 0, 0), kIdentity, kMost));
    EXPECT_TRUE(withinExactly(at(kMost / 2, 0, 0), at(-kMost / 2, 0, 0), kIdentity, kMost));
}

TEST(Oracle, TheMapTakesColumnVectors)
{
    const Linear shear{{{1, 1, 0}, {0, 1, 0}, {0, 0, 1}}}; // y = (0, 1, 0) goes to (1, 1, 0)
    EXPECT_TRUE(withinExactly(voxel(0, 0, 0), voxel(1, 0, 0), shear, 1));
    EXPECT_FALSE(withinExactly(voxel(0, 0, 0), voxel(0, 1, 0), shear, 1.4));
    EXPECT_TRUE(withinExactly(voxel(0, 0, 0), voxel(0, 1, 0), shear, 1.5));
}

TEST(Oracle, ListsOfThreePoints)
{
    constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
    const PointSet set{
        "hand", 1, {at(0, 0, 0), at(1, 0, 0), at(kNaN, 0, 0), at(1, 0, 0), at(2.5, 0, 0)}, kIdentity};
    const Lists expected{{1, 3}, {0, 3}, {}, {0, 1}, {}};
    EXPECT_EQ(oracleLists(set), expected);
}

// The quick test in double must agree with the exact one where it speaks.
TEST(Oracle, TheQuickTestAgreesWithTheExactOne)
{
    std::vector<PointSet> sets = gridSets();
    for (const PointSet& set : arraySets(Precision::kDouble)) sets.push_back(set);
    for (const PointSet& set : sets) {
        const Lists lists = oracleLists(set);
        for (std::size_t i = 0; i < set.points.size(); i += 61) {
            const std::set<std::uint32_t> row(lists[i].begin(), lists[i].end());
            for (std::size_t j = 0; j < set.points.size(); j += 7) {
                if (!isFinite(set.points[i]) || !isFinite(set.points[j])) {
                    EXPECT_EQ(row.count(static_cast<std::uint32_t>(j)), 0U);
                } else if (i != j) {
                    EXPECT_EQ(row.count(static_cast<std::uint32_t>(j)) == 1,
                              withinExactly(set.points[i], set.points[j], set.linear, set.radius))
                        << set.name << ": " << i << ", " << j;
                }
            }
        }
    }
}

TEST(Oracle, DescribesAPair)
{
    const PointSet set{"hand", below(5), {at(0, 0, 0), at(3, 4, 0)}, kIdentity};
    EXPECT_EQ(describePair(set, 0, 1).distance, 5);
    EXPECT_EQ(describePair(set, 0, 1).ulps, 1);
}

std::uint64_t pairsOf(const Lists& lists)
{
    std::uint64_t pairs = 0;
    for (const auto& row : lists) pairs += row.size();
    return pairs;
}

TEST(Distributions, HaveTheirPairs)
{
    std::set<std::string> names;
    for (const PointSet& set : arraySets(Precision::kFloat)) {
        names.insert(set.name);
        const std::uint64_t pairs = pairsOf(oracleLists(set));
        if (set.name == "empty" || set.name == "one") {
            EXPECT_EQ(pairs, 0U) << set.name;
        } else if (set.name == "two coincident") {
            EXPECT_EQ(pairs, 2U);
        } else if (set.name == "all coincident") {
            EXPECT_EQ(pairs, 150U * 149U);
        } else if (set.name == "lattice") {
            // Differences of length <= 2 on an 8^3 lattice: 6 of (1,0,0), 12 of (1,1,0), 8 of (1,1,1), 6 of (2,0,0).
            EXPECT_EQ(pairs, 6U * 7 * 64 + 12U * 49 * 8 + 8U * 343 + 6U * 6 * 64);
        } else {
            EXPECT_GT(pairs, set.points.size() / 2) << set.name;
            EXPECT_LT(pairs, set.points.size() * 150) << set.name;
        }
    }
    EXPECT_EQ(names.size(), 14U);
}

TEST(Distributions, GridsKeepTheTiesOfTheLattice)
{
    std::uint64_t checked = 0;
    for (const PointSet& set : gridSets()) {
        for (const char* map : {"identity", "scale", "reflection"}) {
            if (set.name != std::string("lattice, ") + map) continue;
            EXPECT_EQ(pairsOf(oracleLists(set)), 6U * 7 * 64 + 12U * 49 * 8 + 8U * 343 + 6U * 6 * 64) << map;
            PointSet smaller = set;
            smaller.radius = below(set.radius);
            EXPECT_EQ(pairsOf(oracleLists(smaller)), 6U * 7 * 64 + 12U * 49 * 8 + 8U * 343) << map;
            ++checked;
        }
    }
    EXPECT_EQ(checked, 3U);
}

TEST(Distributions, AreSeeded)
{
    const PointSet a = arraySets(Precision::kDouble, 3)[5], b = arraySets(Precision::kDouble, 3)[5];
    const PointSet c = arraySets(Precision::kDouble, 4)[5];
    EXPECT_EQ(doublesOf(a), doublesOf(b));
    EXPECT_NE(doublesOf(a), doublesOf(c));
}

TEST(Distributions, ShufflingKeepsThePairs)
{
    const PointSet set = arraySets(Precision::kFloat)[5];
    std::vector<std::uint32_t> order;
    const PointSet other = shuffled(set, 9, order);
    const Lists lists = oracleLists(set), moved = oracleLists(other);
    EXPECT_NE(lists, moved);
    for (std::size_t k = 0; k < order.size(); ++k) {
        std::set<std::uint32_t> back;
        for (const std::uint32_t j : moved[k]) back.insert(order[j]);
        const auto& row = lists[order[k]];
        EXPECT_EQ(back, std::set<std::uint32_t>(row.begin(), row.end()));
    }
}

TEST(Comparator, NamesThePairAndItsDistance)
{
    const PointSet set{"hand", 1, {at(0, 0, 0), at(1, 0, 0), at(3, 0, 0)}, kIdentity};
    const Lists expected = oracleLists(set);
    EXPECT_TRUE(sameLists({{1}, {0}, {}}, expected, set));
    const auto missing = sameLists({{1}, {}, {}}, expected, set);
    EXPECT_FALSE(missing);
    EXPECT_NE(
        std::string(missing.message()).find("missing pair (1, 0): distance 1, distance - radius = 0 ulps"),
        std::string::npos)
        << missing.message();
    const auto extra = sameLists({{1}, {0, 2}, {}}, expected, set);
    EXPECT_FALSE(extra);
    EXPECT_NE(std::string(extra.message()).find("extra pair (1, 2): distance 2"), std::string::npos);
    const auto twice = sameLists({{1, 1}, {0}, {}}, expected, set);
    EXPECT_FALSE(twice);
    EXPECT_NE(std::string(twice.message()).find("double pair (0, 1)"), std::string::npos);
    EXPECT_FALSE(sameLists({{1}, {0}}, expected, set));
    EXPECT_FALSE(sameLists({{1}, {0, 17}, {}}, expected, set));
    EXPECT_TRUE(sameCounts({1, 1, 0}, expected));
    EXPECT_FALSE(sameCounts({1, 0, 0}, expected));
}

} // namespace

} // namespace vdb_nns::testing
