// Searches that are written while they run: the bytes of writeNpz(), and nothing else if they do not end.
#include "agreement/point_views.h"
#include "io/npz_in_order.h"
#include "io/npz_search.h"
#include "io/output_file.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numeric>
#include <random>

#include <sys/resource.h>
#include <sys/stat.h>

namespace vdb_nns::testing {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMuch = std::uint64_t(1) << 32;

class NpzSearch : public ::testing::Test {
protected:
    NpzSearch()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_npz_search_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~NpzSearch() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    static std::string contents(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(stream), {}};
    }

    std::ptrdiff_t fileCount() const { return std::distance(fs::directory_iterator(mFolder), {}); }

    NpzSearchOptions options(ListValues values = ListValues::kConnectivity,
                             std::uint64_t windowBytes = kMuch) const
    {
        NpzSearchOptions result;
        result.path = path("direct.npz");
        result.form = values;
        result.output.overwrite = true;
        result.windowBytes = windowBytes;
        return result;
    }

    // Writes both ways; all but the lists themselves must be the same.
    void expectSame(const ParticleView& view, const Radius& radius, const std::string& name,
                    const SearchOptions& search = {})
    {
        SearchEngine holding;
        const NeighborLists lists = holding.search(view, view, radius, search);
        for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
            writeNpz(path("lists.npz"), lists, values, {true});
            for (const int threads : {1, 4}) {
                SCOPED_TRACE(name + ", threads: " + std::to_string(threads));
                runOnThreads(threads, [&] {
                    EngineState engine;
                    NpzSearchOptions how = options(values);
                    how.checksum = true;
                    const std::optional<NpzSearchResult> result =
                        searchToNpz(engine, lists.sets(), search, how);
                    ASSERT_TRUE(result);
                    EXPECT_TRUE(contents(path("direct.npz")) == contents(path("lists.npz")));
                    EXPECT_EQ(result->checksum, lists.checksum());
                    EXPECT_EQ(result->lists.counts(), lists.counts());
                    const ListStatistics found = result->lists.statistics(), truth = lists.statistics();
                    EXPECT_EQ(found.pairs, truth.pairs);
                    EXPECT_EQ(found.min, truth.min);
                    EXPECT_EQ(found.max, truth.max);
                    EXPECT_EQ(found.mean, truth.mean);
                    EXPECT_EQ(found.isolated, truth.isolated);
                    EXPECT_EQ(found.shortened, truth.shortened);
                });
            }
        }
        EXPECT_EQ(fileCount(), 2);
    }

    fs::path mFolder;
};

Scene sceneOf(const char* name, std::uint64_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    return makeScene(options);
}

ParticleView viewOf(const std::vector<double>& positions)
{
    return ParticleView::fromArray(positions.data(), positions.size() / 3);
}

TEST_F(NpzSearch, HasTheSameBytesForEveryDistribution)
{
    for (const PointSet& set : arraySets(Precision::kFloat)) {
        const SetView input(set, Form::kFloats);
        expectSame(input.view(), set.radius, set.name);
    }
}

// Many runs, rows of thousands, and rows that wait for others.
TEST_F(NpzSearch, HasTheSameBytesForScenesInAnyOrder)
{
    for (const char* const name : {"block", "clusters", "spray"}) {
        Scene scene = sceneOf(name, 60000);
        expectSame(viewOf(scene.positions), scene.suggestedRadius, name);
        std::vector<std::size_t> order(scene.positions.size() / 3);
        std::iota(order.begin(), order.end(), std::size_t(0));
        std::shuffle(order.begin(), order.end(), std::mt19937(1));
        std::vector<double> shuffled;
        for (const std::size_t i : order)
            shuffled.insert(shuffled.end(), &scene.positions[3 * i], &scene.positions[3 * i] + 3);
        shuffled[3 * 1000] = shuffled[3 * 1001] = std::numeric_limits<double>::quiet_NaN();
        shuffled[3 * 59999] = std::numeric_limits<double>::infinity();
        expectSame(viewOf(shuffled), scene.suggestedRadius, std::string(name) + " shuffled");
    }
}

