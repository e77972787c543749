// The sparse grid: which leaves and cells there are and in which order, that every finite particle is in it once, in its
// cell, and what coordinates that it cannot hold get.
#include "agreement/point_views.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <random>
#include <set>
#include <string>
#include <tbb/task_arena.h>

namespace vdb_nns::testing {

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

SparseGrid gridOf(const ParticleView& view, double radius, int reach = 1)
{
    SearchOptions options;
    options.cellSize = 1.0 / reach;
    return SearchEngine().buildGrid(view, radius, options);
}

std::uint64_t mortonOf(const Vec3i& leaf)
{
    std::uint64_t code = 0;
    for (int bit = 8; bit >= 0; --bit) {
        for (const std::int32_t x : leaf) code = code << 1 | (static_cast<std::uint32_t>(x) >> bit & 1);
    }
    return code;
}

// Nodes of 4096^3 cells stand together, leaves in Morton order inside each; slots and cells are counted through.
void expectLeavesInOrder(const SparseGrid& grid)
{
    std::set<Vec3i> nodes;
    std::uint64_t slot = 0, cell = 0, lastCode = 0;
    Vec3i lastNode{};
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        const SparseGrid::Leaf leaf = grid.leaf(l);
        Vec3i number, node;
        for (std::size_t k = 0; k < 3; ++k) {
            ASSERT_EQ(leaf.origin[k] & 7, 0);
            number[k] = leaf.origin[k] >> 3;
            node[k] = leaf.origin[k] >> 12;
        }
        if (l > 0 && node == lastNode) {
            EXPECT_LT(lastCode, mortonOf(number));
        } else {
            EXPECT_TRUE(nodes.insert(node).second) << "a node in two places";
        }
        lastNode = node;
        lastCode = mortonOf(number);
        EXPECT_EQ(leaf.firstSlot, slot);
        EXPECT_EQ(leaf.firstCell, cell);
        EXPECT_GT(leaf.particleCount, 0u);
        slot += leaf.particleCount;
        for (const std::uint64_t word : leaf.occupancy)
            cell += static_cast<std::uint64_t>(__builtin_popcountll(word));
    }
    EXPECT_EQ(slot, grid.particleCount());
    EXPECT_EQ(cell, grid.cellCount());
}

// Cells in linear order, numbers ascending inside each, and the occupancy is that of the particles.
void expectCellsInOrder(const SparseGrid& grid)
{
    const std::vector<Vec3i> cells = cellsOf(grid);
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        const SparseGrid::Leaf leaf = grid.leaf(l);
        std::uint64_t occupancy[8] = {};
        std::pair<int, std::uint32_t> last{-1, 0};
        for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
            int in[3];
            for (std::size_t k = 0; k < 3; ++k) in[k] = cells[numbers[s]][k] - leaf.origin[k];
            const std::pair<int, std::uint32_t> place{(in[0] * 8 + in[1]) * 8 + in[2], numbers[s]};
            EXPECT_LT(last, place);
            last = place;
            occupancy[in[0]] |= std::uint64_t(1) << (in[1] * 8 + in[2]);
        }
        for (int w = 0; w < 8; ++w) EXPECT_EQ(leaf.occupancy[w], occupancy[w]);
    }
}

void expectEachParticleOnce(const SparseGrid& grid, const PointSet& set)
{
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    std::vector<int> times(set.points.size());
    for (const std::uint32_t number : numbers) ++times.at(number);
    std::uint64_t finite = 0;
    for (std::size_t i = 0; i < times.size(); ++i) {
        EXPECT_EQ(times[i], isFinite(set.points[i]) ? 1 : 0) << i;
        finite += isFinite(set.points[i]);
    }
    EXPECT_EQ(grid.particleCount(), finite);
    EXPECT_EQ(grid.nonfiniteCount(), set.points.size() - finite);
}

void expectSound(const SparseGrid& grid, const PointSet& set, int reach)
{
    SCOPED_TRACE(set.name + ", reach " + std::to_string(reach));
    EXPECT_EQ(grid.radius(), set.radius);
    EXPECT_EQ(grid.reach(), reach);
    EXPECT_GT(grid.cellSize(), set.radius / reach);
    EXPECT_LT(grid.cellSize(), set.radius / reach * 1.0001);
    expectLeavesInOrder(grid);
    expectCellsInOrder(grid);
    expectEachParticleOnce(grid, set);
}

