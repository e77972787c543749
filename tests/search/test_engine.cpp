// The engine object and the functions around it: frames that share memory, limits on memory, progress and cancelling,
// visitors, statistics, and what bad arguments get.
#include "agreement/point_views.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/progress.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <limits>
#include <map>
#include <mutex>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>

namespace vdb_nns::testing {

namespace {

// `count` particles in a cube, about 30 neighbors each at radius 2.
std::vector<double> blockOf(std::size_t count, std::uint64_t seed)
{
    std::mt19937_64 bits(seed);
    const double edge = std::cbrt(static_cast<double>(count));
    std::vector<double> xyz(3 * count);
    for (double& x : xyz) x = static_cast<double>(bits() >> 11) * 0x1p-53 * edge;
    return xyz;
}

ParticleView viewOf(const std::vector<double>& xyz)
{
    return ParticleView::fromArray(xyz.data(), xyz.size() / 3);
}

// Notes what it is told; cancels at the given call of cancelled(), or from when a step has come so far.
class Recorder final : public Progress {
public:
    int cancelAtCall = std::numeric_limits<int>::max();
    std::string cancelStep;

    void update(const char* step, double fraction) override
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        EXPECT_GE(fraction, 0);
        EXPECT_LE(fraction, 1);
        double& last = mLast[{step, std::this_thread::get_id()}];
        EXPECT_GE(fraction, last) << step;
        last = fraction;
        mFurthest[step] = std::max(mFurthest[step], fraction);
        if (step == cancelStep && fraction < 1) mCancelled = true;
    }
    bool cancelled() const override { return ++mCalls > cancelAtCall || mCancelled; }

