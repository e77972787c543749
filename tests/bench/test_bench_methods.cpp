// The other methods of `bench`: the control is exact, methods that leave something out go wrong where they must and nowhere
// else, peers find what everybody finds, and nothing is left over from the run before.
#include "agreement/point_views.h"
#include "bench/methods/codec_method.h"
#include "bench/methods/other_methods.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <set>
#include <stdexcept>

namespace vdb_nns::testing {
namespace {

using cli::Method;
using cli::MethodSpec;

MethodSpec specOf(const std::string& family, double number = 0)
{
    MethodSpec spec;
    spec.name = spec.family = family;
    spec.number = number;
    return spec;
}

std::unique_ptr<Method> ablationMethod(const std::string& family, double number = 0,
                                       const SearchOptions& options = {}, double voxelSize = 1)
{
    return cli::makeAblationMethod(specOf(family, number), options, voxelSize);
}

cli::MethodRun runMethod(Method& method, const ParticleView& view, double radius)
{
    cli::ProgressPrinter silent(cli::ProgressMode::kNever);
    return method.run(view, radius, {silent, 0, 1});
}

Lists listsOf(Method& method, const ParticleView& view, double radius)
{
    const cli::MethodRun run = runMethod(method, view, radius);
    Lists lists(view.size());
    std::uint64_t pairs = 0;
    for (std::uint32_t i = 0; i < lists.size(); ++i) {
        method.found().row(i, lists[i]);
        EXPECT_EQ(method.found().count(i), lists[i].size());
        pairs += lists[i].size();
    }
    EXPECT_EQ(run.pairs, pairs);
    return lists;
}

Lists ascending(Lists lists)
{
    for (auto& row : lists) std::sort(row.begin(), row.end());
    return lists;
}

PointSet setNamed(const std::vector<PointSet>& sets, const std::string& name)
{
    const auto set =
        std::find_if(sets.begin(), sets.end(), [&](const PointSet& s) { return s.name == name; });
    if (set == sets.end()) throw std::logic_error("no set " + name);
    return *set;
}

double distanceOf(const PointSet& set, std::size_t i, std::size_t j)
{
    double square = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        double difference = 0;
        for (std::size_t c = 0; c < 3; ++c) {
            const ExactPoint &a = set.points[i], &b = set.points[j];
            difference += set.linear[k][c] *
                          (static_cast<double>(b.voxel[c] - a.voxel[c]) + (b.offset[c] - a.offset[c]));
        }
        square += difference * difference;
    }
    return std::sqrt(square);
}

// The set with a radius a little larger, from which every distance differs by a share of 1e-6 at least.
PointSet withClearRadius(PointSet set)
{
    const double radius = set.radius;
    for (int step = 0; step < 1000; ++step) {
        set.radius = radius * (1 + 1e-5 * step);
        bool clear = true;
        for (std::size_t i = 0; clear && i < set.points.size(); ++i) {
            for (std::size_t j = 0; clear && j < i; ++j) {
                clear = !(std::fabs(distanceOf(set, i, j) / set.radius - 1) < 1e-6);
            }
        }
        if (clear) return set;
    }
    throw std::logic_error("no clear radius for " + set.name);
}

std::uint64_t pairsOf(const Lists& lists)
{
    std::uint64_t pairs = 0;
    for (const auto& row : lists) pairs += row.size();
    return pairs;
}

// Pairs of one but not of the other. Every one of them must be within that share of the radius.
std::uint64_t expectSameButNearRadius(const Lists& actual, const Lists& expected, const PointSet& set,
                                      double share)
{
    std::uint64_t differences = 0;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        const std::set<std::uint32_t> a(actual[i].begin(), actual[i].end());
        const std::set<std::uint32_t> e(expected[i].begin(), expected[i].end());
        EXPECT_EQ(a.size(), actual[i].size()) << set.name << ": a number twice in row " << i;
        std::vector<std::uint32_t> wrong;
        std::set_symmetric_difference(a.begin(), a.end(), e.begin(), e.end(), std::back_inserter(wrong));
        differences += wrong.size();
        for (const std::uint32_t j : wrong) {
            EXPECT_LE(std::fabs(distanceOf(set, i, j) / set.radius - 1), share)
                << set.name << ": pair " << i << ' ' << j;
        }
    }
    return differences;
}