// For arrays about the origin: a particle lies in its cell, but for rounding.
void expectParticlesInTheirCells(const SparseGrid& grid, const PointSet& set)
{
    const std::vector<Vec3i> cells = cellsOf(grid);
    for (std::size_t i = 0; i < set.points.size(); ++i) {
        if (!isFinite(set.points[i])) continue;
        for (std::size_t k = 0; k < 3; ++k) {
            const double inCells = set.points[i].offset[k] / grid.cellSize() - cells[i][k];
            EXPECT_GT(inCells, -1e-5) << set.name << " " << i;
            EXPECT_LT(inCells, 1 + 1e-5) << set.name << " " << i;
        }
    }
}

TEST(SparseGrid, ArraysAreSortedByLeafCellAndNumber)
{
    for (const PointSet& set : arraySets(Precision::kDouble)) {
        const SetView input(set, Form::kDoubles);
        for (int reach = 1; reach <= 3; ++reach) {
            const SparseGrid grid = gridOf(input.view(), set.radius, reach);
            expectSound(grid, set, reach);
            expectParticlesInTheirCells(grid, set);
        }
    }
}

TEST(SparseGrid, VoxelsAreSortedByLeafCellAndNumber)
{
    for (const PointSet& set : gridSets()) {
        const SetView input(set, Form::kVoxels);
        for (int reach = 1; reach <= 3; ++reach)
            expectSound(gridOf(input.view(), set.radius, reach), set, reach);
    }
}

// 150,000 particles, so that several chunks of the input meet in most leaves.
PointSet largeSet()
{
    PointSet set{"large", 1, {}, kIdentity};
    std::mt19937_64 bits(9);
    for (int i = 0; i < 150000; ++i) {
        ExactPoint point;
        for (double& x : point.offset) x = static_cast<double>(bits() >> 40) * 0x1p-24 * 60 - 20;
        if (i % 1000 == 0) point.offset[1] = kInf;
        set.points.push_back(point);
    }
    return set;
}

TEST(SparseGrid, IsTheSameForAnyNumberOfThreads)
{
    const PointSet set = largeSet();
    const SetView input(set, Form::kFloats);
    SparseGrid first;
    for (const int threads : {1, 2, 4}) {
        SparseGrid grid;
        runOnThreads(threads, [&] { grid = gridOf(input.view(), set.radius, 2); });
        if (threads == 1) {
            first = grid;
            expectSound(grid, set, 2);
            continue;
        }
        ASSERT_EQ(grid.leafCount(), first.leafCount());
        EXPECT_EQ(grid.cellCount(), first.cellCount());
        for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
            const SparseGrid::Leaf a = grid.leaf(l), b = first.leaf(l);
            EXPECT_EQ(a.origin, b.origin);
            EXPECT_EQ(a.firstSlot, b.firstSlot);
            EXPECT_TRUE(std::equal(a.occupancy, a.occupancy + 8, b.occupancy));
        }
        const auto a = grid.particleNumbers(), b = first.particleNumbers();
        EXPECT_TRUE(std::equal(a.begin(), a.end(), b.begin(), b.end()));
    }
}

TEST(SparseGrid, BytesAreThoseOfTheParticlesAndALittleMore)
{
    const PointSet set = largeSet();
    const SetView input(set, Form::kFloats);
    const SparseGrid grid = gridOf(input.view(), set.radius);
    const std::uint64_t own = 16 * grid.particleCount() + 4 * grid.cellCount();
    EXPECT_GE(grid.bytes(), own);
    EXPECT_LE(grid.bytes(), own + 40 * grid.particleCount());
}

TEST(SparseGrid, NothingMakesAnEmptyGrid)
{
    const double nowhere[6] = {kInf, 0, 0, 0, std::nan(""), -kInf};
    for (const ParticleView& view : {ParticleView(), ParticleView::fromArray(nowhere, 2)}) {
        const SparseGrid grid = gridOf(view, 0.5);
        EXPECT_TRUE(grid.empty());
        EXPECT_EQ(grid.leafCount(), 0u);
        EXPECT_EQ(grid.cellCount(), 0u);
        EXPECT_EQ(grid.nonfiniteCount(), view.size());
        EXPECT_EQ(grid.particleNumbers().size(), 0u);
        EXPECT_EQ(countCandidateTests(grid), 0u);
    }
    EXPECT_TRUE(SparseGrid().empty());
}

