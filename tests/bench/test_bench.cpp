// The benchmark's own arithmetic: what a method double loses, invents and lists twice comes back as just that.
#include "bench/accuracy.h"
#include "bench/method_names.h"
#include "bench/report/bench_report.h"
#include "bench/studies/estimators.h"
#include "bench/studies/method_study.h"
#include "bench/truth.h"
#include "support/distributions.h"
#include "support/oracle.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace vdb_nns::cli {
namespace {

using testing::Lists;

struct Particles {
    std::vector<double> xyz;
    double radius = 0;
    Lists lists; // the oracle's
    ParticleView view() const { return ParticleView::fromArray(xyz.data(), xyz.size() / 3); }
};

Particles jitteredBlock()
{
    for (const testing::PointSet& set : testing::arraySets(testing::Precision::kDouble)) {
        if (set.name.find("block") == std::string::npos) continue;
        return {testing::doublesOf(set), set.radius, testing::oracleLists(set)};
    }
    throw std::logic_error("no block among the distributions");
}

// Rows as a method with one buffer for each query would leave them.
RowBuffers rowsOf(const Lists& lists)
{
    RowBuffers rows;
    for (std::size_t i = 0; i < lists.size(); ++i) {
        rows.places.push_back(
            {0, static_cast<std::uint32_t>(lists[i].size()), static_cast<std::uint32_t>(i)});
        rows.buffers.push_back(lists[i]);
    }
    return rows;
}

std::uint64_t pairsOf(const Lists& lists)
{
    std::uint64_t pairs = 0;
    for (const auto& row : lists) pairs += row.size();
    return pairs;
}

void erase(Lists& lists, std::uint32_t query, std::uint32_t other)
{
    auto& row = lists[query];
    row.erase(std::remove(row.begin(), row.end(), other), row.end());
}

AccuracyReport accuracyOf(const Lists& lists, const Particles& particles, TruthOptions options = {})
{
    const RowBuffers rows = rowsOf(lists);
    return checkAccuracy(rows, particles.view(), particles.radius,
                         findTruth(particles.view(), particles.radius, options));
}

// The first particle that is not a neighbor of `query`.
std::uint32_t strangerOf(const Lists& lists, std::uint32_t query)
{
    std::uint32_t other = 0;
    while (other == query || std::count(lists[query].begin(), lists[query].end(), other)) ++other;
    return other;
}

TEST(BenchTruth, IsTheOraclesOnEveryDistribution)
{
    for (const testing::PointSet& set : testing::arraySets(testing::Precision::kDouble)) {
        SCOPED_TRACE(set.name);
        const std::vector<double> xyz = testing::doublesOf(set);
        const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
        const Truth truth = findTruth(view, set.radius, {});
        EXPECT_TRUE(truth.complete);
        const Lists oracle = testing::oracleLists(set);
        ASSERT_EQ(truth.queries.size(), oracle.size());
        for (std::size_t i = 0; i < oracle.size(); ++i) {
            const auto row = truth.row(i);
            EXPECT_EQ(std::vector<std::uint32_t>(row.begin(), row.end()), oracle[i]) << "query " << i;
        }
    }
}

TEST(BenchTruth, ASampleHasTheSameRows)
{
    const Particles particles = jitteredBlock();
    TruthOptions options;
    options.sample = 10;
    const Truth truth = findTruth(particles.view(), particles.radius, options);
    EXPECT_FALSE(truth.complete);
    ASSERT_EQ(truth.queries.size(), 10u);
    EXPECT_EQ(std::set<std::uint32_t>(truth.queries.begin(), truth.queries.end()).size(), 10u);
    for (std::size_t k = 0; k < 10; ++k) {
        const auto row = truth.row(k);
        EXPECT_EQ(std::vector<std::uint32_t>(row.begin(), row.end()), particles.lists[truth.queries[k]]);
    }
    options.sample = 0;
    EXPECT_TRUE(findTruth(particles.view(), particles.radius, options).queries.empty());
}

TEST(BenchAccuracy, TrueListsAreExact)
{
    const Particles particles = jitteredBlock();
    const AccuracyReport report = accuracyOf(particles.lists, particles);
    EXPECT_EQ(report.wrong(), 0u);
    EXPECT_EQ(report.asymmetric, 0u);
    EXPECT_EQ(report.truePairs, pairsOf(particles.lists));
    EXPECT_EQ(report.countRmse, 0);
    EXPECT_EQ(report.densityMax, 0);
}

TEST(BenchAccuracy, LosingExactlyKPairsIsChartedAsLosingK)
{
    const Particles particles = jitteredBlock();
    Lists lists = particles.lists;
    std::uint64_t lost = 0;
    double squares = 0;
    for (std::uint32_t i = 0; i < 40; i += 2) { // one-way: i no longer lists j, j still lists i
        if (lists[i].empty() || lists[i].back() % 2 == 0) continue; // the mirror stays
        lists[i].pop_back();
        ++lost;
        squares += 1;
    }
    ASSERT_GT(lost, 3u);
    const AccuracyReport report = accuracyOf(lists, particles);
    EXPECT_EQ(report.missing, lost);
    EXPECT_EQ(report.extra, 0u);
    EXPECT_EQ(report.asymmetric, lost);
    EXPECT_DOUBLE_EQ(report.missingPerMillion(),
                     1e6 * static_cast<double>(lost) / static_cast<double>(pairsOf(particles.lists)));
    EXPECT_DOUBLE_EQ(report.countRmse, std::sqrt(squares / static_cast<double>(lists.size())));
    EXPECT_EQ(report.countMax, 1);
    EXPECT_GT(*report.densityMax, 0);
}

TEST(BenchAccuracy, PairsLostBothWaysAreSymmetric)
{
    const Particles particles = jitteredBlock();
    Lists lists = particles.lists;
    const std::uint32_t i = 7, j = lists[7].front();
    erase(lists, i, j);
    erase(lists, j, i);
    const AccuracyReport report = accuracyOf(lists, particles);
    EXPECT_EQ(report.missing, 2u);
    EXPECT_EQ(report.asymmetric, 0u);
}

TEST(BenchAccuracy, ExtraPairsDuplicatesAndSelfAreToldApart)
{
    const Particles particles = jitteredBlock();
    Lists lists = particles.lists;
    const std::uint32_t stranger = strangerOf(lists, 3);
    lists[3].push_back(stranger);         // extra, one-way
    lists[5].push_back(lists[5].front()); // twice
    lists[9].push_back(9);                // itself
    const AccuracyReport report = accuracyOf(lists, particles);
    EXPECT_EQ(report.missing, 0u);
    EXPECT_EQ(report.extra, 1u);
    EXPECT_EQ(report.duplicates, 2u);
    EXPECT_EQ(report.asymmetric, 1u);
    EXPECT_EQ(report.wrong(), 3u);
    // Beyond the radius nothing weighs; a name twice is no other density.
    EXPECT_EQ(report.densityMax, 0);
    const double distance = particles.view().distance(3, stranger);
    const double ulp = std::nextafter(particles.radius, 1e9) - particles.radius;
    EXPECT_NEAR(report.maxUlp / ((distance - particles.radius) / ulp), 1, 1e-6);
}

TEST(BenchAccuracy, DensityErrorIsTheWeightOfWhatIsMissing)
{
    const Particles particles = jitteredBlock();
    Lists lists = particles.lists;
    const std::uint32_t i = 11, j = lists[11].front();
    erase(lists, i, j);
    double density = 1;
    for (const std::uint32_t other : particles.lists[i])
        density += densityWeight(particles.view().distance(i, other), particles.radius);
    const double weight = densityWeight(particles.view().distance(i, j), particles.radius);
    EXPECT_NEAR(*accuracyOf(lists, particles).densityMax, weight / density, 1e-12);
}

TEST(BenchAccuracy, CountsAloneAreComparedAsCounts)
{
    const Particles particles = jitteredBlock();
    std::vector<std::uint32_t> counts;
    for (const auto& row : particles.lists) counts.push_back(static_cast<std::uint32_t>(row.size()));
    counts[4] -= 2;
    counts[8] += 3;
    const CountedNeighbors found(counts);
    const AccuracyReport report = checkAccuracy(found, particles.view(), particles.radius,
                                                findTruth(particles.view(), particles.radius, {}));
    EXPECT_EQ(report.missing, 2u);
    EXPECT_EQ(report.extra, 3u);
    EXPECT_FALSE(report.asymmetric.has_value());
    EXPECT_FALSE(report.densityMax.has_value());
    EXPECT_EQ(report.countMax, 3);
}

TEST(BenchAccuracy, ASampleSaysSoAndCountsItsOwnQueriesOnly)
{
    const Particles particles = jitteredBlock();
    Lists lists = particles.lists;
    for (auto& row : lists) {
        if (!row.empty()) row.pop_back();
    }
    TruthOptions options;
    options.sample = 16;
    const AccuracyReport report = accuracyOf(lists, particles, options);
    EXPECT_FALSE(report.complete);
    EXPECT_EQ(report.checkedQueries, 16u);
    EXPECT_LE(report.missing, 16u);
    EXPECT_GT(report.missing, 0u);
}

TEST(BenchAccuracy, ScaledCountsStandForTheTrueOnes)
{
    const Particles particles = jitteredBlock();
    Lists half = particles.lists;
    for (auto& row : half) row.resize(row.size() / 2);
    RowBuffers rows = rowsOf(half);
    rows.scale = 2;
    const AccuracyReport report = checkAccuracy(rows, particles.view(), particles.radius,
                                                findTruth(particles.view(), particles.radius, {}));
    EXPECT_LE(report.countMax, 1); // odd counts lose one
    EXPECT_GT(report.missing, 0u);
}

TEST(BenchMethods, NamesAreParsedAndRefused)
{
    EXPECT_EQ(parseMethod("ours-mask").encoding, Encoding::kMask);
    EXPECT_TRUE(parseMethod("ours-visit").visits);
    EXPECT_EQ(parseMethod("blocks32-index").blockLog2Cells, 5);
    EXPECT_EQ(parseMethod("nearest7").number, 7);
    EXPECT_EQ(parseMethod("ours-index@1").threads, 1);
    EXPECT_EQ(parseMethod("world-float").kind, MethodKind::kAblation);
    for (const char* name :
         {"", "ours", "ours-bits", "nearest", "nearest0", "nearest-3", "nearest3x", "sampled101",
          "ours-index@", "ours-index@0", "ours-index@2000", "ours-index@1x", "OURS-INDEX"}) {
        EXPECT_THROW(parseMethod(name), InvalidInput) << name;
    }
}

TEST(BenchMethods, TheDefaultSuitsTheMachineAndTheSize)
{
    const auto names = [](const MethodSuits& suits) {
        std::set<std::string> result;
        for (const MethodSpec& spec : parseMethods("", suits)) result.insert(spec.name);
        return result;
    };
    EXPECT_EQ(names({"", 1000}).count("brute-force"), 1u);
    EXPECT_EQ(names({"", 10'000'000}).count("brute-force"), 0u);
    EXPECT_EQ(names({"", 1000}).count("blocks-mask"), 0u);
    EXPECT_EQ(names({"sim", 1000}).count("blocks-mask"), 1u);
    EXPECT_EQ(names({"sim", 1000}).count("mapped-mask"), 0u);
    EXPECT_EQ(names({"cuda:0", 1000}).count("mapped-mask"), 1u);
    EXPECT_EQ(parseMethods("ours,ours-mask,ours", {}).size(), 4u); // none twice
}

BenchResult resultOf(MethodKind kind, std::uint64_t pairs, std::optional<std::uint64_t> checksum)
{
    BenchResult result;
    result.kind = kind;
    result.pairs = pairs;
    result.checksum = checksum;
    return result;
}

TEST(BenchResults, OnlyExactMethodsMustAgree)
{
    const BenchResult ours = resultOf(MethodKind::kEngine, 100, 7),
                      count = resultOf(MethodKind::kEngine, 100, {}),
                      peer = resultOf(MethodKind::kPeer, 98, {});
    EXPECT_EQ(firstThatDiffers({peer, ours, count}), nullptr);
    const std::vector<BenchResult> other = {ours, resultOf(MethodKind::kDevice, 100, 8)};
    EXPECT_EQ(firstThatDiffers(other), &other[1]);
    const std::vector<BenchResult> fewer = {ours, peer, resultOf(MethodKind::kEngine, 99, {})};
    EXPECT_EQ(firstThatDiffers(fewer), &fewer[2]);
}

TEST(BenchEstimators, NamesTakeNumbersWhereThatMakesSense)
{
    EXPECT_EQ(parseEstimators("paper:1e3,sampled:0.1,mask").size(), 3u);
    EXPECT_GT(parseEstimators("all").size(), 10u);
    for (const char* list :
         {"papers", "paper:0", "paper:x", "sampled:101", "fixed:3", "paper:", "paper:1e10"})
        EXPECT_THROW(parseEstimators(list), InvalidInput) << list;
}

} // namespace
} // namespace vdb_nns::cli