std::vector<PointSet> allSets()
{
    std::vector<PointSet> sets = arraySets(Precision::kFloat);
    for (const PointSet& set : arraySets(Precision::kDouble)) sets.push_back(set);
    for (const PointSet& set : gridSets()) sets.push_back(set);
    return sets;
}

SetView viewOf(const PointSet& set)
{
    const bool hasVoxels = set.linear != kIdentity ||
                           std::any_of(set.points.begin(), set.points.end(), [](const ExactPoint& point) {
                               return point.voxel != decltype(point.voxel){};
                           });
    return SetView(set, hasVoxels ? Form::kVoxels : Form::kDoubles);
}

TEST(AblationMethods, CertifiedIsExactEverywhere)
{
    std::vector<std::unique_ptr<Method>> methods; // kept from set to set
    for (const double cellSize : {0.0, 1.0, 0.5, 0.33, 1.7}) {
        SearchOptions options;
        options.cellSize = cellSize;
        methods.push_back(ablationMethod("certified", 0, options));
    }
    for (const PointSet& set : allSets()) {
        const Lists truth = oracleLists(set);
        const SetView input = viewOf(set);
        for (const auto& method : methods) {
            EXPECT_TRUE(sameLists(listsOf(*method, input.view(), set.radius), truth, set));
        }
    }
}

// A file whose voxels are the cells: the grid's leaves are the file's.
TEST(AblationMethods, CertifiedIsExactInVoxelsOfAFile)
{
    const std::string path = ::testing::TempDir() + "vdb_nns_bench_methods.vdb";
    SceneOptions options;
    options.name = "dam_break";
    options.count = 5000;
    for (const char* codec : {"null", "fxpt8"}) {
        options.codec = codec;
        const Scene scene = makeScene(options);
        writeScene(path, scene, options, OutputOptions{true});
        const PointFile file = PointFile::read(path);
        for (const double share : {0.5, 0.7, 0.99, 1.01, 2.5}) {
            const double radius = share * scene.voxelSize;
            SearchEngine engine;
            const NeighborLists truth = engine.findNeighbors(file.view(), radius);
            const auto method = ablationMethod("certified");
            EXPECT_EQ(ascending(listsOf(*method, file.view(), radius)), ascending(decoded(truth)))
                << codec << ", radius " << share << " voxels";
        }
    }
    std::filesystem::remove(path);
}

TEST(AblationMethods, LeavingTheBandOutCostsPairsNearTheRadiusAlone)
{
    for (const char* family : {"filter-only", "world-float", "world-double"}) {
        const auto method = ablationMethod(family);
        for (const char* name : {"block", "sheet", "clusters", "near the radius", "lattice"}) {
            const PointSet set = setNamed(arraySets(Precision::kDouble), name);
            const Lists lists = listsOf(*method, SetView(set, Form::kDoubles).view(), set.radius);
            expectSameButNearRadius(lists, oracleLists(set), set, 1e-5);
        }
    }
    // About a leaf's centre floats are as good anywhere and in any frame; in the world they are not.
    const auto filter = ablationMethod("filter-only");
    for (const PointSet& set : allSets()) {
        const SetView input = viewOf(set);
        expectSameButNearRadius(listsOf(*filter, input.view(), set.radius), oracleLists(set), set, 1e-5);
    }
    const PointSet far = setNamed(arraySets(Precision::kDouble), "far");
    const auto world = ablationMethod("world-float");
    const Lists lists = listsOf(*world, SetView(far, Form::kDoubles).view(), far.radius);
    EXPECT_GT(expectSameButNearRadius(lists, oracleLists(far), far, 1), 10U);
}