TEST(SparseGrid, NonFiniteParticlesFailWhereAskedTo)
{
    const PointSet set = largeSet();
    const SetView input(set, Form::kFloats);
    SearchOptions options;
    options.nonfinite = NonFinite::kFail;
    try {
        SearchEngine().buildGrid(input.view(), set.radius, options);
        FAIL() << "150 infinite particles were accepted";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("150 of 150000"), std::string::npos) << error.what();
    }
    const double fine[3] = {1, 2, 3};
    EXPECT_EQ(SearchEngine().buildGrid(ParticleView::fromArray(fine, 1), 1, options).particleCount(), 1u);
}

// The radius that the message of the error tells to use; 0 where there is none.
double toldRadius(const ParticleView& view, double radius, int reach)
{
    try {
        gridOf(view, radius, reach);
        ADD_FAILURE() << "no error with radius " << radius;
    } catch (const InputError& error) {
        const std::string text = error.what(), before = "a radius of at least ";
        const std::size_t at = text.find(before);
        if (at != std::string::npos) return std::strtod(text.c_str() + at + before.size(), nullptr);
        ADD_FAILURE() << text;
    }
    return 0;
}

// What the error of a grid says; empty where there is none.
std::string errorOf(const ParticleView& view, double radius, int reach)
{
    try {
        EXPECT_EQ(gridOf(view, radius, reach).particleCount(), view.size());
    } catch (const InputError& error) {
        return error.what();
    }
    return "";
}

// The radius in the message works, and is not far from the smallest that does.
void expectToldRadiusWorks(const ParticleView& view, double radius, int reach)
{
    SCOPED_TRACE("radius " + std::to_string(radius) + ", reach " + std::to_string(reach));
    const double told = toldRadius(view, radius, reach);
    ASSERT_GT(told, radius);
    ASSERT_TRUE(std::isfinite(told));
    EXPECT_EQ(errorOf(view, told, reach), "");
    EXPECT_THROW(gridOf(view, told * 0.98, reach), InputError);
}

TEST(SparseGrid, CoordinatesPastTheLimitTellTheSmallestRadius)
{
    const double line[9] = {-1e10, 0, 0, 0, 5, 0, 1e10, 1, 1};
    for (int reach = 1; reach <= 3; ++reach) {
        for (const double radius : {1.0, 0.01, 1e-9, 1e-100}) {
            expectToldRadiusWorks(ParticleView::fromArray(line, 3), radius, reach);
        }
    }
    // Where the limit is passed on one side only, cells are counted from the middle first.
    const double oneSide[6] = {0, 0, 0, 3e9, 0, 0};
    EXPECT_EQ(gridOf(ParticleView::fromArray(oneSide, 2), 1).particleCount(), 2u);
    expectToldRadiusWorks(ParticleView::fromArray(oneSide, 2), 0.5, 1);
}

TEST(SparseGrid, TheSmallestRadiusIsToldForExtremeNumbersToo)
{
    const double unit[6] = {-1, 0, 0, 1, 0, 0};
    expectToldRadiusWorks(ParticleView::fromArray(unit, 2), 1e-291, 1);
    expectToldRadiusWorks(ParticleView::fromArray(unit, 2), 5e-324, 2);
    const double wide[6] = {-1e300, 0, 0, 1e300, 0, 0};
    expectToldRadiusWorks(ParticleView::fromArray(wide, 2), 1, 1);
    expectToldRadiusWorks(ParticleView::fromArray(wide, 2), 1e-20, 3);
}

TEST(SparseGrid, VoxelsPastTheLimitTellTheSmallestRadius)
{
    for (const NamedLinear& map : linearMaps()) {
        SCOPED_TRACE(map.name);
        PointSet set{
            "outlier", 1, {{{0, 0, 0}, {0.1, 0, 0}}, {{2000000000, -7, 5}, {0, 0.2, 0}}}, map.linear};
        const SetView input(set, Form::kVoxels);
        expectToldRadiusWorks(input.view(), 0.0001, 1);
    }
}

