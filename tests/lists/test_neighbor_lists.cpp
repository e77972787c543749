// Reading neighbor lists: statistics, the two encodings, lists that are empty or were never made, crowded cells that are
// searched in pieces, and reading from several threads. Larger sets than the agreement tests', with answers known by
// arithmetic.
#include "agreement/point_views.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>
#include <thread>

namespace vdb_nns::testing {

namespace {

NeighborLists listsOf(const ParticleView& view, double radius, Encoding encoding, int reach = 1)
{
    SearchOptions options;
    options.encoding = encoding;
    options.cellSize = 1.0 / reach;
    return findNeighbors(view, radius, options);
}

PointSet setOf(const std::vector<std::array<double, 3>>& positions, double radius)
{
    PointSet set{"given positions", radius, {}, kIdentity};
    for (const auto& position : positions) set.points.push_back({{0, 0, 0}, position});
    return set;
}

void expectUnreadable(const NeighborLists& lists)
{
    std::vector<std::uint32_t> row;
    EXPECT_THROW(lists.neighbors(0, row), InvalidInput);
    EXPECT_THROW(lists.indices(0), InvalidInput);
    EXPECT_THROW(lists.forEachNeighbor(0, [](std::uint32_t) {}), InvalidInput);
    EXPECT_THROW(lists.visitRows([](std::uint32_t, Span<const std::uint32_t>) {}), InvalidInput);
    EXPECT_THROW(lists.toCsr(), InvalidInput);
    EXPECT_THROW(lists.checksum(), InvalidInput);
}

TEST(NeighborLists, StatisticsAreThoseOfTheCounts)
{
    const double nan = std::nan("");
    // A chain of three, a pair, a lone one and one that is nowhere.
    const PointSet set =
        setOf({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {9, 9, 9}, {9, 9, 8}, {50, 0, 0}, {0, nan, 0}}, 1);
    const SetView input(set, Form::kDoubles);
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
        const NeighborLists lists = listsOf(input.view(), set.radius, encoding);
        EXPECT_EQ(lists.encoding(), encoding);
        EXPECT_EQ(lists.size(), 7u);
        EXPECT_EQ(lists.counts(), (std::vector<std::uint32_t>{1, 2, 1, 1, 1, 0, 0}));
        EXPECT_EQ(lists.pairCount(), 6u);
        EXPECT_EQ(lists.statistics().pairs, 6u);
        EXPECT_EQ(lists.statistics().min, 0u);
        EXPECT_EQ(lists.statistics().max, 2u);
        EXPECT_DOUBLE_EQ(lists.statistics().mean, 1); // of the finite ones
        EXPECT_EQ(lists.statistics().isolated, 1u);
        EXPECT_EQ(lists.grid().nonfiniteCount(), 1u);
        EXPECT_EQ(lists.view().size(), 7u);
    }
    const double pair[6] = {0, 0, 0, 1, 0, 0};
    EXPECT_EQ(listsOf(ParticleView::fromArray(pair, 2), 2, Encoding::kNone).statistics().min, 1u);
}

TEST(NeighborLists, WithoutParticlesOrWithOne)
{
    const double place[3] = {1, -2, 3};
    for (const std::size_t count : {0, 1}) {
        for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
            const NeighborLists lists = listsOf(ParticleView::fromArray(place, count), 0.1, encoding);
            EXPECT_EQ(lists.size(), count);
            EXPECT_EQ(lists.pairCount(), 0u);
            EXPECT_EQ(lists.statistics().mean, 0);
            EXPECT_EQ(lists.statistics().min, 0u);
            EXPECT_EQ(lists.statistics().max, 0u);
            EXPECT_EQ(lists.statistics().isolated, count);
            EXPECT_EQ(lists.toCsr().offsets, std::vector<std::uint64_t>(count + 1, 0));
            EXPECT_EQ(lists.checksum(), 0u);
            EXPECT_EQ(decoded(lists), Lists(count));
        }
    }
}

TEST(NeighborLists, CountsAloneCannotBeReadAsLists)
{
    const double place[6] = {1, -2, 3, 1, -2, 3};
    expectUnreadable(listsOf(ParticleView::fromArray(place, 2), 0.1, Encoding::kNone));
    const NeighborLists masks = listsOf(ParticleView::fromArray(place, 2), 0.1, Encoding::kMask);
    EXPECT_THROW(masks.indices(0), InvalidInput);
    const NeighborLists nothing;
    EXPECT_EQ(nothing.size(), 0u);
    EXPECT_EQ(nothing.pairCount(), 0u);
    EXPECT_EQ(nothing.encoding(), Encoding::kNone);
    EXPECT_EQ(nothing.counts().size(), 0u);
}

// Particles of a lattice of n^3 whose squared distance in lattice steps is at most `limit`, counted one by one.
std::uint32_t latticeCount(int n, int x, int y, int z, int limit)
{
    std::uint32_t count = 0;
    for (int dx = -4; dx <= 4; ++dx) {
        for (int dy = -4; dy <= 4; ++dy) {
            for (int dz = -4; dz <= 4; ++dz) {
                const auto inside = [n](int v) { return v >= 0 && v < n; };
                count += inside(x + dx) && inside(y + dy) && inside(z + dz) &&
                         dx * dx + dy * dy + dz * dz <= limit;
            }
        }
    }
    return count - 1; // itself
}