// All rows of one point are longer than a run.
// Rows of several lattices, of which those of one are between those of another.
TEST_F(NpzSearch, HasTheSameBytesForRadiiOfParticles)
{
    constexpr std::size_t kCount = 20000;
    std::mt19937 random(5);
    std::uniform_real_distribution<> place(0, 1);
    std::vector<double> positions, radii;
    for (std::size_t i = 0; i < 3 * kCount; ++i) positions.push_back(place(random));
    for (std::size_t i = 0; i < kCount; ++i) radii.push_back(0.08 * std::exp2(-5 * place(random)));
    std::sort(positions.begin(), positions.end()); // a diagonal: numbered along space
    radii[7] = std::nan("");
    const ParticleView view = viewOf(positions);
    Radius radius;
    radius.ofQueries = radius.ofCandidates = {radii.data(), radii.size()};
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        radius.mode = mode;
        EXPECT_GT(SearchEngine().sort(view, view, radius).latticeCount(), 3u);
        SearchOptions search;
        for (const std::uint32_t nearest : {0u, 5u}) {
            search.nearest = nearest;
            search.includeSelf = nearest > 0;
            expectSame(view, radius, "mode " + std::to_string(static_cast<int>(mode)), search);
        }
    }
}

TEST_F(NpzSearch, HasTheSameBytesForLongRows)
{
    std::vector<double> positions(3 * 2000, 1.0);
    for (int k = 0; k < 3000; ++k) positions.insert(positions.end(), {2.0 + k, 1, 1});
    expectSame(viewOf(positions), 0.5, "coincident");
}

TEST_F(NpzSearch, WritesNothingIfTooManyRowsWouldWait)
{
    const Scene scene = sceneOf("block", 60000);
    SearchEngine builder;
    const SparseGrid grid = builder.buildGrid(viewOf(scene.positions), scene.suggestedRadius);
    EngineState engine;
    EXPECT_FALSE(searchToNpz(engine, grid, {}, options(ListValues::kConnectivity, 1 << 20)));
    EXPECT_EQ(fileCount(), 0);
    // A window of nothing says that the counts do not fit either, even if no row would wait.
    const double points[] = {0, 0, 0, 9, 9, 9};
    const SparseGrid two = builder.buildGrid(ParticleView::fromArray(points, 2), 1);
    EXPECT_FALSE(searchToNpz(engine, two, {}, options(ListValues::kConnectivity, 0)));
    EXPECT_EQ(fileCount(), 0);
    // What was expected to suffice may not: these are 2 MiB.
    OrderedSearch rows(engine, grid, {});
    EXPECT_GT(rows.windowRows(), 0u);
    EXPECT_NEAR(rows.expectedNeighbors(), 29, 3);
    class Nobody final : public RowRunConsumer {
        void take(const RowRun&) override {}
    } nobody;
    EXPECT_THROW(rows.run(2 << 20, nobody), WindowExceeded);
    EXPECT_EQ(rows.run(kMuch, nobody).pairCount(), rows.countPairs());
}

TEST_F(NpzSearch, StopsWhenAskedAndLeavesNothing)
{
    class StopLater final : public Progress {
    public:
        void update(const char* step, double fraction) override
        {
            EXPECT_STREQ(step, "search");
            if (fraction > 0.2) mStop = true;
        }
        bool cancelled() const override { return mStop; }

    private:
        std::atomic<bool> mStop{false};
    };
    const Scene scene = sceneOf("block", 200000);
    SearchEngine builder;
    const SparseGrid grid = builder.buildGrid(viewOf(scene.positions), scene.suggestedRadius);
    for (const int threads : {1, 4}) {
        runOnThreads(threads, [&] {
            StopLater progress;
            SearchOptions search;
            search.progress = &progress;
            EngineState engine;
            EXPECT_THROW(searchToNpz(engine, grid, search, options()), Cancelled);
            EXPECT_EQ(fileCount(), 0);
        });
    }
}

TEST_F(NpzSearch, WithoutRoomIsAnErrorAndLeavesNothing)
{
    const Scene scene = sceneOf("block", 200000); // 24 MB of indices, 6 of ones
    SearchEngine builder;
    const SparseGrid grid = builder.buildGrid(viewOf(scene.positions), scene.suggestedRadius);
    rlimit old{};
    ::getrlimit(RLIMIT_FSIZE, &old);
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    // In the first run, between, in the ones.
    for (const rlim_t bytes : {100000u, 12000000u, 26000000u}) {
        for (const int threads : {1, 4}) {
            runOnThreads(threads, [&] {
                const rlimit lower{bytes, old.rlim_max};
                ::setrlimit(RLIMIT_FSIZE, &lower);
                EngineState engine;
                EXPECT_THROW(searchToNpz(engine, grid, {}, options()), OutputError) << bytes;
                ::setrlimit(RLIMIT_FSIZE, &old);
                EXPECT_EQ(fileCount(), 0);
            });
        }
    }
    std::signal(SIGXFSZ, handler);
}

