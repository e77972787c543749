// The estimate: exact parts against brute force over cells and against the oracle, the expectation against a slow sum in
// double, corrections against exact counts; and what it is corrected by: countQueries() and the search of chosen cells.
#include "cpu/kernels.h"
#include "cpu/leaves_in_reach-inl.h"
#include "exact/exact_test.h"
#include "grid/lattice.h"
#include "lists/cell_candidates.h"
#include "lists/neighbor_lists_data.h"
#include "plan/overlap_table.h"
#include "plan/workload_cases.h"
#include "search/count_queries.h"
#include "search/leaf_tasks.h"
#include "search/thread_state.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/work_estimate.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

WorkEstimate estimateBy(const SparseGrid& grid, Estimator estimator, bool correctCrowding = true)
{
    EstimateOptions options;
    options.estimator = estimator;
    options.correctCrowding = correctCrowding;
    return estimateWork(grid, options);
}

// What each leaf asks for, from the cell of every particle and nothing else of the engine; pairs as the model expects.
std::vector<Work> slowWork(const SparseGrid& grid, const OverlapTable& overlap)
{
    const std::vector<Vec3i> cells = cellsOf(grid);
    std::map<Vec3i, std::uint64_t> count;
    for (const std::uint32_t number : grid.particleNumbers()) ++count[cells[number]];
    const int reach = grid.reach();
    std::vector<Work> leaves;
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        const SparseGrid::Leaf leaf = grid.leaf(l);
        Work work;
        for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
            const Vec3i& own = cells[grid.particleNumbers()[s]];
            std::uint64_t candidates = 0;
            double expected = -overlap.share(0, 0, 0);
            for (int dx = -reach; dx <= reach; ++dx) {
                for (int dy = -reach; dy <= reach; ++dy) {
                    for (int dz = -reach; dz <= reach; ++dz) {
                        const auto found = count.find({own[0] + dx, own[1] + dy, own[2] + dz});
                        if (found == count.end()) continue;
                        candidates += found->second;
                        expected += static_cast<double>(found->second) * overlap.share(dx, dy, dz);
                    }
                }
            }
            work += {1, expected, candidates, (candidates + 31) / 32 * 4};
        }
        leaves.push_back(work);
    }
    return leaves;
}

// What the search holds.
std::uint64_t maskBytesHeld(const SparseGrid& grid)
{
    SearchOptions options;
    options.encoding = Encoding::kMask;
    return SearchEngine().search(grid, options).data().rowBytes;
}

Work sumOf(const std::vector<Work>& leaves)
{
    Work sum;
    for (const Work& leaf : leaves) sum += leaf;
    return sum;
}

TEST(WorkEstimate, TestsBytesAndParticlesAreThoseOfEveryCell)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        const std::vector<Work> slow = slowWork(
            grid, OverlapTable::byQuadrature(radiusInCells(grid.lattice(), grid.radius()), grid.reach()));
        const WorkEstimate estimate = estimateBy(grid, Estimator::kExpected);
        ASSERT_EQ(estimate.leaves.size(), grid.leafCount());
        for (std::size_t l = 0; l < slow.size(); ++l) {
            EXPECT_EQ(estimate.leaves[l].particles, grid.leaf(l).particleCount) << l;
            EXPECT_EQ(estimate.leaves[l].candidateTests, slow[l].candidateTests) << l;
            EXPECT_EQ(estimate.leaves[l].maskBytes, slow[l].maskBytes) << l;
        }
        EXPECT_EQ(estimate.total.particles, grid.particleCount());
        EXPECT_EQ(estimate.total.candidateTests, countCandidateTests(grid));
        EXPECT_EQ(estimate.total.maskBytes, maskBytesHeld(grid));
        EXPECT_EQ(estimate.total.expectedPairs, sumOf(estimate.leaves).expectedPairs);
    });
}

double sumOf(const std::vector<float>& neighbors)
{
    double sum = 0;
    for (const float each : neighbors) sum += static_cast<double>(each);
    return sum;
}

// Two particles in a cell and one in the cell beside it: of the first two, each expects one particle of its own cell and one
// of the next, the third expects two of the next.
TEST(ExpectNeighbors, IsWorkedOutByHand)
{
    const double x[] = {0.25, 0.5, 0.5, kNan, 1, 1, 1.5, 0.5, 0.5, 0.75, 0.5, 0.5, 40.5, 0.5, 0.5};
    const SparseGrid grid = gridOf(ParticleView::fromArray(x, 5), 1, 1);
    const OverlapTable overlap = OverlapTable::byQuadrature(radiusInCells(grid.lattice(), grid.radius()), 1);
    const double own = overlap.share(0, 0, 0), next = overlap.share(1, 0, 0);
    ASSERT_GT(own, next);
    const double expected[] = {own + next, 0, 2 * next, own + next, 0};
    const std::vector<float> neighbors = expectNeighbors(grid);
    ASSERT_EQ(neighbors.size(), 5u);
    for (std::size_t i = 0; i < 5; ++i) EXPECT_NEAR(neighbors[i], expected[i], 1e-6) << i;
}