TEST(AblationMethods, ScalarAndVectorsAgree)
{
    SearchOptions scalar, best;
    scalar.simd = SimdLevel::kScalar;
    const std::vector<std::pair<std::string, double>> families = {{"certified", 0},    {"filter-only", 0},
                                                                  {"world-float", 0},  {"world-double", 0},
                                                                  {"sampled", 12.345}, {"nearest", 7}};
    for (const auto& [family, number] : families) {
        const auto one = ablationMethod(family, number, scalar), eight = ablationMethod(family, number, best);
        for (const PointSet& set : arraySets(Precision::kDouble)) {
            const SetView input(set, Form::kDoubles);
            EXPECT_EQ(ascending(listsOf(*one, input.view(), set.radius)),
                      ascending(listsOf(*eight, input.view(), set.radius)))
                << family << ", " << set.name;
        }
    }
}

TEST(ApproximateMethods, SamplesArePartsOfTheWhole)
{
    const PointSet set = setNamed(arraySets(Precision::kDouble), "clusters");
    const SetView input(set, Form::kDoubles);
    const auto filter = ablationMethod("filter-only"), whole = ablationMethod("sampled", 100);
    const auto half = ablationMethod("sampled", 50);
    const Lists all = ascending(listsOf(*filter, input.view(), set.radius));
    EXPECT_EQ(ascending(listsOf(*whole, input.view(), set.radius)), all);
    EXPECT_EQ(whole->found().countScale(), 1);
    const Lists drawn = ascending(listsOf(*half, input.view(), set.radius));
    EXPECT_EQ(half->found().countScale(), 2);
    for (std::size_t i = 0; i < all.size(); ++i) {
        EXPECT_TRUE(std::includes(all[i].begin(), all[i].end(), drawn[i].begin(), drawn[i].end()));
    }
    const double share = static_cast<double>(pairsOf(drawn)) / static_cast<double>(pairsOf(all));
    EXPECT_NEAR(share, 0.5, 0.05);
    EXPECT_THROW(ablationMethod("sampled", 0), InvalidInput);
    EXPECT_THROW(ablationMethod("sampled", 101), InvalidInput);
}

TEST(ApproximateMethods, NearestKeepsTheNearest)
{
    EXPECT_THROW(ablationMethod("nearest", 0), InvalidInput);
    for (const char* name : {"block", "clusters", "lattice", "all coincident"}) {
        const PointSet set = setNamed(arraySets(Precision::kDouble), name);
        const SetView input(set, Form::kDoubles);
        const auto filter = ablationMethod("filter-only");
        const Lists all = ascending(listsOf(*filter, input.view(), set.radius));
        for (const std::size_t most : {1, 8, 33, 1000}) {
            const auto nearest = ablationMethod("nearest", static_cast<double>(most));
            const Lists lists = ascending(listsOf(*nearest, input.view(), set.radius));
            for (std::size_t i = 0; i < all.size(); ++i) {
                ASSERT_EQ(lists[i].size(), std::min(most, all[i].size()));
                ASSERT_TRUE(std::includes(all[i].begin(), all[i].end(), lists[i].begin(), lists[i].end()));
                double farthest = 0, left = std::numeric_limits<double>::infinity();
                for (const std::uint32_t j : all[i]) {
                    const bool kept = std::binary_search(lists[i].begin(), lists[i].end(), j);
                    const double distance = distanceOf(set, i, j);
                    (kept ? farthest : left) = kept ? std::max(farthest, distance) : std::min(left, distance);
                }
                EXPECT_LE(farthest, left + 2e-6 * set.radius) << name << ", query " << i;
            }
        }
    }
    // Ties by number.
    const PointSet same = setNamed(arraySets(Precision::kDouble), "all coincident");
    const auto two = ablationMethod("nearest", 2);
    const Lists lists = ascending(listsOf(*two, SetView(same, Form::kDoubles).view(), same.radius));
    EXPECT_EQ(lists[0], (std::vector<std::uint32_t>{1, 2}));
    EXPECT_EQ(lists[9], (std::vector<std::uint32_t>{0, 1}));
}