TEST(NeighborLists, ALargeLatticeHasTheCountsOfArithmetic)
{
    constexpr int kEdge = 40;
    std::vector<float> xyz;
    for (int i = 0; i < kEdge * kEdge * kEdge; ++i) {
        // A coordinate far enough out that the lattice spans several nodes, and still exact.
        for (const int v : {i / kEdge / kEdge, i / kEdge % kEdge, i % kEdge})
            xyz.push_back(0.25f * v - 20.0f);
    }
    const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    for (int steps = 1; steps <= 3; ++steps) {
        std::vector<std::uint32_t> expected;
        for (int i = 0; i < kEdge * kEdge * kEdge; ++i) {
            expected.push_back(
                latticeCount(kEdge, i / kEdge / kEdge, i / kEdge % kEdge, i % kEdge, steps * steps));
        }
        const double radius = 0.25 * steps;
        const NeighborLists index = listsOf(view, radius, Encoding::kIndex, steps);
        const NeighborLists mask = listsOf(view, radius, Encoding::kMask, 4 - steps);
        EXPECT_EQ(index.counts(), expected);
        EXPECT_EQ(mask.counts(), expected);
        EXPECT_EQ(countNeighbors(view, radius), expected);
        EXPECT_EQ(index.pairCount(), std::accumulate(expected.begin(), expected.end(), std::uint64_t(0)));
        EXPECT_EQ(index.checksum(), mask.checksum());
        EXPECT_EQ(index.toCsr().indices, mask.toCsr().indices);
    }
}

// A ball in which all are neighbors, crowded enough that its cells and leaves are searched in several pieces, and others
// around.
TEST(NeighborLists, CrowdedCellsAreSearchedInPieces)
{
    constexpr std::uint32_t kCrowd = 5000;
    std::mt19937_64 bits(2);
    PointSet set{"crowd", 1, {}, kIdentity};
    for (std::uint32_t i = 0; i < kCrowd + 500; ++i) {
        ExactPoint point;
        for (double& x : point.offset) {
            x = static_cast<double>(bits() >> 11) * 0x1p-53 * (i < kCrowd ? 0.25 : 40) + 1.3;
            if (i < kCrowd && i % 2) x = 1.4;
        }
        if (i >= kCrowd) point.offset[0] += 5;
        set.points.push_back(point);
    }
    const SetView input(set, Form::kDoubles);
    for (const int threads : {1, 4}) {
        runOnThreads(threads, [&] {
            const NeighborLists index = listsOf(input.view(), set.radius, Encoding::kIndex);
            const NeighborLists mask = listsOf(input.view(), set.radius, Encoding::kMask);
            EXPECT_EQ(mask.checksum(), index.checksum());
            std::vector<std::uint32_t> everyone(kCrowd), row;
            std::iota(everyone.begin(), everyone.end(), 0u);
            for (std::uint32_t i = 0; i < set.points.size(); i += i < kCrowd ? 61 : 1) {
                mask.neighbors(i, row);
                const Span<const std::uint32_t> numbers = index.indices(i);
                ASSERT_TRUE(std::equal(row.begin(), row.end(), numbers.begin(), numbers.end())) << i;
                if (i >= kCrowd) continue;
                row.push_back(i);
                std::sort(row.begin(), row.end());
                ASSERT_EQ(row, everyone) << i;
            }
        });
    }
}

TEST(NeighborLists, HandlesShareTheListsAndOutliveTheEngine)
{
    const PointSet set = arraySets(Precision::kDouble)[5];
    const SetView input(set, Form::kDoubles);
    NeighborLists copy;
    {
        SearchEngine engine;
        const NeighborLists lists = engine.findNeighbors(input.view(), set.radius);
        copy = lists;
        EXPECT_EQ(copy.indices(3).data(), lists.indices(3).data());
    }
    EXPECT_TRUE(sameLists(copy, oracleLists(set), set));
}

TEST(NeighborLists, MasksMayBeReadFromSeveralThreads)
{
    const PointSet set = arraySets(Precision::kDouble)[5];
    const SetView input(set, Form::kDoubles);
    const Lists expected = decoded(listsOf(input.view(), set.radius, Encoding::kIndex));
    const NeighborLists mask = listsOf(input.view(), set.radius, Encoding::kMask);
    std::vector<Lists> read(4);
    std::vector<std::thread> threads;
    for (Lists& rows : read) threads.emplace_back([&] { rows = decoded(mask); });
    for (std::thread& thread : threads) thread.join();
    for (const Lists& rows : read) EXPECT_EQ(rows, expected);
}

TEST(NeighborLists, BytesAreThoseOfTheRowsAndALittleMore)
{
    std::mt19937_64 bits(4);
    std::vector<float> xyz;
    for (int i = 0; i < 90000; ++i) xyz.push_back(static_cast<float>(bits() >> 40) * 0x1p-24f * 30);
    const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const std::uint64_t n = view.size();
    const NeighborLists index = listsOf(view, 2, Encoding::kIndex);
    EXPECT_GE(index.bytes(), 4 * index.pairCount());
    EXPECT_LE(index.bytes(), 4 * index.pairCount() + 32 * n);
    for (int reach = 1; reach <= 3; ++reach) {
        const NeighborLists mask = listsOf(view, 2, Encoding::kMask, reach);
        const std::uint64_t bitBytes = countCandidateTests(mask.grid()) / 8;
        EXPECT_GE(mask.bytes(), bitBytes);
        EXPECT_LE(mask.bytes(), bitBytes + 32 * n);
        EXPECT_LT(mask.bytes(), index.bytes());
    }
    EXPECT_LE(listsOf(view, 2, Encoding::kNone).bytes(), 16 * n);
}

} // namespace

} // namespace vdb_nns::testing