TEST(SparseGrid, AMatrixThatLosesTheCellsTellsARadiusThatWorks)
{
    // Nearly singular: computing a cell coordinate loses seven digits.
    PointSet set{"thin",
                 1,
                 {{{-30000, 0, 0}, {0, 0, 0}}, {{30000, -7, 5}, {0, 0.25, 0}}},
                 {{{1, 1, 0}, {1, 1 + 0x1p-24, 0}, {0, 0, 1}}}};
    const SetView input(set, Form::kVoxels);
    const double told = toldRadius(input.view(), 0.001, 1);
    ASSERT_GT(told, 0.001);
    EXPECT_EQ(errorOf(input.view(), told, 1), "");
}

TEST(SparseGrid, FarArraysAreCountedFromTheirMiddle)
{
    PointSet set{"very far", 2, {}, kIdentity};
    for (int x = 0; x < 6; ++x) {
        for (int y = 0; y < 6; ++y) {
            for (int z = 0; z < 6; ++z) set.points.push_back({{0, 0, 0}, {1e15 + x, -1e15 + y, 3e14 + z}});
        }
    }
    const SetView input(set, Form::kStridedDoubles);
    const Lists oracle = oracleLists(set);
    for (int reach = 1; reach <= 3; ++reach) {
        SearchOptions options;
        options.cellSize = 1.0 / reach;
        const NeighborLists lists = findNeighbors(input.view(), set.radius, options);
        expectSound(lists.grid(), set, reach);
        EXPECT_TRUE(sameLists(lists, oracle, set));
    }
}

TEST(SparseGrid, CandidateTestsAreThePairsOfCellsInReach)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 5)) {
        const SetView input(set, Form::kDoubles);
        for (int reach = 1; reach <= 3; ++reach) {
            const SparseGrid grid = gridOf(input.view(), set.radius, reach);
            const std::vector<Vec3i> cells = cellsOf(grid);
            std::uint64_t tests = 0;
            for (const std::uint32_t i : grid.particleNumbers()) {
                for (const std::uint32_t j : grid.particleNumbers()) {
                    bool near = true;
                    for (std::size_t k = 0; k < 3; ++k) near &= std::abs(cells[i][k] - cells[j][k]) <= reach;
                    tests += near;
                }
            }
            EXPECT_EQ(countCandidateTests(grid), tests) << set.name;
        }
    }
}

TEST(SparseGrid, CellsAreAsWideAsAskedFor)
{
    struct Case {
        double asked, size;
        int reach;
    };
    for (const Case& c :
         {Case{0.33, 1.0 / 3, 3}, Case{0.333, 1.0 / 3, 3}, Case{0.4, 0.4, 3}, Case{0.5, 0.5, 2},
          Case{0.7, 0.7, 2}, Case{0.995, 1, 1}, Case{1, 1, 1}, Case{1.5, 1.5, 1}, Case{4, 4, 1}}) {
        SearchOptions options;
        options.cellSize = c.asked;
        const std::vector<double> one = {0.25, 0.5, 0.75};
        const SparseGrid grid =
            SearchEngine().buildGrid(ParticleView::fromArray(one.data(), 1), 0.1, options);
        EXPECT_EQ(grid.reach(), c.reach) << c.asked;
        EXPECT_NEAR(grid.cellSize() / 0.1, c.size, 1e-4) << c.asked;
        EXPECT_GE(grid.cellSize() / 0.1, c.size) << c.asked;
    }
    for (const double asked : {-1.0, 0.2, 4.1, kInf, std::numeric_limits<double>::quiet_NaN()}) {
        SearchOptions options;
        options.cellSize = asked;
        EXPECT_THROW(SearchEngine().buildGrid(ParticleView(), 0.1, options), InvalidInput) << asked;
    }
}

std::vector<double> shuffledTriples(std::vector<double> xyz, std::uint32_t seed)
{
    std::mt19937 random(seed);
    for (std::size_t i = xyz.size() / 3 - 1; i > 0; --i) {
        const std::size_t j = random() % (i + 1);
        for (std::size_t k = 0; k < 3; ++k) std::swap(xyz[3 * i + k], xyz[3 * j + k]);
    }
    return xyz;
}