// 1e-6: estimateWork() sums the same floats in another order.
TEST(ExpectNeighbors, SumsUpToTheUncorrectedEstimate)
{
    forEachGrid([](const PointSet& set, const SparseGrid& grid) {
        EstimateOptions options;
        options.correctCrowding = false;
        options.monteCarloSamples = 1000;
        for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo}) {
            options.estimator = estimator;
            const std::vector<float> neighbors = expectNeighbors(grid, options);
            EXPECT_EQ(neighbors.size(), set.points.size());
            const double pairs = estimateWork(grid, options).total.expectedPairs;
            EXPECT_NEAR(sumOf(neighbors), pairs, 1e-6 * pairs) << estimatorName(estimator);
        }
        options.estimator = Estimator::kExpected;
        options.correctCrowding = true; // makes no difference
        EXPECT_NEAR(sumOf(expectNeighbors(grid, options)),
                    estimateBy(grid, Estimator::kExpected, false).total.expectedPairs,
                    1e-6 * sumOf(expectNeighbors(grid)));
    });
}

TEST(ExpectNeighbors, IsOfOneCellTheSameAndForAnyNumberOfThreads)
{
    const SceneGrid scene("clusters", 20000);
    const std::vector<Vec3i> cells = cellsOf(scene.grid);
    std::vector<float> first;
    for (const int threads : {1, 2, 4}) {
        std::vector<float> neighbors;
        runOnThreads(threads, [&] { neighbors = expectNeighbors(scene.grid); });
        if (threads == 1) first = neighbors;
        EXPECT_EQ(neighbors, first);
    }
    std::map<Vec3i, float> ofCell;
    for (std::size_t i = 0; i < first.size(); ++i)
        EXPECT_EQ(ofCell.emplace(cells[i], first[i]).first->second, first[i]);
}

TEST(ExpectNeighbors, OtherEstimatorsAreRefusedAndNothingHasNone)
{
    const SceneGrid scene("clusters", 1000);
    EstimateOptions options;
    for (const Estimator estimator : {Estimator::kSampled, Estimator::kCounted, Estimator::kFixed}) {
        options.estimator = estimator;
        EXPECT_THROW(expectNeighbors(scene.grid, options), InvalidInput) << estimatorName(estimator);
    }
    options.estimator = Estimator::kMonteCarlo;
    options.monteCarloSamples = 0;
    EXPECT_THROW(expectNeighbors(scene.grid, options), InvalidInput);
    EXPECT_TRUE(expectNeighbors(SparseGrid()).empty());
    const double nowhere[3] = {kNan, 0, 0};
    EXPECT_EQ(expectNeighbors(gridOf(ParticleView::fromArray(nowhere, 1), 1, 2)), std::vector<float>{0});
}

// 1e-5: the shares and sums of a cell are floats, with at most 343 terms, all positive but the query itself.
TEST(WorkEstimate, TheExpectationIsTheSumOfSharesOverCells)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        const std::vector<Work> slow = slowWork(
            grid, OverlapTable::byQuadrature(radiusInCells(grid.lattice(), grid.radius()), grid.reach()));
        const WorkEstimate estimate = estimateBy(grid, Estimator::kExpected, false);
        for (std::size_t l = 0; l < slow.size(); ++l) {
            const double tolerance = 1e-5 * slow[l].expectedPairs + 1e-6;
            EXPECT_NEAR(estimate.leaves[l].expectedPairs, slow[l].expectedPairs, tolerance) << l;
        }
        EXPECT_FALSE(estimate.corrected);
        EXPECT_EQ(estimate.countedQueries, 0u);
        EXPECT_EQ(estimate.correction, 1);
    });
}

// A share of 0.1 by 1e6 samples is right to 0.3 %; the shares of a cell's reach average out.
TEST(WorkEstimate, MonteCarloIsTheExpectationButForItsSamples)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 3)) {
        if (set.name != "block" && set.name != "clusters") continue;
        const SetView input(set, Form::kDoubles);
        for (int reach = 1; reach <= 3; ++reach) {
            const SparseGrid grid = gridOf(input.view(), set.radius, reach);
            EstimateOptions options;
            options.estimator = Estimator::kMonteCarlo;
            options.monteCarloSamples = 100'000;
            const WorkEstimate sampled = estimateWork(grid, options);
            const double expected = estimateBy(grid, Estimator::kExpected, false).total.expectedPairs;
            EXPECT_NEAR(sampled.total.expectedPairs, expected, 0.01 * expected) << set.name << " " << reach;
            EXPECT_NE(sampled.total.expectedPairs, expected);
            EXPECT_FALSE(sampled.corrected);
            options.seed = 2;
            EXPECT_NE(estimateWork(grid, options).total.expectedPairs, sampled.total.expectedPairs);
        }
    }
}