std::int64_t allocatedBytes(const OutputFile& file)
{
    struct stat status {};
    EXPECT_EQ(::stat(file.temporaryPath().c_str(), &status), 0);
    return std::int64_t(status.st_blocks) * 512;
}

// Runs that a test makes up.
RowRun runOf(std::uint64_t firstRow, const std::vector<std::uint32_t>& counts,
             const std::vector<const std::uint32_t*>& rows)
{
    return {0,
            firstRow,
            counts.size(),
            0,
            std::accumulate(counts.begin(), counts.end(), std::uint64_t(0)),
            counts.data(),
            rows.data()};
}

// Of lists without distances.
class NoGeometry final : public RowGeometry {
    double distance(std::size_t, std::size_t) const override { return 0; }
};

// Where the indices stand depends on whether they take 4 GiB, for most numbers of rows.
TEST_F(NpzSearch, StartsAgainIfTheNumberOfPairsWasExpectedWrongly)
{
    const std::vector<std::uint32_t> row = {3, 1}, counts = {2, 0, 0, 0, 0, 0, 0};
    const std::vector<const std::uint32_t*> rows = {row.data(), nullptr, nullptr, nullptr,
                                                    nullptr,    nullptr, nullptr};
    const CancelCheck cancel(nullptr, "test");
    const NoGeometry none;
    OutputFile file(path("a.npz"), {});
    NpzInOrder wrong(file, {7, 7}, std::uint64_t(1) << 31, {}, none, cancel);
    wrong.take(runOf(0, counts, rows));
    EXPECT_FALSE(wrong.finish(2));
    NpzInOrder right(file, {7, 7}, 1000, {}, none, cancel);
    right.take(runOf(0, counts, rows));
    EXPECT_LT(allocatedBytes(file), 4 << 20); // a small file reserves little, whatever was expected
    EXPECT_TRUE(right.finish(2));
    file.commit();
    class Rows final : public NpzRows {
        std::size_t size() const override { return 7; }
        std::uint64_t pairCount() const override { return 2; }
        std::uint32_t count(std::size_t row) const override { return row == 0 ? 2 : 0; }
        void copyRow(std::size_t row, std::uint32_t* out) const override
        {
            if (row == 0) out[0] = 3, out[1] = 1;
        }
        double distance(std::size_t, std::size_t) const override { return 0; }
    };
    writeNpzRows(path("b.npz"), Rows(), ListValues::kConnectivity, {}, nullptr);
    EXPECT_TRUE(contents(path("a.npz")) == contents(path("b.npz")));
    OutputFile lost(path("c.npz"), {});
    NpzInOrder few(lost, {8, 8}, 1000, {}, none, cancel);
    few.take(runOf(0, counts, rows));
    EXPECT_THROW(few.finish(2), OutputError);
}

TEST_F(NpzSearch, HasWideIndicesPast31BitsOfRows)
{
    const std::uint64_t rowCount = (std::uint64_t(1) << 31) + 5;
    const std::vector<std::uint32_t> row = {0x90000000u, 7}, counts = {2};
    const std::vector<const std::uint32_t*> rows = {row.data()};
    const CancelCheck cancel(nullptr, "test");
    OutputFile file(path("a.npz"), {});
    const NoGeometry none;
    NpzInOrder npz(file, {rowCount, rowCount}, 2, {}, none, cancel);
    npz.take(runOf(3, counts, rows));
    EXPECT_LT(allocatedBytes(file), 8 << 20); // the file is sparse
    const NpzLayout layout = layoutNpz({rowCount, rowCount}, 2, ListValues::kConnectivity);
    std::ifstream written(file.temporaryPath(), std::ios::binary);
    std::int64_t values[2] = {};
    written.seekg(static_cast<std::streamoff>(layout.members[NpzLayout::kIndices].valueOffset));
    written.read(reinterpret_cast<char*>(values), sizeof values);
    EXPECT_TRUE(written.good());
    EXPECT_EQ(values[0], 7);
    EXPECT_EQ(values[1], 0x90000000);
}

} // namespace
} // namespace vdb_nns::testing