TEST(SparseGrid, CellsFollowTheDensity)
{
    struct Case {
        const char* scene;
        double radiusFactor, size;
    };
    for (const Case& c :
         {Case{"block", 2, 1}, Case{"block", 1.4, 1.5}, Case{"block", 1, 2}, Case{"block", 0.1, 3},
          Case{"block", 6, 0.5}, Case{"sheet", 2, 2}, Case{"spray", 2, 3}, Case{"clusters", 2, 3}}) {
        SceneOptions sceneOptions;
        sceneOptions.name = c.scene;
        sceneOptions.count = 60000;
        if (std::string(c.scene) == "block") sceneOptions.radiusFactor = c.radiusFactor;
        const Scene scene = makeScene(sceneOptions);
        const std::size_t count = scene.positions.size() / 3;
        SearchOptions options;
        const auto sizeOf = [&](const std::vector<double>& xyz) {
            const ParticleView view = ParticleView::fromArray(xyz.data(), count);
            return SearchEngine().buildGrid(view, scene.suggestedRadius, options).cellSize() /
                   scene.suggestedRadius;
        };
        SCOPED_TRACE(std::string(c.scene) + " " + std::to_string(c.radiusFactor));
        const double size = sizeOf(scene.positions);
        EXPECT_NEAR(size, c.size, 1e-3);
        EXPECT_EQ(sizeOf(shuffledTriples(scene.positions, 3)), size); // whatever the order
        tbb::task_arena(1).execute([&] { EXPECT_EQ(sizeOf(scene.positions), size); });
        options.simd = SimdLevel::kScalar;
        EXPECT_EQ(sizeOf(scene.positions), size);
        options.simd = SimdLevel::kBest;
        options.hostMemoryBytes = std::uint64_t(1) << 30; // wide cells make large masks
        EXPECT_NEAR(sizeOf(scene.positions), std::min(c.size, 1.0), 1e-3);
        options.hostMemoryBytes = 0;
        options.wideCells = false;
        EXPECT_NEAR(sizeOf(scene.positions), std::min(c.size, 1.0), 1e-3);
    }
}

// A small crowd does not decide for all, wherever it is: the cube at the origin is drawn no more often than others.
TEST(SparseGrid, ACrowdAtTheOriginIsOneOfMany)
{
    constexpr std::size_t kCount = 200000, kCrowd = 4000;
    std::mt19937 random(7);
    std::uniform_real_distribution<float> anywhere(-37, 37), inCube(0, 6);
    std::vector<float> xyz(3 * kCount);
    for (std::size_t i = 0; i < 3 * kCount; ++i) xyz[i] = i < 3 * kCrowd ? inCube(random) : anywhere(random);
    for (int move = 0; move < 5; ++move) { // by whole cubes
        const SparseGrid grid = SearchEngine().buildGrid(ParticleView::fromArray(xyz.data(), kCount), 1.0);
        EXPECT_GT(grid.cellSize(), 1.9) << move;
        for (float& x : xyz) x += 60.0f;
    }
}

// Most particles at one place, the others alone. Where the sample draws the cube of the crowd it stops: cells of the radius.
TEST(SparseGrid, ACrowdAmongLoneParticlesEndsTheSample)
{
    constexpr std::size_t kCount = 400000;
    std::vector<float> xyz;
    for (std::size_t i = 0; i < kCount; ++i) {
        for (std::size_t k : {i % 97, i / 97 % 89, i / 97 / 89})
            xyz.push_back(i % 4 == 0 ? 9.0f * static_cast<float>(k) : 0.5f);
    }
    int drawn = 0, missed = 0;
    for (int move = 0; move < 40; ++move) { // by whole cubes, which draws others
        for (float& x : xyz) x += 6.0f;
        const ParticleView view = ParticleView::fromArray(xyz.data(), kCount);
        const double size = SearchEngine().buildGrid(view, 1.0).cellSize();
        drawn += size < 1.01;
        missed += size > 2.99;
    }
    EXPECT_GT(drawn, 0);
    EXPECT_GT(missed, drawn);
    EXPECT_EQ(drawn + missed, 40);
}

} // namespace

} // namespace vdb_nns::testing