TEST(WorkEstimate, CountedIsTheTruthOfEveryLeaf)
{
    forEachGrid([](const PointSet& set, const SparseGrid& grid) {
        const Lists oracle = oracleLists(set);
        const WorkEstimate estimate = estimateBy(grid, Estimator::kCounted);
        for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
            const SparseGrid::Leaf leaf = grid.leaf(l);
            std::size_t pairs = 0;
            for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
                pairs += oracle[grid.particleNumbers()[s]].size();
            }
            EXPECT_EQ(estimate.leaves[l].expectedPairs, static_cast<double>(pairs)) << l;
        }
        EXPECT_EQ(estimate.countedQueries, grid.particleCount());
    });
}

TEST(WorkEstimate, FixedIsTheSameForEveryParticle)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        for (const double neighbors : {0.0, 29.5, 64.0}) {
            EstimateOptions options;
            options.estimator = Estimator::kFixed;
            options.fixedNeighbors = neighbors;
            for (const Work& leaf : estimateWork(grid, options).leaves) {
                EXPECT_EQ(leaf.expectedPairs, static_cast<double>(leaf.particles) * neighbors);
            }
        }
    });
}

// |estimate / truth - 1| over all pairs.
double errorOf(const WorkEstimate& estimate, const SparseGrid& grid)
{
    const double truth = estimateBy(grid, Estimator::kCounted).total.expectedPairs;
    return std::fabs(estimate.total.expectedPairs / truth - 1);
}

TEST(WorkEstimate, AFewQueriesCorrectARegularFluid)
{
    const SceneGrid block("block", 125000);
    const WorkEstimate estimate = estimateBy(block.grid, Estimator::kExpected);
    EXPECT_TRUE(estimate.corrected);
    EXPECT_GT(estimate.countedQueries, 0u);
    EXPECT_LT(estimate.countedQueries, 125000u / 20);
    EXPECT_NE(estimate.correction, 1);
    EXPECT_LT(estimate.margin, 0.02);
    EXPECT_LT(errorOf(estimate, block.grid), 0.01);
    EXPECT_GT(errorOf(estimateBy(block.grid, Estimator::kExpected, false), block.grid), 0.05);
}

// A part of the splash holds one pair of a thousand, and by its share of a sample it would be 16 % wrong.
TEST(WorkEstimate, SmallPartsAreRightToo)
{
    const SceneGrid scene("dam_break", 1000000);
    const WorkEstimate estimate = estimateBy(scene.grid, Estimator::kExpected);
    const WorkEstimate truth = estimateBy(scene.grid, Estimator::kCounted);
    std::map<Vec3i, std::array<double, 2>> parts; // counted and estimated pairs
    for (std::uint64_t l = 0; l < scene.grid.leafCount(); ++l) {
        const Vec3i& o = scene.grid.leaf(l).origin;
        std::array<double, 2>& part = parts[{o[0] >> 6, o[1] >> 6, o[2] >> 6}];
        part[0] += truth.leaves[l].expectedPairs;
        part[1] += estimate.leaves[l].expectedPairs;
    }
    ASSERT_GT(parts.size(), 2u);
    for (const auto& [origin, pairs] : parts) {
        if (pairs[0] < 1e4) continue;
        EXPECT_NEAR(pairs[1] / pairs[0], 1, 0.12) << origin[0] << " " << origin[1] << " " << origin[2];
    }
}

TEST(WorkEstimate, ASampleCorrectsWhereParticlesCrowd)
{
    const SceneGrid clusters("clusters", 40000);
    const WorkEstimate estimate = estimateBy(clusters.grid, Estimator::kExpected);
    EXPECT_TRUE(estimate.corrected);
    EXPECT_GT(estimate.countedQueries, 40000u / 200);
    EXPECT_GT(estimate.margin, 0);
    EXPECT_LT(errorOf(estimate, clusters.grid), 0.10);
    EXPECT_GT(errorOf(estimateBy(clusters.grid, Estimator::kExpected, false), clusters.grid), 0.10);
}

