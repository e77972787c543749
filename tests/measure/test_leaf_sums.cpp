// Measures that see the pairs of a leaf once have the bytes of those that are made row by row. Asking for normals too makes all of them
// row by row. Leaves are whole tasks if they hold no more than 1024 particles, or a sixteenth of all on one thread.
#include "../support/distributions.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <tbb/task_arena.h>

#include <cmath>
#include <cstdint>
#include <map>
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

std::vector<Cloud> clouds()
{
    std::vector<Cloud> all = {sceneCloud("block", 80000), sceneCloud("clusters", 80000),
                              sceneCloud("spray", 80000), lattice()};
    // More neighbors than sums at one scale have bits for, in some leaf or other.
    Cloud crowd = cube("crowd", 80000);
    std::mt19937 random(3);
    std::normal_distribution<> near(0.4, 0.05 * crowd.radius);
    for (int k = 0; k < 3 * 4500; ++k) crowd.positions.push_back(near(random));
    all.push_back(crowd);
    // Distances that are zero, and others of a leaf that are not; some that are tiny.
    Cloud close = cube("close", 5000);
    for (int k = 0; k < 3 * 40; ++k) close.positions.push_back(0.6);
    for (int k = 0; k < 3 * 40; ++k) close.positions.push_back(0.3 + 1e-9 * near(random));
    all.push_back(close);
    Cloud holes = cube("not finite", 8000);
    for (std::size_t k = 0; k < holes.positions.size(); k += 101) holes.positions[k] = std::nan("");
    all.push_back(holes);
    return all;
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

void expectSameBytes(const ParticleView& view, double radius, const MeasureOptions& options,
                     const std::string& what)
{
    tbb::task_arena arena(1);
    SearchEngine engine;
    const SearchSets sets = engine.buildGrid(view, radius, options.search);
    for (std::vector<std::string> names : kSelections) {
        const Measured once = arena.execute([&] { return engine.measure(sets, names, options); });
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
}

TEST(LeafSums, HaveTheBytesOfRows)
{
    for (const Cloud& cloud : clouds()) {
        expectSameBytes(cloud.view(), cloud.radius, {}, cloud.name);
        const std::vector<float> floats(cloud.positions.begin(), cloud.positions.end());
        expectSameBytes(ParticleView::fromArray(floats.data(), cloud.size()), cloud.radius, {},
                        cloud.name + " as floats");
    }
}

TEST(LeafSums, HaveTheBytesOfRowsForAllKernelsCellsAndInstructionSets)
{
    const Cloud cloud = cube("cube", 6000);
    for (const SimdLevel simd :
         {SimdLevel::kScalar, SimdLevel::kSse4, SimdLevel::kAvx2, SimdLevel::kAvx512}) {
        if (simd > bestSimdLevel()) continue;
        for (const double cell : {0.0, 0.34, 0.5, 1.0, 2.0}) {
            MeasureOptions options;
            options.search.simd = simd;
            options.search.cellSize = cell;
            options.kernel = static_cast<SmoothingKernel>(static_cast<int>(10 * cell) % 4);
            expectSameBytes(cloud.view(), cloud.radius, options,
                            std::string(simdLevelName(simd)) + ", cells of " + std::to_string(cell));
        }
    }
    for (const SmoothingKernel kernel : {SmoothingKernel::kCubic, SmoothingKernel::kWendland2,
                                         SmoothingKernel::kPoly6, SmoothingKernel::kTophat}) {
        MeasureOptions options;
        options.kernel = kernel;
        options.mass = 0.3;
        expectSameBytes(cloud.view(), cloud.radius, options,
                        "kernel " + std::to_string(static_cast<int>(kernel)));
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
        return bytesByName(SearchEngine().measure(SearchEngine().buildGrid(cloud.view(), cloud.radius),
                                                  kSelections.back(), {}));
    };
    const std::map<std::string, std::string> expected = bytes();
    for (const int threads : {1, 2}) {
        tbb::task_arena arena(threads);
        EXPECT_TRUE(arena.execute(bytes) == expected) << threads;
    }
}

} // namespace
} // namespace vdb_nns::testing