TEST(CodecMethods, StoreWhatAFileStores)
{
    const std::string path = ::testing::TempDir() + "vdb_nns_bench_codecs.vdb";
    SceneOptions options;
    options.name = "block";
    options.count = 3000;
    options.voxelSize = 0.25;
    Scene scene = makeScene(options);
    // As the writer of scenes rounds positions, so that both start from the same ones.
    for (double& x : scene.positions) x = std::floor(x * 0x1p28 + 0.5) * 0x1p-28;
    using Key = std::array<long long, 3>;
    // In units far below the codecs' steps.
    const auto keyOf = [&](const double* at) {
        Key key;
        for (std::size_t k = 0; k < 3; ++k) key[k] = std::llround(at[k] / scene.voxelSize * 1e9);
        return key;
    };
    for (const auto codec : {cli::PositionCodec::kFixed8, cli::PositionCodec::kFixed16}) {
        options.codec = codec == cli::PositionCodec::kFixed8 ? "fxpt8" : "fxpt16";
        writeScene(path, scene, options, OutputOptions{true});
        const PointFile file = PointFile::read(path);
        std::vector<Key> stored, computed;
        for (std::size_t i = 0; i < options.count; ++i) {
            stored.push_back(keyOf(file.view().worldPosition(i).data()));
        }
        const auto view = ParticleView::fromArray(scene.positions.data(), options.count);
        const std::vector<double> xyz = cli::quantized(view, codec, scene.voxelSize);
        for (std::size_t i = 0; i < options.count; ++i) computed.push_back(keyOf(xyz.data() + 3 * i));
        std::sort(stored.begin(), stored.end());
        std::sort(computed.begin(), computed.end());
        std::size_t different = 0;
        for (std::size_t i = 0; i < options.count; ++i) {
            for (std::size_t k = 0; k < 3; ++k) different += std::llabs(stored[i][k] - computed[i][k]) > 1;
        }
        EXPECT_EQ(different, 0U) << options.codec;
    }
    std::filesystem::remove(path);
    const double bad[3] = {std::nan(""), 1, -std::numeric_limits<double>::infinity()};
    const std::vector<double> kept =
        cli::quantized(ParticleView::fromArray(bad, 1), cli::PositionCodec::kFixed8, 0.5);
    EXPECT_TRUE(std::isnan(kept[0]));
    EXPECT_TRUE(std::isinf(kept[2]));
}

TEST(CodecMethods, LoseWhatTheirStepIsWorth)
{
    SceneOptions options;
    options.name = "block";
    options.count = 20000;
    const Scene scene = makeScene(options);
    const ParticleView view = ParticleView::fromArray(scene.positions.data(), options.count);
    const double radius = scene.suggestedRadius, voxel = radius / 2;
    SearchEngine engine;
    const Lists truth = ascending(decoded(engine.findNeighbors(view, radius)));
    double shares[2];
    for (const int codec : {0, 1}) {
        const auto method = ablationMethod(codec ? "codec16" : "codec8", 0, {}, voxel);
        const Lists lists = ascending(listsOf(*method, view, radius));
        std::vector<std::uint32_t> wrong;
        for (std::size_t i = 0; i < truth.size(); ++i) {
            std::set_symmetric_difference(truth[i].begin(), truth[i].end(), lists[i].begin(), lists[i].end(),
                                          std::back_inserter(wrong));
        }
        shares[codec] = static_cast<double>(wrong.size()) / static_cast<double>(pairsOf(truth));
    }
    EXPECT_GT(shares[0], 1e-4);
    EXPECT_LT(shares[0], 1e-2);
    EXPECT_LT(shares[1], 0.05 * shares[0]);
}

std::vector<std::unique_ptr<Method>> doublePeers()
{
    std::vector<std::unique_ptr<Method>> methods;
    for (const char* family : {"openvdb", "nanoflann-double", "brute-force"}) {
        if (cli::missingPeer(family).empty()) methods.push_back(cli::makePeerMethod(specOf(family)));
    }
    methods.push_back(ablationMethod("world-double"));
    return methods;
}