// Even of all queries a sample gives a part no more than a share of its own ratio, the rest being its parent's (so that
// parts with few samples are sane): parts need not be exact, and the total only as far as that averages out.
TEST(WorkEstimate, ASampleOfAllQueriesIsCloseToTheTruth)
{
    for (const char* name : {"block", "clusters", "spray"}) {
        const SceneGrid scene(name, 20000);
        EstimateOptions options;
        options.estimator = Estimator::kSampled;
        options.sampleFraction = 1;
        const WorkEstimate estimate = estimateWork(scene.grid, options);
        EXPECT_TRUE(estimate.corrected);
        EXPECT_GE(estimate.countedQueries, 20000u);
        EXPECT_LT(errorOf(estimate, scene.grid), 0.05) << name;
        const WorkEstimate truth = estimateBy(scene.grid, Estimator::kCounted);
        EXPECT_NEAR(estimate.correction,
                    truth.total.expectedPairs /
                        estimateBy(scene.grid, Estimator::kExpected, false).total.expectedPairs,
                    1e-3);
    }
}

// A small share of the queries of a small scene is next to none, so an estimate must not hang on them.
TEST(WorkEstimate, AFewSamplesDoNotSpoilASmallScene)
{
    for (const char* name : {"block", "spray", "clusters"}) {
        for (const std::uint64_t count : {120, 200, 500, 1000, 2000, 5000}) {
            const SceneGrid scene(name, count);
            const double plain = errorOf(estimateBy(scene.grid, Estimator::kExpected, false), scene.grid);
            const double corrected = errorOf(estimateBy(scene.grid, Estimator::kExpected), scene.grid);
            EXPECT_LT(corrected, std::max(1.1 * plain, 0.15)) << name << " " << count;
        }
    }
}

bool isSame(const Work& a, const Work& b)
{
    return a.particles == b.particles && a.expectedPairs == b.expectedPairs &&
           a.candidateTests == b.candidateTests && a.maskBytes == b.maskBytes;
}

TEST(WorkEstimate, IsTheSameForAnyNumberOfThreads)
{
    for (const char* name : {"block", "clusters"}) {
        const SceneGrid scene(name, 20000);
        for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo, Estimator::kSampled,
                                          Estimator::kCounted, Estimator::kFixed}) {
            SCOPED_TRACE(std::string(name) + " " + estimatorName(estimator));
            EstimateOptions options;
            options.estimator = estimator;
            options.monteCarloSamples = 1000;
            WorkEstimate first;
            for (const int threads : {1, 2, 4}) {
                WorkEstimate estimate;
                runOnThreads(threads, [&] { estimate = estimateWork(scene.grid, options); });
                if (threads == 1) first = estimate;
                ASSERT_EQ(estimate.leaves.size(), first.leaves.size());
                for (std::size_t l = 0; l < first.leaves.size(); ++l) {
                    EXPECT_TRUE(isSame(estimate.leaves[l], first.leaves[l])) << l;
                }
                EXPECT_TRUE(isSame(estimate.total, first.total));
                EXPECT_EQ(estimate.correction, first.correction);
                EXPECT_EQ(estimate.margin, first.margin);
                EXPECT_EQ(estimate.countedQueries, first.countedQueries);
            }
        }
    }
}

TEST(WorkEstimate, BadOptionsAreRefused)
{
    const double one[3] = {1, 2, 3};
    const SparseGrid grid = gridOf(ParticleView::fromArray(one, 1), 1, 1);
    for (const double fraction : {0.0, -0.5, 1.0001, kNan, kInf}) {
        EstimateOptions options;
        options.sampleFraction = fraction;
        EXPECT_THROW(estimateWork(grid, options), InvalidInput) << fraction;
    }
    for (const double neighbors : {-1.0, kNan, kInf}) {
        EstimateOptions options;
        options.fixedNeighbors = neighbors;
        EXPECT_THROW(estimateWork(grid, options), InvalidInput) << neighbors;
    }
    EstimateOptions options;
    options.monteCarloSamples = 0;
    EXPECT_THROW(estimateWork(grid, options), InvalidInput);
    for (const int unknown : {-1, 6, 77}) {
        options = {};
        options.estimator = static_cast<Estimator>(unknown);
        EXPECT_THROW(estimateWork(grid, options), InvalidInput);
    }
}

TEST(WorkEstimate, AnyShareAboveZeroIsASample)
{
    const SceneGrid scene("clusters", 3000);
    for (const double fraction : {1.0, 0.99, 0.5, 1e-3, 1e-9, 0x1p-32, 1e-20, 5e-324}) {
        for (const Estimator estimator : {Estimator::kExpected, Estimator::kSampled}) {
            EstimateOptions options;
            options.estimator = estimator;
            options.sampleFraction = fraction;
            const WorkEstimate estimate = estimateWork(scene.grid, options);
            EXPECT_TRUE(std::isfinite(estimate.total.expectedPairs)) << fraction;
            EXPECT_EQ(estimate.total.candidateTests, countCandidateTests(scene.grid)) << fraction;
        }
    }
}