    double furthest(const std::string& step) { return mFurthest.count(step) ? mFurthest[step] : -1; }
    int calls() const { return mCalls; }

private:
    std::mutex mMutex;
    std::map<std::pair<std::string, std::thread::id>, double> mLast;
    std::map<std::string, double> mFurthest;
    mutable std::atomic<int> mCalls{0};
    std::atomic<bool> mCancelled{false};
};

TEST(Engine, OlderFramesStayAsTheyWere)
{
    SearchEngine engine;
    const std::vector<PointSet> frames = arraySets(Precision::kDouble);
    std::vector<std::unique_ptr<SetView>> inputs;
    std::vector<NeighborLists> held;
    std::vector<Lists> rows;
    for (std::size_t f = 0; f < frames.size(); ++f) {
        inputs.push_back(std::make_unique<SetView>(frames[f], Form::kDoubles));
        SearchOptions options;
        options.encoding = f % 2 ? Encoding::kMask : Encoding::kIndex;
        options.cellSize = 1.0 / (1 + static_cast<int>(f) % 3);
        NeighborLists lists = engine.findNeighbors(inputs[f]->view(), frames[f].radius, options);
        EXPECT_TRUE(sameLists(lists, oracleLists(frames[f]), frames[f]));
        if (f % 3 == 2) continue; // let go of some: their memory goes to the frames after
        rows.push_back(decoded(lists));
        held.push_back(lists);
    }
    for (std::size_t h = 0; h < held.size(); ++h) EXPECT_EQ(decoded(held[h]), rows[h]);
}

TEST(Engine, MemoryOfReleasedFramesIsUsedAgain)
{
    runOnThreads(1, [] {
        SearchEngine engine;
        const std::vector<double> xyz = blockOf(5000, 1);
        NeighborLists lists = engine.findNeighbors(viewOf(xyz), 2);
        const Lists rows = decoded(lists);
        const std::uint32_t *const numbers = lists.grid().particleNumbers().data(), *const row =
                                                                                        lists.indices(0)
                                                                                            .data();
        lists = NeighborLists();
        lists = engine.findNeighbors(viewOf(xyz), 2);
        EXPECT_EQ(lists.grid().particleNumbers().data(), numbers);
        EXPECT_EQ(lists.indices(0).data(), row);
        const NeighborLists other = engine.findNeighbors(viewOf(xyz), 2);
        EXPECT_NE(other.grid().particleNumbers().data(), numbers);
        EXPECT_NE(other.indices(0).data(), row);
        EXPECT_EQ(decoded(lists), rows);
        EXPECT_EQ(decoded(other), rows);
    });
}

TEST(Engine, AGridServesSeveralSearches)
{
    SearchEngine engine, another;
    const std::vector<double> xyz = blockOf(3000, 2);
    const SparseGrid grid = engine.buildGrid(viewOf(xyz), 2);
    const NeighborLists first = engine.search(grid);
    SearchOptions options;
    options.encoding = Encoding::kMask;
    const NeighborLists second = engine.search(grid, options), third = another.search(grid);
    EXPECT_EQ(decoded(first), decoded(second));
    EXPECT_EQ(decoded(first), decoded(third));
    engine.buildGrid(viewOf(xyz), 1); // another grid leaves this one alone
    EXPECT_EQ(decoded(engine.search(grid)), decoded(third));
}

TEST(Engine, BadArgumentsAreRefused)
{
    SearchEngine engine;
    const double place[3] = {0, 0, 0};
    const ParticleView view = ParticleView::fromArray(place, 1);
    const double inf = std::numeric_limits<double>::infinity();
    for (const double radius : {0.0, -0.0, -1.0, inf, -inf, std::nan("")}) {
        EXPECT_THROW(engine.buildGrid(view, radius), InvalidInput) << radius;
        EXPECT_THROW(findNeighbors(view, radius), InvalidInput) << radius;
        EXPECT_THROW(countNeighbors(view, radius), InvalidInput) << radius;
    }
    const SparseGrid grid = engine.buildGrid(view, 1);
    const NeighborVisitor nobody = [](std::uint32_t, Span<const std::uint32_t>, Span<const double>) {};
    for (const int reach : {-1, 4, 1000}) {
        SearchOptions options;
        options.cellSize = 1.0 / reach;
        EXPECT_THROW(engine.buildGrid(view, 1, options), InvalidInput) << reach;
        EXPECT_THROW(visitNeighbors(view, 1, nobody, options), InvalidInput) << reach;
    }
    for (int level = static_cast<int>(bestSimdLevel()) + 1; level < static_cast<int>(SimdLevel::kBest);
         ++level) {
        SearchOptions options;
        options.simd = static_cast<SimdLevel>(level);
        EXPECT_THROW(engine.buildGrid(view, 1, options), InvalidInput);
        EXPECT_THROW(engine.search(grid, options), InvalidInput);
        EXPECT_THROW(engine.visit(grid, nobody, options), InvalidInput);
    }
    for (const int value : {-1, 3, 77}) {
        SearchOptions options;
        options.encoding = static_cast<Encoding>(value);
        EXPECT_THROW(engine.buildGrid(view, 1, options), InvalidInput) << value;
        EXPECT_THROW(engine.search(grid, options), InvalidInput) << value;
        EXPECT_THROW(engine.visit(grid, nobody, options), InvalidInput) << value;
        options = {};
        options.nonfinite = static_cast<NonFinite>(value);
        EXPECT_THROW(engine.buildGrid(view, 1, options), InvalidInput) << value;
        options = {};
        options.simd = static_cast<SimdLevel>(value < 0 ? value : value + 2);
        EXPECT_THROW(engine.search(grid, options), InvalidInput) << value;
    }
    EXPECT_EQ(engine.search(SparseGrid()).pairCount(), 0u); // an empty grid
    EXPECT_NO_THROW(engine.visit(SparseGrid(), nobody));
    EXPECT_EQ(engine.search(grid).pairCount(), 0u); // and the engine still works
}

TEST(Engine, StatisticsTellWhatRan)
{
    const std::vector<double> xyz = blockOf(2000, 3);
    SearchEngine engine;
    for (const SimdLevel simd : simdLevels()) {
        SearchOptions options;
        options.simd = simd;
        const NeighborLists lists = engine.findNeighbors(viewOf(xyz), 2, options);
        const SearchStatistics& statistics = engine.statistics();
        EXPECT_EQ(statistics.simd, simd);
        EXPECT_GT(statistics.gridSeconds, 0);
        EXPECT_GT(statistics.searchSeconds, 0);
        EXPECT_GE(countCandidateTests(lists.grid()), lists.pairCount() + lists.grid().particleCount());
        EXPECT_LE(statistics.exactPairs, statistics.doublePairs);
    }
    const PointSet ties = arraySets(Precision::kDouble)[4];
    const SetView input(ties, Form::kDoubles);
    std::uint64_t atRadius = 0;
    for (std::size_t i = 0; i < ties.points.size(); ++i) {
        for (std::size_t j = 0; j < ties.points.size(); ++j) {
            atRadius += input.view().distance(i, j) == ties.radius;
        }
    }
    engine.findNeighbors(input.view(), ties.radius);
    EXPECT_EQ(engine.statistics().exactPairs, atRadius);
    EXPECT_GT(atRadius, 1000u);
    engine.findNeighbors(ParticleView(), 1);
    EXPECT_EQ(engine.statistics().doublePairs, 0u);
}

TEST(Engine, TheFreeFunctionsAgree)
{
    const PointSet set = arraySets(Precision::kDouble)[5];
    const SetView input(set, Form::kDoubles);
    const Lists oracle = oracleLists(set);
    EXPECT_TRUE(sameLists(findNeighbors(input.view(), set.radius), oracle, set));
    EXPECT_TRUE(sameCounts(countNeighbors(input.view(), set.radius), oracle));
    std::mutex mutex;
    Lists visited(set.points.size());
    visitNeighbors(input.view(), set.radius,
                   [&](std::uint32_t query, Span<const std::uint32_t> row, Span<const double> distances) {
                       const std::lock_guard<std::mutex> lock(mutex);
                       visited[query].assign(row.begin(), row.end());
                       for (std::size_t k = 0; k < row.size(); ++k) {
                           EXPECT_EQ(distances[k], input.view().distance(query, row[k]));
                       }
                   });
    EXPECT_TRUE(sameLists(visited, oracle, set));
}

TEST(Engine, AVisitorIsHandedLongRowsToo)
{
    // 3000 at one place: more rows than the visitor's buffer holds at a time.
    const std::vector<double> xyz(9000, 0.5);
    std::atomic<std::uint64_t> pairs{0}, queries{0};
    visitNeighbors(viewOf(xyz), 1,
                   [&](std::uint32_t query, Span<const std::uint32_t> row, Span<const double> distances) {
                       ++queries;
                       for (std::size_t k = 0; k < row.size(); ++k) {
                           pairs += row[k] == k + (k >= query) && distances[k] == 0;
                       }
                   });
    EXPECT_EQ(queries, 3000u);
    EXPECT_EQ(pairs, 3000u * 2999u);
}

TEST(Engine, ExceptionsOfVisitorsComeThrough)
{
    const std::vector<double> xyz = blockOf(20000, 4);
    SearchEngine engine;
    const SparseGrid grid = engine.buildGrid(viewOf(xyz), 2);
    const auto angry = [](std::uint32_t query, Span<const std::uint32_t>, Span<const double>) {
        if (query == 12345) throw std::out_of_range("enough");
    };
    EXPECT_THROW(engine.visit(grid, angry), std::out_of_range);
    EXPECT_EQ(engine.search(grid).checksum(), findNeighbors(viewOf(xyz), 2).checksum());
    std::atomic<int> visits{0};
    engine.visit(grid, [&](std::uint32_t, Span<const std::uint32_t>, Span<const double>) { ++visits; });
    EXPECT_EQ(visits, 20000);
}

// Searches that must be refused; returns the error. The engine must be of use afterwards.
CapacityError refusal(const ParticleView& view, double radius, Encoding encoding, std::uint64_t bytes)
{
    SearchEngine engine;
    SearchOptions options;
    options.encoding = encoding;
    const SparseGrid grid = engine.buildGrid(view, radius, options);
    options.hostMemoryBytes = bytes;
    try {
        engine.search(grid, options);
    } catch (const CapacityError& error) {
        EXPECT_GT(error.neededBytes(), error.allowedBytes());
        EXPECT_LE(error.allowedBytes(), bytes);
        EXPECT_NE(std::string(error.what()).find(std::to_string(error.neededBytes())), std::string::npos);
        EXPECT_NE(std::string(error.what()).find(std::to_string(error.allowedBytes())), std::string::npos);
        const double pair[6] = {0, 0, 0, 1, 0, 0};
        EXPECT_EQ(engine.findNeighbors(ParticleView::fromArray(pair, 2), 1).pairCount(), 2u);
        return error;
    }
    ADD_FAILURE() << "lists fitted into " << bytes << " bytes";
    return CapacityError("", 0, 0);
}

TEST(Engine, ListsThatDoNotFitAreRefused)
{
    const std::vector<double> xyz = blockOf(30000, 5);
    const NeighborLists fits = findNeighbors(viewOf(xyz), 2);
    const std::uint64_t pairBytes = 4 * fits.pairCount(), gridBytes = fits.grid().bytes();
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        for (const std::uint64_t bytes : {std::uint64_t(1), gridBytes, gridBytes + 700000}) {
            const CapacityError error = refusal(viewOf(xyz), 2, encoding, bytes);
            // Never more than the truth.
            EXPECT_TRUE(encoding == Encoding::kMask || error.neededBytes() <= pairBytes);
        }
        SearchOptions options;
        options.encoding = encoding;
        options.hostMemoryBytes = 2 * (gridBytes + fits.bytes());
        EXPECT_EQ(findNeighbors(viewOf(xyz), 2, options).checksum(), fits.checksum());
    }
}

