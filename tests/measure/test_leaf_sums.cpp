// Measures that see the pairs of a leaf once have the bytes of those that are made row by row. Asking for normals too makes all of them
// row by row. Whether a leaf's pairs are seen once depends on how many particles it has, so each cloud is asked for it.
#include "../agreement/point_views.h"
#include "../support/distributions.h"
#include "search/engine_state.h"
#include "search/visit_tasks.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <tbb/task_arena.h>

#include <cmath>
#include <cstdint>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

namespace vdb_nns::testing {
namespace {

struct Cloud {
    std::string name;
    std::vector<double> positions;
    double radius;

    std::size_t size() const { return positions.size() / 3; }
    ParticleView view() const { return ParticleView::fromArray(positions.data(), size()); }
};

Cloud sceneCloud(const char* name, std::size_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    Scene scene = makeScene(options);
    return {name, std::move(scene.positions), scene.suggestedRadius};
}

// Random points of a cube with seven neighbors each.
Cloud cube(const std::string& name, std::size_t count)
{
    Cloud cloud{name, {}, 1.2 / std::cbrt(double(count))};
    std::mt19937 random(7);
    std::uniform_real_distribution<> place(0, 1);
    for (std::size_t k = 0; k < 3 * count; ++k) cloud.positions.push_back(place(random));
    return cloud;
}

// Every pair of next but one neighbors is as far apart as the radius.
Cloud lattice()
{
    Cloud cloud{"lattice", {}, 2};
    constexpr int kSide = 42;
    for (int n = 0; n < kSide * kSide * kSide; ++n)
        cloud.positions.insert(cloud.positions.end(),
                               {double(n / (kSide * kSide)), double(n / kSide % kSide), double(n % kSide)});
    return cloud;
}

// More neighbors than sums at one scale have bits for, in a leaf of a cube.
Cloud crowd()
{
    Cloud cloud = cube("crowd", 160000);
    std::mt19937 random(3);
    std::normal_distribution<> near(0.4, 0.05 * cloud.radius);
    for (int k = 0; k < 3 * 4500; ++k) cloud.positions.push_back(near(random));
    return cloud;
}

// In a hole of a cube, points whose distances are all tiny.
Cloud close()
{
    Cloud cloud{"close", {}, 0};
    const Cloud points = cube("", 8000);
    cloud.radius = points.radius;
    const double center = 0.3;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const double* const p = &points.positions[3 * i];
        const double distance = std::hypot(p[0] - center, p[1] - center, p[2] - center);
        if (distance > 1.5 * cloud.radius) cloud.positions.insert(cloud.positions.end(), p, p + 3);
    }
    std::mt19937 random(3);
    std::normal_distribution<> near(center, 1e-9 * cloud.radius);
    for (int k = 0; k < 3 * 40; ++k) cloud.positions.push_back(near(random));
    return cloud;
}

Cloud withNans()
{
    Cloud cloud = cube("not finite", 20000);
    for (std::size_t k = 0; k < cloud.positions.size(); k += 101) cloud.positions[k] = std::nan("");
    return cloud;
}

// Voxels of 0.5, 0.4 and 0.6, sheared or not, of about one point each.
PointSet voxels(bool areSheared)
{
    PointSet set;
    set.name = areSheared ? "sheared voxels" : "voxels";
    set.radius = 0.6;
    set.linear = {{{0.5, areSheared ? 0.1 : 0, 0}, {0, 0.4, 0}, {areSheared ? 0.05 : 0, 0, 0.6}}};
    std::mt19937 random(11);
    std::uniform_real_distribution<> offset(-0.5, 0.5);
    for (int i = 0; i < 20000; ++i) {
        ExactPoint point{};
        for (int k = 0; k < 3; ++k) {
            point.voxel[k] = static_cast<std::int64_t>(random() % 27) - 13;
            point.offset[k] = roundedToFloat(offset(random));
        }
        set.points.push_back(point);
    }
    return set;
}

std::map<std::string, std::string> bytesByName(const Measured& measured)
{
    std::map<std::string, std::string> bytes;
    for (const PointAttribute& a : measured.values.attributes)
        bytes[a.name].assign(static_cast<const char*>(a.values.get()), a.count * attributeBytes(a.type));
    return bytes;
}

const std::vector<std::vector<std::string>> kSelections = {{"density"},
                                                           {"count", "mean_distance", "nearest_distance"},
                                                           {"nearest_distance", "density", "count"},
                                                           {"count", "density", "mean_distance", "cluster"}};

// How many leaves the search hands out in rows that are half.
std::size_t halfLeaves(const SearchSets& sets, const SearchOptions& options)
{
    struct Callback final : RowCallback {
        std::size_t& count;
        bool isHalf = false;

        explicit Callback(std::size_t& leaves) : count(leaves) {}
        void take(const VisitedRows& rows) override { isHalf = rows.areHalf; }
        bool finish() override
        {
            count += isHalf;
            return true;
        }
    };
    EngineState engine;
    engine.beginStatistics(options);
    std::size_t count = 0;
    const SearchRuns runs(sets, options);
    runs.forEach([&](const SearchRun& run) {
        visitTasks(engine, run, RowKind::kHalf,
                   [&](const SearchRun&, const SearchTask&, ThreadState&) { return Callback(count); });
    });
    return count;
}

void expectSameBytes(const ParticleView& view, double radius, const MeasureOptions& options,
                     const std::string& what)
{
    tbb::task_arena(1).execute([&] {
        SearchEngine engine;
        const SearchSets sets = engine.buildGrid(view, radius, options.search);
        EXPECT_GT(halfLeaves(sets, options.search), 0u) << what;
        for (std::vector<std::string> names : kSelections) {
            const Measured once = engine.measure(sets, names, options);
            const std::map<std::string, std::string> bytes = bytesByName(once);
            names.push_back("normal");
            const Measured byRow = engine.measure(sets, names, options);
            std::map<std::string, std::string> expected = bytesByName(byRow);
            ASSERT_EQ(expected.erase("normal"), 1u);
            ASSERT_EQ(bytes.size(), names.size() - 1);
            for (const auto& [name, values] : expected)
                EXPECT_TRUE(bytes.at(name) == values) << what << ", " << name;
            EXPECT_EQ(once.counts.pairCount(), byRow.counts.pairCount()) << what;
        }
    });
}

MeasureOptions withCells(double size)
{
    MeasureOptions options;
    options.search.cellSize = size;
    return options;
}

TEST(LeafSums, HaveTheBytesOfRows)
{
    const Cloud all[] = {
        sceneCloud("block", 80000), sceneCloud("clusters", 80000), lattice(), withNans(), crowd(), close()};
    for (const Cloud& cloud : all) {
        expectSameBytes(cloud.view(), cloud.radius, withCells(1), cloud.name);
        const std::vector<float> floats(cloud.positions.begin(), cloud.positions.end());
        expectSameBytes(ParticleView::fromArray(floats.data(), cloud.size()), cloud.radius, withCells(1),
                        cloud.name + " as floats");
    }
    for (const bool areSheared : {false, true}) {
        const PointSet set = voxels(areSheared);
        expectSameBytes(ParticleView(std::make_shared<VoxelSource>(set)), set.radius, withCells(1), set.name);
    }
}

TEST(LeafSums, HaveTheBytesOfRowsForAllKernelsCellsAndInstructionSets)
{
    const Cloud sparse = cube("cube", 20000), dense = sceneCloud("block", 80000);
    int kernel = 0;
    for (const SimdLevel simd :
         {SimdLevel::kScalar, SimdLevel::kSse4, SimdLevel::kAvx2, SimdLevel::kAvx512}) {
        if (simd > bestSimdLevel()) continue;
        for (const double cell : {0.34, 0.5, 1.0, 1.3}) {
            const Cloud& cloud = cell < 1 ? dense : sparse;
            MeasureOptions options = withCells(cell);
            options.search.simd = simd;
            options.kernel = static_cast<SmoothingKernel>(kernel++ % 4);
            options.mass = 0.3;
            expectSameBytes(cloud.view(), cloud.radius, options,
                            std::string(simdLevelName(simd)) + ", cells of " + std::to_string(cell));
            if (cell < 1) ++kernel; // so that each instruction set has others
        }
    }
    for (int k = 0; k < 4; ++k) {
        MeasureOptions options = withCells(1);
        options.kernel = static_cast<SmoothingKernel>(k);
        expectSameBytes(sparse.view(), sparse.radius, options, "kernel " + std::to_string(k));
    }
}

// The lattice decides most pairs exactly: those inside of leaves once.
TEST(LeafSums, SeeThePairsOfALeafOnce)
{
    const Cloud cloud = lattice();
    SearchEngine engine;
    const SearchSets sets = engine.buildGrid(cloud.view(), cloud.radius);
    tbb::task_arena arena(1);
    const auto exactPairs = [&](const std::vector<std::string>& names) {
        arena.execute([&] { engine.measure(sets, names, {}); });
        return engine.statistics().exactPairs;
    };
    const std::uint64_t byRow = exactPairs({"density", "normal"}), once = exactPairs({"density"});
    EXPECT_GT(once, byRow / 2);
    EXPECT_LT(once, byRow * 3 / 4);
}

TEST(LeafSums, DoNotDependOnThreads)
{
    const Cloud cloud = sceneCloud("block", 120000);
    const auto bytes = [&] {
        SearchEngine engine;
        return bytesByName(
            engine.measure(engine.buildGrid(cloud.view(), cloud.radius), kSelections.back(), {}));
    };
    const std::map<std::string, std::string> expected = bytes();
    for (const int threads : {1, 2}) {
        tbb::task_arena arena(threads);
        EXPECT_TRUE(arena.execute(bytes) == expected) << threads;
    }
}

} // namespace
} // namespace vdb_nns::testing