TEST(WorkEstimate, NothingNeedsNothing)
{
    const double nowhere[3] = {kNan, 0, 0};
    for (const SparseGrid& grid : {SparseGrid(), gridOf(ParticleView::fromArray(nowhere, 1), 1, 2)}) {
        for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo, Estimator::kSampled,
                                          Estimator::kCounted, Estimator::kFixed}) {
            const WorkEstimate estimate = estimateBy(grid, estimator);
            EXPECT_TRUE(estimate.leaves.empty());
            EXPECT_TRUE(isSame(estimate.total, Work{}));
            EXPECT_EQ(estimate.estimator, estimator);
            EXPECT_EQ(estimate.countedQueries, 0u);
        }
    }
}

// Asks to stop at the n-th question.
class StopAfter final : public Progress {
public:
    explicit StopAfter(int questions) : mLeft(questions) {}
    void update(const char*, double) override {}
    bool cancelled() const override { return mLeft.fetch_sub(1) <= 0; }
    int left() const { return mLeft; }

private:
    mutable std::atomic<int> mLeft;
};

// A search with a smaller radius than its lattice: tests and masks are those of the cells, pairs those of the radius.
TEST(WorkEstimate, FollowsASmallerRadius)
{
    for (const char* name : {"block", "clusters"}) {
        const SceneGrid scene(name, 8000);
        SearchOptions counting;
        counting.encoding = Encoding::kNone;
        counting.radius = 0.7 * scene.grid.radius();
        const auto pairs =
            static_cast<double>(SearchEngine().search(scene.grid, counting).statistics().pairs);
        EstimateOptions options;
        options.radius = counting.radius;
        for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo, Estimator::kSampled,
                                          Estimator::kCounted, Estimator::kFixed, Estimator::kProbed}) {
            SCOPED_TRACE(std::string(name) + " " + estimatorName(estimator));
            options.estimator = estimator;
            options.monteCarloSamples = 100'000;
            const WorkEstimate full = estimateBy(scene.grid, estimator);
            const WorkEstimate estimate = estimateWork(scene.grid, options);
            EXPECT_EQ(full.radius, scene.grid.radius());
            EXPECT_EQ(estimate.radius, options.radius);
            EXPECT_EQ(estimate.total.candidateTests, full.total.candidateTests);
            EXPECT_EQ(estimate.total.maskBytes, full.total.maskBytes);
            if (estimator == Estimator::kFixed) continue;
            EXPECT_LT(estimate.total.expectedPairs, 0.7 * full.total.expectedPairs);
            if (estimator == Estimator::kExpected || estimator == Estimator::kSampled) {
                EXPECT_NEAR(estimate.total.expectedPairs / pairs, 1, 0.1);
            } else if (estimator == Estimator::kCounted) {
                EXPECT_EQ(estimate.total.expectedPairs, pairs);
            }
        }
        // The model itself, against the slow sum.
        options.estimator = Estimator::kExpected;
        options.correctCrowding = false;
        const OverlapTable overlap = OverlapTable::byQuadrature(
            radiusInCells(scene.grid.lattice(), options.radius), scene.grid.reach());
        const double slow = sumOf(slowWork(scene.grid, overlap)).expectedPairs;
        EXPECT_NEAR(estimateWork(scene.grid, options).total.expectedPairs, slow, 1e-5 * slow);
        EXPECT_NEAR(sumOf(expectNeighbors(scene.grid, options)), slow, 1e-5 * slow);
    }
}

TEST(WorkEstimate, IsStoppedByAProgress)
{
    const SceneGrid scene("clusters", 20000);
    for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo, Estimator::kSampled,
                                      Estimator::kCounted, Estimator::kFixed}) {
        EstimateOptions options;
        options.estimator = estimator;
        options.monteCarloSamples = 1000;
        StopAfter never(1'000'000);
        options.progress = &never;
        estimateWork(scene.grid, options);
        const int questions = 1'000'000 - never.left();
        ASSERT_GT(questions, 0);
        for (const int after : {0, questions / 2}) {
            StopAfter stop(after);
            options.progress = &stop;
            EXPECT_THROW(estimateWork(scene.grid, options), Cancelled)
                << estimatorName(estimator) << " " << after << " of " << questions;
        }
    }
}

