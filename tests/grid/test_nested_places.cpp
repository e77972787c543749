// Where a leaf is among wider cells, against integer arithmetic; and the filter of leaves that may touch those of a grid.
#include "grid/leaf_table.h"
#include "grid/wide_leaf.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

namespace vdb_nns::testing {
namespace {

// Rounded down.
std::int64_t halved(std::int64_t cell, int octaves)
{
    return octaves >= 62 ? (cell < 0 ? -1 : 0) : cell >> octaves;
}

TEST(WideLeaf, HoldsTheCellsOfTheLeaf)
{
    std::mt19937_64 random(1);
    for (int octaves = 1; octaves <= 60; ++octaves) {
        for (int trial = 0; trial < 300; ++trial) {
            Vec3i origin;
            for (std::int32_t& o : origin) {
                const int bits = static_cast<int>(random() % 31);
                const auto size = static_cast<std::int64_t>(random() % (std::uint64_t(1) << bits));
                o = static_cast<std::int32_t>((random() % 2 ? size : -size) & ~std::int64_t(7));
            }
            const WideLeaf wide = wideLeafOf(origin, octaves);
            for (int axis = 0; axis < 3; ++axis) {
                const std::int64_t corner = wide.origin[axis];
                EXPECT_EQ(corner % 8, 0);
                for (int c = 0; c < 8; ++c) {
                    const std::int64_t cell = halved(origin[axis] + std::int64_t(c), octaves) - corner;
                    EXPECT_GE(cell, 0);
                    EXPECT_LT(cell, 8);
                    EXPECT_EQ(wide.place.wideCell(axis, c), cell) << octaves << " octaves, cell " << c;
                }
                // Coordinates about the centers: x of the leaf's is scale * x + shift of the wide one's.
                const long double center = std::ldexp(static_cast<long double>(origin[axis]) + 4, -octaves);
                EXPECT_EQ(wide.place.scale, std::ldexp(1.0f, -octaves));
                EXPECT_NEAR(static_cast<double>(wide.place.shift[axis]),
                            static_cast<double>(center - (static_cast<long double>(corner) + 4)), 4e-7);
            }
        }
    }
}

TEST(TouchFilter, MissesNoneAndTurnsMostDown)
{
    std::mt19937 random(2);
    const auto leafCoordinate = [&] { return static_cast<std::int32_t>(random() % 100000) - 50000; };
    std::vector<Vec3i> origins;
    for (int i = 0; i < 3000; ++i)
        origins.push_back({8 * leafCoordinate(), 8 * leafCoordinate(), 8 * leafCoordinate()});
    origins.push_back({2147479544, -2147479552, 0}); // as far as cells go
    const TouchFilter filter(origins);
    for (const Vec3i& o : origins) {
        for (int n = 0; n < 27; ++n)
            EXPECT_TRUE(filter.mayTouch((o[0] >> 3) + n / 9 - 1, (o[1] >> 3) + n / 3 % 3 - 1,
                                        (o[2] >> 3) + n % 3 - 1));
    }
    int passed = 0;
    constexpr int kTrials = 100000;
    for (int i = 0; i < kTrials; ++i)
        passed += filter.mayTouch(leafCoordinate(), leafCoordinate(), leafCoordinate());
    EXPECT_LT(passed, kTrials / 3);
    EXPECT_FALSE(TouchFilter(std::vector<Vec3i>()).mayTouch(0, 0, 0));
}

} // namespace
} // namespace vdb_nns::testing
