// The sample scenes: every bit fixed by name, count and seed; the same for any number of threads; the properties that
// make each scene worth having; and the parameters that are refused.
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

namespace vdb_nns {

namespace {

SceneOptions optionsOf(const std::string& name, std::uint64_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    return options;
}

// FNV-1a over the bits of the positions.
std::uint64_t hashOf(const Scene& scene)
{
    std::uint64_t hash = 0xcbf29ce484222325ULL;
    for (const double x : scene.positions) {
        std::uint64_t bits = 0;
        std::memcpy(&bits, &x, sizeof(bits));
        hash = (hash ^ bits) * 0x100000001b3ULL;
    }
    return hash;
}

struct Counts {
    double mean = 0;
    std::uint64_t max = 0, isolated = 0;
};

// Neighbors within the suggested radius, by sorting along x and looking at all that are near in x.
Counts countNeighbors(const Scene& scene)
{
    std::vector<std::array<double, 3>> points;
    for (std::size_t i = 0; i < scene.positions.size(); i += 3) {
        points.push_back({scene.positions[i], scene.positions[i + 1], scene.positions[i + 2]});
    }
    std::sort(points.begin(), points.end());
    const double r2 = scene.suggestedRadius * scene.suggestedRadius;
    std::vector<std::uint64_t> counts(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        for (std::size_t j = i + 1; j < points.size() && points[j][0] - points[i][0] <= scene.suggestedRadius;
             ++j) {
            const double dx = points[j][0] - points[i][0], dy = points[j][1] - points[i][1];
            const double dz = points[j][2] - points[i][2];
            if (dx * dx + dy * dy + dz * dz > r2) continue;
            ++counts[i];
            ++counts[j];
        }
    }
    Counts result;
    std::uint64_t pairs = 0;
    for (const std::uint64_t count : counts) {
        pairs += count;
        result.max = std::max(result.max, count);
        result.isolated += count == 0;
    }
    result.mean = static_cast<double>(pairs) / static_cast<double>(counts.size());
    return result;
}

std::array<double, 3> extentOf(const Scene& scene)
{
    std::array<double, 3> low, high;
    low.fill(std::numeric_limits<double>::max());
    high.fill(std::numeric_limits<double>::lowest());
    for (std::size_t k = 0; k < scene.positions.size(); ++k) {
        low[k % 3] = std::min(low[k % 3], scene.positions[k]);
        high[k % 3] = std::max(high[k % 3], scene.positions[k]);
    }
    return {high[0] - low[0], high[1] - low[1], high[2] - low[2]};
}

TEST(Scene, EveryBitIsFixed)
{
    const std::map<std::string, std::uint64_t> golden = {
        {"block", 0xfda3480cc831ef36ULL},       {"dam_break", 0xd6ced814c953ba2bULL},
        {"two_sources", 0xa6e14e3a83a16edcULL}, {"sheet", 0x25c946187fc0c721ULL},
        {"spray", 0xb25a135f4011adbeULL},       {"clusters", 0xba3c2ac14b859d4aULL},
        {"lattice", 0x050e76f685ba3d72ULL},     {"coincident", 0x8e87211ff8353505ULL},
        {"outlier", 0x9f5f8e67b5fbf081ULL},     {"far", 0x7efc79dbe69d10f7ULL},
        {"seam", 0x1694fa8822ef6c11ULL},
    };
    for (const SceneName& name : sceneNames()) {
        EXPECT_EQ(hashOf(makeScene(optionsOf(name.name, 5000))), golden.at(name.name)) << name.name;
    }
    EXPECT_EQ(golden.size(), sceneNames().size());
}

TEST(Scene, CountsAreExactAndPositionsFinite)
{
    for (const SceneName& name : sceneNames()) {
        for (const std::uint64_t count : {1, 2, 3, 7, 100, 1001, 27000}) {
            const Scene scene = makeScene(optionsOf(name.name, count));
            ASSERT_EQ(scene.positions.size(), 3 * count) << name.name;
            EXPECT_EQ(scene.suggestedRadius, 2 * 0.1) << name.name;
            for (const double x : scene.positions)
                ASSERT_TRUE(std::isfinite(x)) << name.name << ", " << count;
        }
    }
}

TEST(Scene, ThreadsDoNotMatter)
{
    for (const SceneName& name : sceneNames()) {
        std::vector<double> first;
        for (const std::size_t threads : {1, 3}) {
            const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
            const Scene scene = makeScene(optionsOf(name.name, 60000));
            if (first.empty()) first = scene.positions;
            EXPECT_TRUE(first == scene.positions) << name.name;
        }
    }
}

TEST(Scene, TheSeedMattersWhereThereIsChance)
{
    for (const SceneName& name : sceneNames()) {
        SceneOptions other = optionsOf(name.name, 3000);
        other.seed = 2;
        const bool same = makeScene(other).positions == makeScene(optionsOf(name.name, 3000)).positions;
        const bool noChance = std::string(name.name) == "lattice" || std::string(name.name) == "coincident";
        EXPECT_EQ(same, noChance) << name.name;
    }
}

TEST(Scene, BlockIsAJitteredLattice)
{
    const Scene scene = makeScene(optionsOf("block", 27000));
    double farthest = 0;
    for (std::size_t k = 0; k < scene.positions.size(); ++k) {
        const double inUnits = scene.positions[k] / 0.1 - 0.5;
        farthest = std::max(farthest, std::fabs(inUnits - std::floor(inUnits + 0.5)));
    }
    EXPECT_LE(farthest, 0.2 + 1e-12);
    EXPECT_GT(farthest, 0.1999);
    const Counts counts = countNeighbors(scene);
    EXPECT_NEAR(counts.mean, 28, 0.6); // 30^3 particles; 29.6 at 4 M, where fewer are at the surface
}

TEST(Scene, LatticeIsExact)
{
    for (const double spacing : {0.1, 0.125}) {
        SceneOptions options = optionsOf("lattice", 1000);
        options.spacing = spacing;
        const Scene scene = makeScene(options);
        EXPECT_EQ(scene.voxelSize, spacing);
        EXPECT_EQ(scene.suggestedRadius, 2 * spacing);
        for (std::size_t i = 0; i < 1000; ++i) {
            EXPECT_EQ(scene.positions[3 * i], static_cast<double>(i / 100) * spacing);
            EXPECT_EQ(scene.positions[3 * i + 2], static_cast<double>(i % 10) * spacing);
        }
    }
}

TEST(Scene, SprayIsSparse)
{
    const Scene scene = makeScene(optionsOf("spray", 40000));
    for (const double edge : extentOf(scene)) EXPECT_GT(edge / scene.suggestedRadius, 1000);
    const Counts counts = countNeighbors(scene);
    EXPECT_NEAR(counts.mean, 20.6, 3);
    EXPECT_GT(counts.max, 55U);
    EXPECT_LT(counts.max, 91U);
    EXPECT_GT(counts.isolated, 2000U);
}

TEST(Scene, ClustersGoFromNoneToMany)
{
    const Counts counts = countNeighbors(makeScene(optionsOf("clusters", 40000)));
    EXPECT_GT(counts.isolated, 2000U);
    EXPECT_GT(counts.max, 900U); // 4500 at 2 M: the largest of more clusters
    EXPECT_NEAR(counts.mean, 51, 15);
}

TEST(Scene, FluidScenesHaveTheirDensity)
{
    EXPECT_NEAR(countNeighbors(makeScene(optionsOf("dam_break", 40000))).mean, 26, 2);
    EXPECT_NEAR(countNeighbors(makeScene(optionsOf("two_sources", 40000))).mean, 29.5, 2);
    EXPECT_NEAR(countNeighbors(makeScene(optionsOf("sheet", 40000))).mean, 18, 2);
}

TEST(Scene, ParametersOfTheHardScenes)
{
    SceneOptions outlier = optionsOf("outlier", 1000);
    outlier.distance = 1e3;
    const Scene lone = makeScene(outlier);
    const double* last = lone.positions.data() + 3 * 999;
    EXPECT_NEAR(std::hypot(last[0], last[1], last[2]) / lone.voxelSize, 1e3, 1);

    SceneOptions far = optionsOf("far", 8);
    far.offset = -1e7;
    EXPECT_NEAR(makeScene(far).positions[0] / makeScene(far).voxelSize, -1e7, 1);

    SceneOptions coincident = optionsOf("coincident", 1000);
    EXPECT_EQ(countNeighbors(makeScene(coincident)).mean, 999);
    coincident.fraction = 0.25;
    EXPECT_GE(countNeighbors(makeScene(coincident)).max, 249U + 25U); // the point is in the middle of a block
}

TEST(Scene, SeamTouchesEveryFace)
{
    const Scene scene = makeScene(optionsOf("seam", 100000));
    for (const double face : {-4096, -128, -8, 0, 8, 128, 4096}) {
        for (std::size_t axis = 0; axis < 3; ++axis) {
            int below = 0, on = 0, above = 0;
            for (std::size_t i = axis; i < scene.positions.size(); i += 3) {
                const double distance = scene.positions[i] / scene.suggestedRadius - face;
                if (std::fabs(distance) < 1e-9)
                    ++on;
                else if (std::fabs(distance) < 1)
                    ++(distance < 0 ? below : above);
            }
            EXPECT_GT(below, 100) << face;
            EXPECT_GT(on, 100) << face;
            EXPECT_GT(above, 100) << face;
        }
    }
}

void expectRefused(const SceneOptions& options, const std::string& first, const std::string& second)
{
    try {
        makeScene(options);
        FAIL() << "accepted: " << first << ", " << second;
    } catch (const InvalidInput& error) {
        EXPECT_NE(std::string(error.what()).find(first), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find(second), std::string::npos) << error.what();
    }
}

TEST(Scene, RefusesBadParameters)
{
    expectRefused(optionsOf("blob", 10), "blob", "two_sources");
    expectRefused(optionsOf("block", 0), "0 particles", "4294967295");
    expectRefused(optionsOf("block", 4294967296), "4294967296", "4294967295");
    SceneOptions options = optionsOf("block", 10);
    options.offset = 1;
    expectRefused(options, "--offset", "'block'");
    options = optionsOf("far", 10);
    options.distance = 1;
    expectRefused(options, "--distance", "'far'");
    options = optionsOf("spray", 10);
    options.fraction = 1;
    expectRefused(options, "--fraction", "'spray'");
    options = optionsOf("coincident", 10);
    options.fraction = 1.5;
    expectRefused(options, "--fraction", "1.5");
    options = optionsOf("outlier", 10);
    options.distance = 1e10;
    expectRefused(options, "--distance", "1e+10");
    for (const double bad : {0.0, -1.0, static_cast<double>(NAN), static_cast<double>(INFINITY)}) {
        options = optionsOf("block", 10);
        options.spacing = bad;
        expectRefused(options, "--spacing", "positive");
        options = optionsOf("block", 10);
        options.radiusFactor = bad;
        expectRefused(options, "--radius-factor", "positive");
        options = optionsOf("block", 10);
        options.voxelSize = bad;
        expectRefused(options, "--voxel-size", "positive");
    }
}

class StopAtOnce : public Progress {
public:
    void update(const char*, double) override {}
    bool cancelled() const override { return true; }
};

TEST(Scene, CanBeCancelled)
{
    StopAtOnce stop;
    EXPECT_THROW(makeScene(optionsOf("block", 100000), &stop), Cancelled);
}

} // namespace

} // namespace vdb_nns