// Up to `most` queries of one cell each, those of every cell.
std::vector<QueryRange> rangesOf(const SparseGrid& grid, std::uint32_t most)
{
    const SparseGridData& data = grid.data();
    std::vector<QueryRange> ranges;
    for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
        for (std::uint32_t c = data.leaves[l].firstCell; c < data.leaves[l + 1].firstCell; ++c) {
            for (std::uint32_t s = data.cellStart[c]; s < data.cellStart[c + 1]; s += most)
                ranges.push_back({l, s, std::min(s + most, data.cellStart[c + 1])});
        }
    }
    return ranges;
}

void expectOraclesCounts(const SparseGrid& grid, double radius, const std::vector<QueryRange>& ranges,
                         const Lists& oracle)
{
    const std::vector<std::uint32_t> counts =
        countQueries(grid.data(), radius, ranges, CancelCheck(nullptr, "count"));
    auto count = counts.begin();
    for (const QueryRange& range : ranges) {
        for (std::uint32_t s = range.firstSlot; s < range.endSlot; ++s, ++count) {
            ASSERT_NE(count, counts.end());
            const std::uint32_t number = grid.particleNumbers()[s];
            EXPECT_EQ(*count, oracle[number].size()) << "slot " << s << ", particle " << number;
        }
    }
    EXPECT_EQ(count, counts.end());
}

// Ranges in an order of no meaning, one of them twice.
TEST(CountQueries, EveryQueryHasTheOraclesCount)
{
    forEachGrid([&](const PointSet& set, const SparseGrid& grid) {
        const Lists oracle = oracleLists(set);
        for (const std::uint32_t most : {1, 3}) {
            std::vector<QueryRange> ranges = rangesOf(grid, most);
            std::shuffle(ranges.begin(), ranges.end(), std::mt19937(5));
            if (!ranges.empty()) ranges.push_back(ranges[0]);
            expectOraclesCounts(grid, set.radius, ranges, oracle);
        }
    });
}

TEST(CountQueries, VoxelsUnderEveryMapToo)
{
    for (const PointSet& set : gridSets(3)) {
        if (set.name.find("block") == std::string::npos && set.name.find("near") == std::string::npos)
            continue;
        const SetView input(set, Form::kVoxels);
        const SparseGrid grid = gridOf(input.view(), set.radius, 0);
        expectOraclesCounts(grid, set.radius, rangesOf(grid, 2), oracleLists(set));
        const SparseGrid wider = gridOf(input.view(), 3 * set.radius, 2);
        expectOraclesCounts(wider, set.radius, rangesOf(wider, 2), oracleLists(set));
    }
}

TEST(CountQueries, IsStoppedByAProgress)
{
    const double one[3] = {1, 2, 3};
    const SparseGrid grid = gridOf(ParticleView::fromArray(one, 1), 1, 1);
    StopAfter stop(0);
    EXPECT_THROW(countQueries(grid.data(), grid.radius(), {{0, 0, 1}}, CancelCheck(&stop, "count")),
                 Cancelled);
    EXPECT_TRUE(countQueries(grid.data(), grid.radius(), {}, CancelCheck(&stop, "count")).empty());
}

using Cells = std::array<std::uint64_t, 8>;

// Searches some cells of each leaf, and of those only the queries in [first, end) of the leaf's.
class CellSearcher {
public:
    CellSearcher(const SparseGrid& grid, SimdLevel level)
        : mGrid(grid),
          mKernels(kernelsFor(level).plain),
          mExact(grid.data().view, grid.radius()),
          mContext{blockViewOf(grid.data()),
                   makeFilterBounds(radiusInCells(grid.lattice(), grid.radius()), grid.reach(),
                                    grid.data().coordinateError),
                   pollOf(mCancel)}
    {
        mState.decideBy(mExact, mCancel);
        mPool.begin(std::uint64_t(1) << 26, grid.particleCount());
        mState.pool = &mPool;
        mState.sink.slotBase = 0;
        mState.sink.rowCount = counts.data();
        mState.sink.rowBegin = rows.data();
    }

    void run(bool lists, std::uint32_t leaf, std::uint32_t first, std::uint32_t end, const Cells& cells)
    {
        LeafNeighborhood neighborhood;
        mGrid.data().topology.neighborhoods({&mGrid.data().leafOrigins[leaf], 1}, &neighborhood);
        const SearchTask task{leaf, first, end, neighborhood.leaf, cells.data()};
        (lists ? mKernels.index : mKernels.count)(mContext, task, mState.exactPredicate(), mState.halo,
                                                  mState.sink, mState.statistics);
    }

