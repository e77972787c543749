// Measures give the same bytes wherever and however they are made, whatever the host program set the processor to, and in memory
// that is used again. Whether they are right is for the check of verify (tests/verify/test_measure_agreement.cpp).
#include "../agreement/point_views.h"
#include "../support/distributions.h"
#include "../support/tiny_rows.h"
#include "vdb_nns/error.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>
#include <xmmintrin.h>

#include <tbb/task_arena.h>

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::testing {
namespace {

const std::vector<std::string> kRowMeasures = {"count",    "density",     "mean_distance", "nearest_distance",
                                               "nearest",  "average:f",   "average:v",     "average:w",
                                               "normal",   "eigenvalues", "pca",           "isolated",
                                               "nonfinite"};
const std::vector<std::string> kClusterMeasures = {"cluster", "cluster_size"};

// Attributes with a value that is not finite here and there.
struct Values {
    std::vector<float> f, v;
    std::vector<double> w;

    explicit Values(std::size_t count)
    {
        std::mt19937 random(5);
        std::normal_distribution<double> normal;
        for (std::size_t k = 0; k < count; ++k) {
            f.push_back(static_cast<float>(std::ldexp(normal(random), static_cast<int>(random() % 60) - 30)));
            for (int c = 0; c < 3; ++c) {
                v.push_back(static_cast<float>(normal(random)));
                w.push_back(100 + normal(random));
            }
        }
        for (std::size_t k = 3; k < count; k += 17) v[3 * k] = std::numeric_limits<float>::infinity();
    }
    std::vector<PointAttribute> attributes() const
    {
        return {viewAttribute("f", AttributeType::kFloat, f.data(), f.size()),
                viewAttribute("v", AttributeType::kVec3s, v.data(), f.size()),
                viewAttribute("w", AttributeType::kVec3d, w.data(), f.size())};
    }
};

std::string bytesOf(const PointValues& values)
{
    std::string bytes;
    for (const PointAttribute& a : values.attributes) {
        bytes += a.name + attributeTypeName(a.type);
        bytes.append(static_cast<const char*>(a.values.get()), a.count * attributeBytes(a.type));
    }
    for (const PointGroup& g : values.groups) {
        bytes += g.name;
        bytes.append(reinterpret_cast<const char*>(g.members.get()), g.count);
    }
    return bytes;
}

// All measures of a view, one after the other.
std::string measured(const ParticleView& view, double radius, const Values& values, MeasureOptions options)
{
    options.attributes = values.attributes();
    const std::string rows = bytesOf(measure(view, radius, kRowMeasures, options));
    return rows + bytesOf(measure(view, radius, kClusterMeasures, options));
}

struct Case {
    std::string name;
    ParticleView view;
    double radius;
    std::shared_ptr<const void> owner; // of an array
};

// Every distribution as floats, as doubles and as voxels.
std::vector<Case> cases()
{
    std::vector<Case> result;
    for (const PointSet& set : arraySets(Precision::kFloat)) {
        const auto floats = std::make_shared<std::vector<float>>(floatsOf(set));
        result.push_back({set.name + " as floats", ParticleView::fromArray(floats->data(), set.points.size()),
                          set.radius, floats});
    }
    for (const PointSet& set : arraySets(Precision::kDouble)) {
        const auto doubles = std::make_shared<std::vector<double>>(doublesOf(set));
        result.push_back({set.name + " as doubles",
                          ParticleView::fromArray(doubles->data(), set.points.size()), set.radius, doubles});
    }
    for (const PointSet& set : gridSets()) {
        result.push_back(
            {set.name + " as voxels", ParticleView(std::make_shared<VoxelSource>(set)), set.radius, nullptr});
    }
    return result;
}

// A set of voxels so small that those of neighbors differ by more than ten bits hold.
PointSet fineVoxels()
{
    PointSet set;
    set.name = "fine voxels";
    set.radius = 1;
    set.linear = {{{1.0 / 2048, 0, 0}, {0, 1.0 / 2048, 0}, {0, 0, 1.0 / 2048}}};
    std::mt19937 random(3);
    for (int i = 0; i < 400; ++i) {
        ExactPoint point{};
        for (int k = 0; k < 3; ++k) {
            point.voxel[k] = static_cast<std::int64_t>(random() % 6000) - 3000;
            point.offset[k] = roundedToFloat(static_cast<double>(random() % 1000) / 1000 - 0.5);
        }
        set.points.push_back(point);
    }
    return set;
}

TEST(Measure, SameBytesOnAllInstructionSets)
{
    std::vector<Case> all = cases();
    all.push_back({"fine voxels", ParticleView(std::make_shared<VoxelSource>(fineVoxels())), 1, nullptr});
    for (const Case& c : all) {
        const Values values(c.view.size());
        MeasureOptions options;
        options.search.simd = SimdLevel::kScalar;
        const std::string expected = measured(c.view, c.radius, values, options);
        for (const SimdLevel level : {SimdLevel::kSse4, SimdLevel::kAvx2, SimdLevel::kAvx512}) {
            if (level > bestSimdLevel()) continue;
            options.search.simd = level;
            EXPECT_TRUE(measured(c.view, c.radius, values, options) == expected)
                << c.name << ", " << simdLevelName(level);
        }
    }
}

// A set whose offsets are as a file has them, of 24 bits, and some of them so small, or so far away, that voxel and offset are no double.
PointSet wholeVoxels(std::size_t tiny, std::size_t far)
{
    PointSet set;
    set.name = std::to_string(tiny) + " tiny, " + std::to_string(far) + " far";
    set.radius = 1.5;
    set.linear = {{{0.75, 0.25, 0}, {0, -1, 0.125}, {0.0625, 0, 1.25}}};
    std::mt19937 random(9);
    for (std::size_t i = 0; i < 6000; ++i) {
        ExactPoint point{};
        for (int k = 0; k < 3; ++k) {
            point.voxel[k] = static_cast<std::int64_t>(random() % 16) + (i < far ? 20000 : 0) - 9000;
            point.offset[k] = roundedToFloat(static_cast<double>(random()) / 4294967296.0 - 0.5);
        }
        if (i % 50 == 7 && i / 50 < tiny)
            point.offset[i % 3] = std::ldexp(0.75, -20 - static_cast<int>(i % 30));
        set.points.push_back(point);
    }
    return set;
}

// In unbounded memory positions of a grid are doubles where they can be, else records of half that size.
TEST(Measure, SameBytesHoweverPositionsAreHeld)
{
    // None, as many as are looked up, and too many.
    const std::pair<std::size_t, std::size_t> unknowns[] = {{0, 0}, {5, 0}, {3, 2}, {120, 0}, {0, 700}};
    for (const auto& [tiny, far] : unknowns) {
        const PointSet set = wholeVoxels(tiny, far);
        const ParticleView view(std::make_shared<VoxelSource>(set));
        const Values values(view.size());
        MeasureOptions options;
        const std::string expected = measured(view, set.radius, values, options);
        options.search.hostMemoryBytes = std::uint64_t(1) << 30;
        EXPECT_TRUE(measured(view, set.radius, values, options) == expected) << set.name;
        for (const SimdLevel level : {SimdLevel::kScalar, SimdLevel::kSse4}) {
            options.search.hostMemoryBytes = 0;
            options.search.simd = level;
            EXPECT_TRUE(measured(view, set.radius, values, options) == expected)
                << set.name << ", " << simdLevelName(level);
        }
    }
}

TEST(Measure, SameBytesForAllKernelsAndInstructionSets)
{
    const PointSet set = gridSets()[5];
    const ParticleView view(std::make_shared<VoxelSource>(set));
    const Values values(view.size());
    for (const SmoothingKernel kernel : {SmoothingKernel::kCubic, SmoothingKernel::kWendland2,
                                         SmoothingKernel::kPoly6, SmoothingKernel::kTophat}) {
        MeasureOptions options;
        options.kernel = kernel;
        options.search.simd = SimdLevel::kScalar;
        const std::string expected = measured(view, set.radius, values, options);
        options.search.simd = SimdLevel::kBest;
        EXPECT_TRUE(measured(view, set.radius, values, options) == expected) << static_cast<int>(kernel);
    }
}

TEST(Measure, SameBytesForAllThreadsAndCells)
{
    for (const Case& c : cases()) {
        const Values values(c.view.size());
        const std::string expected = measured(c.view, c.radius, values, {});
        for (const int threads : {1, 3, 8}) {
            tbb::task_arena arena(threads);
            EXPECT_TRUE(arena.execute([&] { return measured(c.view, c.radius, values, {}); }) == expected)
                << c.name << ", " << threads << " threads";
        }
        for (const double size : {0.5, 1.0, 2.0}) {
            MeasureOptions options;
            options.search.cellSize = size;
            EXPECT_TRUE(measured(c.view, c.radius, values, options) == expected)
                << c.name << ", cells of " << size;
        }
    }
}

// Lists that are there need no search.
TEST(Measure, SameBytesFromLists)
{
    for (const Case& c : cases()) {
        const Values values(c.view.size());
        MeasureOptions options;
        options.attributes = values.attributes();
        for (const std::uint32_t nearest : {0u, 5u}) {
            options.search.nearest = nearest;
            SearchEngine searching;
            const SearchSets sets = searching.buildGrid(c.view, c.radius);
            std::vector<std::vector<std::string>> selections = {kRowMeasures,
                                                                {"count", "isolated", "nonfinite"}};
            if (nearest == 0) selections.push_back(kClusterMeasures);
            for (const std::vector<std::string>& names : selections) {
                options.minNeighbors =
                    names == kClusterMeasures ? std::optional<std::uint32_t>(4) : std::nullopt;
                const std::string expected = bytesOf(searching.measure(sets, names, options).values);
                for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
                    if (nearest > 0 && encoding == Encoding::kMask) continue;
                    SearchEngine engine;
                    SearchOptions search;
                    search.encoding = encoding;
                    search.nearest = nearest;
                    const NeighborLists lists = engine.search(sets, search);
                    options.search.nearest = 0; // the lists know
                    EXPECT_TRUE(bytesOf(engine.measure(lists, names, options).values) == expected)
                        << c.name << ", nearest " << nearest << ", " << names.front();
                    options.search.nearest = nearest;
                }
            }
        }
    }
}

// Programs that render flush denormals, and some round in another direction.
TEST(Measure, SameBytesWhateverTheHostSet)
{
    // Their mean is lost where denormal coordinates are taken for zeros.
    std::vector<float> tiny;
    for (int k = 0; k < 90; ++k) tiny.push_back(static_cast<float>(k) * 1e-41f);
    const ParticleView tinyView = ParticleView::fromArray(tiny.data(), tiny.size() / 3);
    const std::string tinyExpected = bytesOf(measure(tinyView, 1, {"pca"}));
    const std::vector<std::uint32_t> tinyCounts = countNeighbors(tinyView, 1e-40);
    EXPECT_EQ(tinyCounts[0], 1u);

    const PointSet set = arraySets(Precision::kFloat)[5];
    const std::vector<float> floats = floatsOf(set);
    const ParticleView view = ParticleView::fromArray(floats.data(), set.points.size());
    Values values(view.size());
    for (std::size_t k = 0; k < values.f.size(); k += 2) values.f[k] = 1e-41f; // denormal
    const std::string expected = measured(view, set.radius, values, {});
    constexpr unsigned kFlush = 0x8040, kRoundUp = 0x4000;
    for (const unsigned mode : {kFlush, kRoundUp, kFlush | kRoundUp}) {
        const unsigned before = _mm_getcsr();
        _mm_setcsr(before | mode);
        const unsigned host = _mm_getcsr() & 0xffc0u;
        // An arena runs its tasks with what was set when it was made.
        tbb::task_arena arena(1);
        arena.execute([&] {
            const std::string bytes = measured(view, set.radius, values, {});
            const std::string tinyBytes = bytesOf(measure(tinyView, 1, {"pca"}));
            EXPECT_EQ(_mm_getcsr() & 0xffc0u, host);
            EXPECT_TRUE(bytes == expected) << mode;
            EXPECT_TRUE(tinyBytes == tinyExpected) << mode;
            EXPECT_EQ(countNeighbors(tinyView, 1e-40), tinyCounts) << mode;
        });
        _mm_setcsr(before);
    }
}

// Ratios of lengths and directions do not know the scale: squares of matrices must not leave the range of doubles.
TEST(Measure, PcaIsTheSameAtEveryScale)
{
    const PointSet set = arraySets(Precision::kDouble)[5];
    const std::vector<double> doubles = doublesOf(set);
    const auto pcaAt = [&](int exponent) {
        std::vector<double> scaled;
        for (const double x : doubles) scaled.push_back(std::ldexp(x, exponent));
        PointValues values = measure(ParticleView::fromArray(scaled.data(), scaled.size() / 3),
                                     std::ldexp(set.radius, exponent), {"pca"});
        values.attributes.pop_back(); // pws, which is a position
        return bytesOf(values);
    };
    const std::string expected = pcaAt(0);
    for (const int exponent : {-400, -300, -1, 1, 300, 400})
        EXPECT_TRUE(pcaAt(exponent) == expected) << exponent;
}

// Whatever rows a batch has beside it, a row's values are the same.
TEST(Measure, ValuesDoNotDependOnOtherRows)
{
    const std::vector<double> xyz = rowsOfTinyTerms(0.1);
    const std::vector<std::string> names = {"density", "mean_distance", "normal", "eigenvalues", "pca"};
    const auto measureFrom = [&](std::size_t first, std::size_t count) {
        return measure(ParticleView::fromArray(xyz.data() + 3 * first, count), 0.1, names);
    };
    const std::size_t count = xyz.size() / 3;
    const PointValues all = measureFrom(0, count);
    for (std::size_t first = 0; first < count;) {
        std::size_t end = first; // of the points of one place
        while (end < count && xyz[3 * end] - xyz[3 * first] < 50) ++end;
        const PointValues alone = measureFrom(first, end - first);
        for (std::size_t a = 0; a < all.attributes.size(); ++a) {
            const std::size_t bytes = attributeBytes(all.attributes[a].type);
            EXPECT_EQ(std::memcmp(static_cast<const char*>(all.attributes[a].values.get()) + first * bytes,
                                  alone.attributes[a].values.get(), (end - first) * bytes),
                      0)
                << all.attributes[a].name << " from point " << first;
        }
        first = end;
    }
}

// Their exact positions are within the radius, on two sides of where doubles are rounded down and up.
TEST(Measure, DistancesOfTwoGridsMayPassTheRadius)
{
    const double half = std::ldexp(1, -23), little = std::ldexp(1, -40), apart = 2 * half;
    PointSet queries, candidates;
    queries.points = {{{1 << 30, 0, 0}, {half - little, 0, 0}}};
    candidates.linear = {{{2, 0, 0}, {0, 2, 0}, {0, 0, 2}}};
    candidates.points = {{{1 << 29, 0, 0}, {(half + little) / 2, 0, 0}}};
    const ParticleView from(std::make_shared<VoxelSource>(queries)),
        to(std::make_shared<VoxelSource>(candidates));
    SearchEngine engine;
    const SearchSets sets = engine.sort(to, from, Radius(4 * little), {});
    const PointValues values =
        engine.measure(sets, {"count", "mean_distance", "nearest_distance"}, MeasureOptions()).values;
    EXPECT_EQ(*static_cast<const std::int32_t*>(values.attributes[0].values.get()), 1);
    for (std::size_t k = 1; k < 3; ++k)
        EXPECT_EQ(*static_cast<const float*>(values.attributes[k].values.get()), static_cast<float>(apart));
}

TEST(Measure, ResultsOutliveTheNextRun)
{
    const PointSet set = arraySets(Precision::kFloat)[5];
    const std::vector<float> floats = floatsOf(set);
    const ParticleView view = ParticleView::fromArray(floats.data(), set.points.size());
    SearchEngine engine;
    const SearchSets sets = engine.buildGrid(view, set.radius);
    Measured first = engine.measure(sets, {"density", "pca"}, {});
    const std::string bytes = bytesOf(first.values);
    MeasureOptions other;
    other.kernel = SmoothingKernel::kTophat;
    const Measured second = engine.measure(sets, {"density", "pca"}, other);
    EXPECT_TRUE(bytesOf(first.values) == bytes);
    EXPECT_NE(first.values.attributes[0].values, second.values.attributes[0].values);
    // Memory that nobody holds is used again, and is clean.
    const void* const freed = first.values.attributes[0].values.get();
    first = Measured();
    const Measured third = engine.measure(sets, {"density", "pca"}, {});
    EXPECT_EQ(third.values.attributes[0].values.get(), freed);
    EXPECT_TRUE(bytesOf(third.values) == bytes);
}

// A crowd: more terms than the largest scale has room for, and a row longer than a batch.
TEST(Measure, CountsACrowd)
{
    constexpr std::size_t kCount = 9000;
    std::vector<float> xyz(3 * kCount, 0.25f);
    MeasureOptions options;
    options.kernel = SmoothingKernel::kTophat;
    const PointValues values = measure(ParticleView::fromArray(xyz.data(), kCount), 1,
                                       {"density", "mean_distance", "normal"}, options);
    const double expected = kCount * 3 / (4 * 3.14159265358979323846);
    const auto* const density = static_cast<const float*>(values.attributes[0].values.get());
    const auto* const mean = static_cast<const float*>(values.attributes[1].values.get());
    const auto* const normal = static_cast<const float*>(values.attributes[2].values.get());
    for (std::size_t i = 0; i < kCount; i += 499) {
        EXPECT_NEAR(density[i] / expected, 1, 1e-7);
        EXPECT_EQ(mean[i], 0);
        EXPECT_EQ(normal[3 * i], 0);
    }
}

// Weights of a pair are relative to a radius: no ratio of two makes them infinite.
TEST(Measure, DensitiesKnowNoLargestRadius)
{
    const std::vector<float> xyz = {0, 0, 0, 1, 0, 0};
    const ParticleView view = ParticleView::fromArray(xyz.data(), 2);
    const std::vector<double> radii = {2, 1e300};
    Radius radius;
    radius.ofQueries = radius.ofCandidates = {radii.data(), radii.size()};
    radius.mode = RadiusMode::kScatter;
    SearchEngine engine;
    const PointValues values =
        engine
            .measure(engine.sort(view, view, radius), {"density", "average:a"},
                     [&] {
                         static const float kTwo[] = {2, 4};
                         MeasureOptions options;
                         options.attributes = {viewAttribute("a", AttributeType::kFloat, kTwo, 2)};
                         return options;
                     }())
            .values;
    const auto* const density = static_cast<const float*>(values.attributes[0].values.get());
    const auto* const average = static_cast<const float*>(values.attributes[1].values.get());
    // W of the radius 1e300 is 0 in either; with the radius 2 it is 1 / pi at 0 and a quarter of that at 1.
    EXPECT_FLOAT_EQ(density[0], 0.318309886f);
    EXPECT_FLOAT_EQ(density[1], 0.318309886f / 4);
    EXPECT_EQ(average[0], 2);
    EXPECT_EQ(average[1], 2);
}

// W(0) of such a radius is infinite in double.
TEST(Measure, NoMassIsNoDensityAtAnyScale)
{
    const std::vector<double> xyz = {0, 0, 0, 1e-110, 0, 0};
    MeasureOptions options;
    options.mass = 0;
    const PointValues values = measure(ParticleView::fromArray(xyz.data(), 2), 2e-110, {"density"}, options);
    EXPECT_EQ(static_cast<const float*>(values.attributes[0].values.get())[0], 0);
}

TEST(Measure, AveragesOfTheLargestAndTheSmallestNumbers)
{
    const std::vector<float> xyz(3 * 20, 0.5f);
    const ParticleView view = ParticleView::fromArray(xyz.data(), 20);
    constexpr double kLargest = std::numeric_limits<double>::max(), kNone = 0x1p-1074;
    for (const double value : {kLargest, -kLargest, 5 * kNone, 1e-290, -1e300}) {
        std::vector<double> doubles(20, value);
        doubles[7] = std::numeric_limits<double>::quiet_NaN();
        MeasureOptions options;
        options.kernel = SmoothingKernel::kTophat;
        options.attributes = {viewAttribute("d", AttributeType::kDouble, doubles.data(), 20)};
        const PointValues values = measure(view, 1, {"average:d"}, options);
        const auto* const average = static_cast<const double*>(values.attributes[0].values.get());
        for (std::size_t i = 0; i < 20; ++i) EXPECT_DOUBLE_EQ(average[i], value) << i;
    }
}

// Neighbors exactly at the radius have no weight, and are neighbors.
TEST(Measure, AnEllipsoidTakesPointsWithoutWeight)
{
    const std::vector<float> query = {0, 0, 0}, xyz = {2, 0, 0, 0, 2, 0, 0, -2, 0};
    SearchEngine engine;
    MeasureOptions options;
    options.pca = {0.25, 7, 3, 1};
    const ParticleView candidates = ParticleView::fromArray(xyz.data(), 3);
    const PointValues values =
        engine.measure(engine.sort(candidates, ParticleView::fromArray(query.data(), 1), 2), {"pca"}, options)
            .values;
    EXPECT_EQ(values.groups[0].members.get()[0], 1);
    const auto* const stretch = static_cast<const float*>(values.attributes[0].values.get());
    const auto* const xform = static_cast<const float*>(values.attributes[1].values.get());
    const auto* const pws = static_cast<const double*>(values.attributes[2].values.get());
    for (std::size_t k = 0; k < 3; ++k) {
        EXPECT_EQ(stretch[k], 1);
        EXPECT_EQ(pws[k], 0);
    }
    for (std::size_t k = 0; k < 9; ++k) EXPECT_EQ(xform[k], k % 4 == 0 ? 1 : 0);
}

TEST(Measure, CountsAreThoseOfASearch)
{
    const PointSet set = arraySets(Precision::kFloat)[7];
    const std::vector<float> floats = floatsOf(set);
    SearchEngine engine;
    const SearchSets sets =
        engine.buildGrid(ParticleView::fromArray(floats.data(), set.points.size()), set.radius);
    for (const std::uint32_t nearest : {0u, 3u}) {
        MeasureOptions options;
        options.search.nearest = nearest;
        const Measured measured = engine.measure(sets, {"density"}, options);
        SearchOptions search = options.search;
        search.encoding = Encoding::kNone;
        const NeighborLists lists = engine.search(sets, search);
        EXPECT_EQ(measured.counts.counts(), lists.counts());
        EXPECT_EQ(measured.counts.statistics().pairs, lists.statistics().pairs);
        EXPECT_EQ(measured.counts.statistics().isolated, lists.statistics().isolated);
        EXPECT_EQ(measured.counts.statistics().shortened, lists.statistics().shortened);
    }
}

class StopAtOnce final : public Progress {
public:
    void update(const char*, double) override {}
    bool cancelled() const override { return mQuestions++ >= mAfter; }
    explicit StopAtOnce(int after) : mAfter(after) {}

private:
    const int mAfter;
    mutable std::atomic<int> mQuestions{0};
};

TEST(Measure, StopsWhenAskedTo)
{
    const PointSet set = arraySets(Precision::kFloat)[5];
    const std::vector<float> floats = floatsOf(set);
    SearchEngine engine;
    const SearchSets sets =
        engine.buildGrid(ParticleView::fromArray(floats.data(), set.points.size()), set.radius);
    const std::vector<std::string> names = {"density", "pca", "cluster", "nearest", "isolated"};
    const std::string expected = bytesOf(engine.measure(sets, names, {}).values);
    for (int after = 0; after < 6; ++after) {
        StopAtOnce progress(after);
        MeasureOptions options;
        options.search.progress = &progress;
        EXPECT_THROW(engine.measure(sets, names, options), Cancelled) << after;
    }
    EXPECT_TRUE(bytesOf(engine.measure(sets, names, {}).values) == expected);
}

// All pairs are in the band, and the kernels ask between them: what a stopped one leaves behind is nobody's row.
TEST(Measure, AnEngineThatWasStoppedGoesOn)
{
    std::vector<float> pair;
    for (int k = 0; k < 3000; ++k) pair.insert(pair.end(), {static_cast<float>(k % 2), 0, 0});
    const PointSet set = arraySets(Precision::kFloat)[5];
    const std::vector<float> floats = floatsOf(set);
    const ParticleView few = ParticleView::fromArray(floats.data(), set.points.size());
    const std::vector<std::string> names = {"density", "pca", "cluster"};
    const std::string expected = bytesOf(measure(few, set.radius, names));
    SearchEngine engine;
    int stopped = 0;
    for (int after = 0; after < 270; after += 19) {
        StopAtOnce progress(after);
        MeasureOptions options;
        options.search.progress = &progress;
        tbb::task_arena(1).execute([&] {
            const SearchSets sets = engine.buildGrid(ParticleView::fromArray(pair.data(), 3000), 1);
            try {
                engine.measure(sets, {"density"}, options);
            } catch (const Cancelled&) {
                ++stopped;
            }
            const std::string bytes =
                bytesOf(engine.measure(engine.buildGrid(few, set.radius), names, {}).values);
            EXPECT_TRUE(bytes == expected) << after;
        });
    }
    EXPECT_GT(stopped, 10);
}

TEST(Measure, RefusesWhatCannotBe)
{
    const std::vector<float> xyz = {0, 0, 0, 1, 0, 0};
    const ParticleView view = ParticleView::fromArray(xyz.data(), 2);
    const std::vector<float> one = {1}, matrices(18);
    const std::vector<double> negative = {1, -1}, short_ = {1};
    const auto with = [&](auto&& change) {
        MeasureOptions options;
        change(options);
        return options;
    };
    EXPECT_THROW(measure(view, 1, {"densty"}), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"density", "density"}), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"average:"}), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"average:v"}), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"density"}, with([](auto& o) { o.mass = -1; })), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"density"}, with([&](auto& o) {
                             o.masses = {negative.data(), 2};
                         })),
                 InvalidInput);
    EXPECT_THROW(measure(view, 1, {"density"}, with([&](auto& o) {
                             o.masses = {short_.data(), 1};
                         })),
                 InvalidInput);
    EXPECT_THROW(measure(view, 1, {"average:v"}, with([&](auto& o) {
                             o.attributes = {viewAttribute("v", AttributeType::kFloat, one.data(), 1)};
                         })),
                 InvalidInput);
    EXPECT_THROW(measure(view, 1, {"average:m"}, with([&](auto& o) {
                             o.attributes = {viewAttribute("m", AttributeType::kMat3s, matrices.data(), 2)};
                         })),
                 InvalidInput);
    EXPECT_THROW(measure(view, 1, {"pca"}, with([](auto& o) { o.pca.anisotropy = 0; })), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"pca"}, with([](auto& o) { o.pca.average = 2; })), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"cluster"}, with([](auto& o) { o.minNeighbors = 0; })), InvalidInput);
    EXPECT_THROW(measure(view, 1, {"cluster"}, with([](auto& o) { o.search.nearest = 1; })), InvalidInput);
    SearchEngine engine;
    const SearchSets sets = engine.buildGrid(view, 1);
    EXPECT_THROW(engine.measure(sets, {"density"}, with([](auto& o) { o.search.hostMemoryBytes = 1; })),
                 CapacityError);
    SearchOptions counting, withSelf;
    counting.encoding = Encoding::kNone;
    withSelf.includeSelf = true;
    for (const SearchOptions& search : {counting, withSelf})
        EXPECT_THROW(engine.measure(engine.search(sets, search), {"density"}, {}), InvalidInput);
    try {
        measure(view, 1, {"densty"});
    } catch (const InvalidInput& error) {
        EXPECT_NE(std::string(error.what()).find("did you mean 'density'?"), std::string::npos)
            << error.what();
    }
}

} // namespace
} // namespace vdb_nns::testing