TEST(Engine, ManyAtOnePlaceAreRefusedWithTheNumberOfBytes)
{
    constexpr std::uint64_t kMany = 20000;
    const std::vector<double> xyz(3 * kMany, -7.25);
    EXPECT_EQ(refusal(viewOf(xyz), 1, Encoding::kIndex, 500000000).neededBytes(), 4 * kMany * (kMany - 1));
    EXPECT_EQ(refusal(viewOf(xyz), 1, Encoding::kMask, 40000000).neededBytes(), kMany * kMany / 8);
    EXPECT_EQ(countNeighbors(viewOf(xyz), 1), std::vector<std::uint32_t>(kMany, kMany - 1));
    SearchOptions options;
    options.encoding = Encoding::kMask;
    options.hostMemoryBytes = 200000000;
    EXPECT_EQ(findNeighbors(viewOf(xyz), 1, options).pairCount(), kMany * (kMany - 1));
}

TEST(Engine, ACrowdThatNoProbeMeetsIsRefusedAllTheSame)
{
    // Lone particles before and after a crowd, in the order of the grid.
    for (const int before : {30000, 30400, 30900}) {
        std::vector<double> xyz;
        for (int i = 0; i < 61000; ++i) {
            const double at = i < before         ? -10.0 * (before - i)
                              : i < before + 900 ? 0.5
                                                 : 10.0 * (i - before);
            xyz.insert(xyz.end(), {at, 0.5, 0.5});
        }
        const SparseGrid grid = SearchEngine().buildGrid(viewOf(xyz), 1);
        refusal(viewOf(xyz), 1, Encoding::kIndex, grid.bytes() + 12 * 61000 + 1500000);
    }
}