    // The mask rows of the queries of one cell.
    const std::uint32_t* runMasks(std::uint32_t leaf, const LeafNeighborhood& neighborhood, const Cells& cell)
    {
        const LeafRecord* const record = mGrid.data().leaves.data() + leaf;
        const SearchTask task{leaf, record[0].firstSlot, record[1].firstSlot, neighborhood.leaf, cell.data()};
        mKernels.mask(mContext, task, mState.exactPredicate(), mState.halo, mState.sink, mState.statistics);
        return mState.sink.taskBegin;
    }

    const BlockView& block() const { return mContext.block; }

    void finish() { mState.finishRows(); }

    static constexpr std::uint32_t kUntouched = 0xdeadbeef;

private:
    SparseGrid mGrid;
    const RowKernels& mKernels;
    ExactTest mExact;
    CancelCheck mCancel{nullptr, "test"};
    SearchContext mContext;
    ChunkPool mPool{std::vector<PageBlock>()};
    ThreadState mState;

public:
    std::vector<std::uint32_t> counts = std::vector<std::uint32_t>(mGrid.particleCount() + 1, kUntouched);
    std::vector<std::uint32_t*> rows = std::vector<std::uint32_t*>(mGrid.particleCount() + 1);
};

// Of every leaf some cells, in each instruction set: their queries have the oracle's row, the others are left alone.
void expectChosenCells(const PointSet& set, const SparseGrid& grid, const Lists& oracle, SimdLevel level,
                       bool lists)
{
    CellSearcher searcher(grid, level);
    std::mt19937_64 random(11);
    std::vector<bool> chosen(grid.particleCount());
    const std::vector<Vec3i> cellOf = cellsOf(grid);
    for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
        const SparseGrid::Leaf leaf = grid.leaf(l);
        const auto first = static_cast<std::uint32_t>(leaf.firstSlot + random() % 2 * leaf.particleCount / 3);
        const auto end = static_cast<std::uint32_t>(leaf.firstSlot + leaf.particleCount);
        Cells cells; // also some that are empty
        for (std::uint64_t& word : cells) word = random() | (l % 3 ? 0 : random());
        for (std::uint32_t s = first; s < end; ++s) {
            const Vec3i& cell = cellOf[grid.particleNumbers()[s]];
            chosen[s] = cells[cell[0] & 7] >> ((cell[1] & 7) * 8 + (cell[2] & 7)) & 1;
        }
        searcher.run(lists, l, first, end, cells);
    }
    searcher.finish();
    for (std::uint32_t s = 0; s < grid.particleCount(); ++s) {
        const std::uint32_t count = searcher.counts[s];
        if (!chosen[s]) {
            EXPECT_EQ(count, CellSearcher::kUntouched) << set.name << " " << s;
            continue;
        }
        const std::vector<std::uint32_t>& truth = oracle[grid.particleNumbers()[s]];
        ASSERT_EQ(count, truth.size()) << set.name << " " << s << " " << simdLevelName(level);
        if (!lists) continue;
        std::vector<std::uint32_t> row(searcher.rows[s], searcher.rows[s] + count);
        std::sort(row.begin(), row.end());
        EXPECT_EQ(row, truth) << set.name << " " << s << " " << simdLevelName(level);
    }
}

TEST(SearchOfChosenCells, FindsTheirRowsAndNoOthers)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 4)) {
        const SetView input(set, Form::kDoubles);
        const Lists oracle = oracleLists(set);
        for (int reach = 1; reach <= 3; ++reach) {
            SCOPED_TRACE("reach " + std::to_string(reach));
            const SparseGrid grid = gridOf(input.view(), set.radius, reach);
            for (const SimdLevel level : simdLevels()) {
                for (const bool lists : {false, true}) expectChosenCells(set, grid, oracle, level, lists);
            }
        }
    }
}

// The rows of one cell are padded to words; a row's bits stand for the candidates in visiting order.
void expectMasksOfCell(const SparseGrid& grid, const Lists& oracle, CellSearcher& searcher, std::uint32_t l,
                       int x, int bit)
{
    LeafNeighborhood neighborhood;
    grid.data().topology.neighborhoods({&grid.data().leafOrigins[l], 1}, &neighborhood);
    Cells cell{};
    cell[static_cast<std::size_t>(x)] = std::uint64_t(1) << bit;
    const std::uint32_t* row = searcher.runMasks(l, neighborhood, cell);
    std::vector<std::uint32_t> candidates, queries;
    forEachCandidateRun(searcher.block(), neighborhood, x, bit >> 3, bit & 7,
                        [&](std::uint32_t begin, std::uint32_t end) {
                            for (; begin < end; ++begin) candidates.push_back(begin);
                        });
    const std::vector<Vec3i> cells = cellsOf(grid);
    const Vec3i origin = grid.leaf(l).origin;
    const Vec3i own{origin[0] + x, origin[1] + (bit >> 3), origin[2] + (bit & 7)};
    for (const std::uint32_t slot : candidates) {
        const std::uint32_t query = grid.particleNumbers()[slot];
        if (cells[query] != own) continue;
        std::vector<std::uint32_t> found;
        for (std::size_t c = 0; c < (candidates.size() + 31) / 32 * 32; ++c) {
            if (!(row[c / 32] >> c % 32 & 1)) continue;
            ASSERT_LT(c, candidates.size()) << "a bit in the padding";
            found.push_back(grid.particleNumbers()[candidates[c]]);
        }
        std::sort(found.begin(), found.end());
        EXPECT_EQ(found, oracle[query]) << query;
        EXPECT_EQ(searcher.counts[slot], found.size());
        row += (candidates.size() + 31) / 32;
    }
}