TEST(Peers, FindAllClearPairs)
{
    const auto methods = doublePeers();
    for (const char* name : {"empty", "one", "block", "sheet", "spray", "clusters", "seam"}) {
        const PointSet set = withClearRadius(setNamed(arraySets(Precision::kDouble), name));
        const Lists truth = oracleLists(set);
        for (const auto& method : methods) {
            EXPECT_TRUE(
                sameLists(listsOf(*method, SetView(set, Form::kDoubles).view(), set.radius), truth, set));
        }
    }
    if (!cli::missingPeer("nanoflann-float").empty()) GTEST_SKIP() << cli::missingPeer("nanoflann-float");
    const auto floats = cli::makePeerMethod(specOf("nanoflann-float"));
    const PointSet block = setNamed(arraySets(Precision::kDouble), "block");
    const Lists lists = listsOf(*floats, SetView(block, Form::kDoubles).view(), block.radius);
    expectSameButNearRadius(lists, oracleLists(block), block, 1e-5);
}

TEST(Peers, BruteForceRowsAscend)
{
    const PointSet set = setNamed(arraySets(Precision::kDouble), "non-finite");
    const auto method = cli::makePeerMethod(specOf("brute-force"));
    const Lists lists = listsOf(*method, SetView(set, Form::kDoubles).view(), set.radius);
    EXPECT_TRUE(sameLists(lists, oracleLists(set), set));
    EXPECT_EQ(lists, ascending(lists));
}

TEST(AllMethods, LeaveNothingBehind)
{
    auto methods = doublePeers();
    methods.push_back(ablationMethod("certified"));
    methods.push_back(ablationMethod("filter-only"));
    methods.push_back(ablationMethod("sampled", 30));
    methods.push_back(ablationMethod("nearest", 5));
    methods.push_back(ablationMethod("codec8"));
    const std::vector<PointSet> sets = arraySets(Precision::kDouble);
    const PointSet block = setNamed(sets, "block"), small = setNamed(sets, "two coincident");
    const SetView input(block, Form::kDoubles), other(small, Form::kDoubles);
    for (const auto& method : methods) {
        EXPECT_THROW(method->found(), std::logic_error);
        const Lists first = ascending(listsOf(*method, input.view(), block.radius));
        EXPECT_EQ(ascending(listsOf(*method, input.view(), block.radius)), first);
        listsOf(*method, other.view(), small.radius);
        EXPECT_EQ(ascending(listsOf(*method, input.view(), block.radius)), first);
        runOnThreads(3, [&] { EXPECT_EQ(ascending(listsOf(*method, input.view(), block.radius)), first); });
        std::uint64_t visited = 0;
        tbb::task_arena(1).execute([&] {
            method->found().visitRows([&](std::uint32_t query, Span<const std::uint32_t> row) {
                EXPECT_EQ(row.size(), first[query].size());
                visited += row.size();
            });
        });
        EXPECT_EQ(visited, pairsOf(first));
        method->discard();
        EXPECT_THROW(method->found(), std::logic_error);
    }
    // Rows of particles that are in the grid no longer.
    const PointSet holes = setNamed(sets, "non-finite");
    PointSet whole = holes;
    for (ExactPoint& point : whole.points) {
        for (double& x : point.offset) x = std::isfinite(x) ? x : 0.25;
    }
    const auto certified = ablationMethod("certified");
    listsOf(*certified, SetView(whole, Form::kDoubles).view(), whole.radius);
    EXPECT_TRUE(sameLists(listsOf(*certified, SetView(holes, Form::kDoubles).view(), holes.radius),
                          oracleLists(holes), holes));
}

TEST(AllMethods, RefuseOthersByName)
{
    EXPECT_THROW(ablationMethod("openvdb"), std::logic_error);
    EXPECT_THROW(cli::makePeerMethod(specOf("certified")), std::logic_error);
    EXPECT_TRUE(cli::missingPeer("openvdb").empty());
    EXPECT_TRUE(cli::missingPeer("brute-force").empty());
}

} // namespace
} // namespace vdb_nns::testing