TEST(Engine, ProgressReachesTheEnd)
{
    const std::vector<double> xyz = blockOf(60000, 6);
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
        Recorder recorder;
        SearchOptions options;
        options.encoding = encoding;
        options.progress = &recorder;
        findNeighbors(viewOf(xyz), 2, options);
        EXPECT_EQ(recorder.furthest("grid"), 1);
        EXPECT_EQ(recorder.furthest("search"), 1);
    }
    Recorder recorder;
    SearchOptions options;
    options.progress = &recorder;
    visitNeighbors(
        viewOf(xyz), 2, [](std::uint32_t, Span<const std::uint32_t>, Span<const double>) {}, options);
    EXPECT_EQ(recorder.furthest("search"), 1);
}

TEST(Engine, CancellingAtAnyTimeLeavesTheEngineUsable)
{
    const std::vector<double> xyz = blockOf(60000, 7);
    const std::uint64_t checksum = findNeighbors(viewOf(xyz), 2).checksum();
    SearchEngine engine;
    Recorder whole;
    SearchOptions options;
    options.progress = &whole;
    engine.findNeighbors(viewOf(xyz), 2, options);
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
        options.encoding = encoding;
        for (const int call : {0, 1, 2, 3, 5, 8, whole.calls() / 2}) {
            Recorder recorder;
            recorder.cancelAtCall = call;
            options.progress = &recorder;
            EXPECT_THROW(engine.findNeighbors(viewOf(xyz), 2, options), Cancelled) << call;
            EXPECT_THROW(visitNeighbors(
                             viewOf(xyz), 2, [](auto, auto, auto) {}, options),
                         Cancelled)
                << call;
        }
        EXPECT_EQ(engine.findNeighbors(viewOf(xyz), 2).checksum(), checksum);
    }
}

TEST(Engine, CancellingFromAWorkerStopsEachStep)
{
    const std::vector<double> xyz = blockOf(60000, 8);
    SearchEngine engine;
    for (const std::string step : {"grid", "search"}) {
        runOnThreads(4, [&] {
            Recorder recorder;
            recorder.cancelStep = step;
            SearchOptions options;
            options.progress = &recorder;
            try {
                engine.findNeighbors(viewOf(xyz), 2, options);
                ADD_FAILURE() << "not cancelled in step " << step;
            } catch (const Cancelled& error) {
                EXPECT_NE(std::string(error.what()).find(step), std::string::npos) << error.what();
            }
            EXPECT_LT(recorder.furthest(step), 1);
        });
    }
    EXPECT_EQ(engine.findNeighbors(viewOf(xyz), 2).pairCount(), findNeighbors(viewOf(xyz), 2).pairCount());
}

} // namespace

} // namespace vdb_nns::testing