TEST(SearchOfChosenCells, MakesTheMasksOfOneCell)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 4)) {
        const SetView input(set, Form::kDoubles);
        const Lists oracle = oracleLists(set);
        for (int reach = 1; reach <= 3; ++reach) {
            SCOPED_TRACE(set.name + ", reach " + std::to_string(reach));
            const SparseGrid grid = gridOf(input.view(), set.radius, reach);
            for (const SimdLevel level : simdLevels()) {
                CellSearcher searcher(grid, level);
                std::uint64_t number = 0;
                for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
                    const SparseGrid::Leaf leaf = grid.leaf(l);
                    for (int x = 0; x < 8; ++x) {
                        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1) {
                            if (number++ % 5) continue; // of every fifth cell
                            expectMasksOfCell(grid, oracle, searcher, l, x, __builtin_ctzll(word));
                        }
                    }
                }
            }
        }
    }
}

// One cell at a time, and all together.
TEST(LeavesInReach, AreThoseThatHoldACellInReach)
{
    for (int reach = 1; reach <= 3; ++reach) {
        std::uint32_t all = 0;
        for (int cell = 0; cell < 512; ++cell) {
            const int own[3] = {cell >> 6, cell >> 3 & 7, cell & 7};
            std::uint32_t expected = 0;
            for (int n = 0; n < 27; ++n) {
                const int side[3] = {n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1};
                bool reached = true;
                for (int axis = 0; axis < 3; ++axis) {
                    if (side[axis] < 0) reached &= own[axis] - reach < 0;
                    if (side[axis] > 0) reached &= own[axis] + reach > 7;
                }
                expected |= std::uint32_t(reached) << n;
            }
            Cells cells{};
            cells[static_cast<std::size_t>(own[0])] = std::uint64_t(1) << (cell & 63);
            EXPECT_EQ(leavesInReach(cells.data(), reach), expected) << reach << " " << cell;
            all |= expected;
        }
        Cells cells;
        cells.fill(~std::uint64_t(0));
        EXPECT_EQ(leavesInReach(cells.data(), reach), all);
    }
}

// The sums of an estimate do not depend on the processor.
TEST(ExpectCells, IsTheSameWithEveryInstructionSet)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        const OverlapTable overlap =
            OverlapTable::byQuadrature(radiusInCells(grid.lattice(), grid.radius()), grid.reach());
        std::vector<float> shares;
        for (int x = -grid.reach(); x <= grid.reach(); ++x) {
            for (int y = -grid.reach(); y <= grid.reach(); ++y) {
                for (int z = -grid.reach(); z <= grid.reach(); ++z)
                    shares.push_back(static_cast<float>(overlap.share(x, y, z)));
            }
        }
        const BlockView block = blockViewOf(grid.data());
        CellCounts cube;
        for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
            LeafNeighborhood neighborhood;
            grid.data().topology.neighborhoods({&grid.data().leafOrigins[l], 1}, &neighborhood);
            std::array<float, 512> first{}, expected{};
            std::array<std::uint32_t, 512> firstCandidates{}, candidates{};
            kernelsFor(SimdLevel::kScalar)
                .expectCells(block, l, neighborhood.leaf, shares.data(), cube, first.data(),
                             firstCandidates.data());
            for (const SimdLevel level : simdLevels()) {
                kernelsFor(level).expectCells(block, l, neighborhood.leaf, shares.data(), cube,
                                              expected.data(), candidates.data());
                EXPECT_EQ(expected, first) << simdLevelName(level);
                EXPECT_EQ(candidates, firstCandidates) << simdLevelName(level);
                EXPECT_EQ(cube.touchedCount, 0u);
            }
        }
        for (const std::uint32_t count : cube.count) EXPECT_EQ(count, 0u);
    });
}

} // namespace

} // namespace vdb_nns::testing
