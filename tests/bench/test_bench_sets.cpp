// Searches of sets in bench: their truth is the oracle's, methods that have such a search find it, and the
// studies of radii and of the nearest have no wrong pair of ours.
#include "bench/accuracy.h"
#include "bench/method_names.h"
#include "bench/methods/other_methods.h"
#include "bench/methods/set_methods.h"
#include "bench/report/set_report.h"
#include "bench/stability/cases.h"
#include "bench/studies/radii_points.h"
#include "bench/studies/set_study.h"
#include "bench/truth.h"
#include "numbers.h"
#include "support/set_oracle.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <limits>
#include <memory>
#include <set>
#include <string>
#include <vector>

namespace vdb_nns::cli {
namespace {

using testing::OracleMode;
using testing::SetProblem;

double uniform(std::uint64_t index)
{
    return static_cast<double>(mix64(index * 0x9e3779b97f4a7c15ull) >> 11) * 0x1p-53;
}

// A search of two sets and the same for the oracle; owns what the search views.
struct Problem {
    std::vector<double> queryXyz, xyz;
    std::vector<double> queryRadii, radii;
    std::vector<std::uint8_t> queryChosen, chosen;
    SetSearch search;
    SetProblem oracle;

    Problem(const Problem&) = delete;
    Problem& operator=(const Problem&) = delete;

    Problem(RadiusMode mode, bool areTwo, bool hasRoles, bool hasRadii, std::uint32_t nearest)
    {
        for (std::uint64_t k = 0; k < 3 * 400; ++k) xyz.push_back(uniform(k));
        for (std::uint64_t k = 0; k < 3 * 150; ++k) queryXyz.push_back(areTwo ? uniform(5000 + k) : 0);
        const ParticleView view = ParticleView::fromArray(xyz.data(), 400);
        const ParticleView queries = areTwo ? ParticleView::fromArray(queryXyz.data(), 150) : view;
        for (std::size_t i = 0; i < queries.size(); ++i) {
            queryRadii.push_back(radiusOf(i));
            queryChosen.push_back(i % 3 != 1);
        }
        for (std::size_t j = 0; j < 400; ++j) {
            radii.push_back(radiusOf(j));
            chosen.push_back(j % 4 != 2);
        }
        search.queries = queries;
        search.candidates = view;
        if (hasRoles) {
            search.queries.chosen = {queryChosen.data(), queryChosen.size()};
            search.candidates.chosen = {chosen.data(), chosen.size()};
        }
        search.radius = 0.17;
        search.radius.mode = mode;
        if (hasRadii && mode != RadiusMode::kScatter)
            search.radius.ofQueries = {queryRadii.data(), queryRadii.size()};
        if (hasRadii && mode != RadiusMode::kGather)
            search.radius.ofCandidates = {radii.data(), radii.size()};
        search.nearest = nearest;
        describe(hasRoles, hasRadii);
    }

    std::vector<std::vector<std::uint32_t>> answer() const { return testing::setOracle(oracle).byNumber; }

private:
    static double radiusOf(std::size_t i)
    {
        constexpr double kBad[] = {std::numeric_limits<double>::quiet_NaN(), 0, -0.2,
                                   std::numeric_limits<double>::infinity()};
        return i % 10 == 7 ? kBad[i / 10 % 4] : 0.02 + 0.2 * uniform(900 + i);
    }

    static testing::OracleSet setOf(const ParticleSet& set, Span<const double> radii)
    {
        testing::OracleSet result;
        for (std::size_t i = 0; i < set.view.size(); ++i) {
            const Vec3d at = set.view.worldPosition(i);
            result.points.push_back({{0, 0, 0}, {at[0], at[1], at[2]}});
        }
        result.chosen.assign(set.chosen.begin(), set.chosen.end());
        result.radii.assign(radii.begin(), radii.end());
        return result;
    }

    void describe(bool hasRoles, bool hasRadii)
    {
        oracle.queries = setOf(search.queries, hasRadii ? search.radius.ofQueries : Span<const double>());
        oracle.candidates =
            setOf(search.candidates, hasRadii ? search.radius.ofCandidates : Span<const double>());
        if (!hasRoles) oracle.queries.chosen = oracle.candidates.chosen = {};
        oracle.areSame = search.isOneSet();
        oracle.radius = search.radius.value;
        oracle.mode = search.radius.mode == RadiusMode::kGather    ? OracleMode::kGather
                      : search.radius.mode == RadiusMode::kScatter ? OracleMode::kScatter
                                                                   : OracleMode::kSymmetric;
        oracle.nearest = search.nearest;
    }
};

// Every combination.
template <typename Check>
void forProblems(const Check& check)
{
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        for (int bits = 0; bits < 8; ++bits) {
            for (const std::uint32_t nearest : {0u, 4u}) {
                const Problem problem(mode, bits & 1, bits & 2, bits & 4, nearest);
                SCOPED_TRACE("mode " + std::to_string(static_cast<int>(mode)) + ", bits " +
                             std::to_string(bits) + ", nearest " + std::to_string(nearest));
                check(problem);
            }
        }
    }
}

TEST(BenchSetTruth, IsTheOracles)
{
    std::uint64_t pairs = 0;
    forProblems([&](const Problem& problem) {
        const Truth truth = findTruth(problem.search, {});
        const auto answer = problem.answer();
        EXPECT_TRUE(truth.complete);
        ASSERT_EQ(truth.queries.size(), answer.size());
        for (std::size_t i = 0; i < answer.size(); ++i) {
            const auto row = truth.row(i);
            ASSERT_EQ(std::vector<std::uint32_t>(row.begin(), row.end()), answer[i]) << "query " << i;
        }
        TruthOptions some;
        some.sample = 20;
        const Truth sample = findTruth(problem.search, some);
        ASSERT_EQ(sample.queries.size(), 20u);
        EXPECT_FALSE(sample.complete);
        for (std::size_t k = 0; k < 20; ++k) {
            const auto row = sample.row(k);
            ASSERT_EQ(std::vector<std::uint32_t>(row.begin(), row.end()), answer[sample.queries[k]]);
        }
        pairs += truth.pairs();
    });
    EXPECT_GT(pairs, 10'000u);
    TruthOptions none;
    none.sample = 0;
    EXPECT_TRUE(findTruth(Problem(RadiusMode::kGather, false, false, true, 0).search, none).queries.empty());
}

// Radii that are bad count for peers as they stand, so these are left out there.
void makeGood(Problem& problem)
{
    for (auto* radii : {&problem.queryRadii, &problem.radii}) {
        for (double& r : *radii) r = r > 0 && r < 1 ? r : 0.1;
    }
}

TEST(BenchSetMethods, FindWhatTheTruthHas)
{
    std::vector<MethodSpec> specs;
    for (const char* name : {"ours-index", "ours-mask", "ours-count", "ours-visit", "openvdb",
                             "nanoflann-double", "brute-force"}) {
        if (missingPeer(name).empty()) specs.push_back(parseMethod(name));
    }
    ProgressPrinter silent(ProgressMode::kNever);
    for (const MethodSpec& spec : specs) {
        SCOPED_TRACE(spec.name);
        const std::unique_ptr<Method> method = makeMethod(spec, {}); // one for all: nothing is left over
        std::size_t searches = 0;
        for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
            for (int bits = 0; bits < 16; ++bits) {
                Problem problem(mode, bits & 1, bits & 2, bits & 4, bits & 8 ? 4 : 0);
                if (spec.kind == MethodKind::kPeer) makeGood(problem);
                if (!missingSearch(spec, problem.search).empty()) continue;
                ++searches;
                const MethodRun run = method->runSets(problem.search, {silent, 0, 1});
                const Truth truth = findTruth(problem.search, {});
                const WrongPairs wrong = findWrongPairs(method->found(), truth);
                EXPECT_EQ(wrong.wrong(), 0u) << "mode " << static_cast<int>(mode) << ", bits " << bits;
                EXPECT_EQ(wrong.checkedQueries, problem.search.queries.view.size());
                EXPECT_EQ(run.pairs, truth.pairs());
            }
        }
        const bool hasAll = spec.family == "brute-force" || spec.isExact();
        EXPECT_EQ(searches, spec.name == "ours-mask"   ? 24u
                            : hasAll                   ? 48u
                            : spec.family == "openvdb" ? 16u
                                                       : 32u);
    }
}

TEST(BenchSetMethods, OthersRefuseSearchesThatTheyHaveNot)
{
    const Problem problem(RadiusMode::kGather, true, false, true, 0);
    ProgressPrinter silent(ProgressMode::kNever);
    for (const char* name : {"world-double", "nearest8", "codec8"}) {
        EXPECT_NE(missingSearch(parseMethod(name), problem.search), "") << name;
        EXPECT_THROW(makeMethod(parseMethod(name), {})->runSets(problem.search, {silent, 0, 1}),
                     std::logic_error)
            << name;
        EXPECT_EQ(missingSearch(parseMethod(name), {problem.search.candidates.view, 0.1}), "") << name;
    }
}

TEST(BenchSetMethods, FilteringTheLargestIsRightBarRounding)
{
    const auto method = makeFilteredMethod({});
    ProgressPrinter silent(ProgressMode::kNever);
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        Problem problem(mode, false, false, true, 0);
        makeGood(problem);
        const MethodRun run = method->runSets(problem.search, {silent, 0, 1});
        const Truth truth = findTruth(problem.search, {});
        EXPECT_EQ(findWrongPairs(method->found(), truth).wrong(), 0u);
        EXPECT_EQ(run.pairs, truth.pairs());
    }
    const Problem nearest(RadiusMode::kGather, false, false, false, 4);
    method->runSets(nearest.search, {silent, 0, 1});
    EXPECT_EQ(findWrongPairs(method->found(), findTruth(nearest.search, {})).wrong(), 0u);
}

// What an octave has beyond the truth is extra; nothing is missing.
TEST(BenchSetMethods, OctavesMissNothing)
{
    const auto method = makeOctaveMethod({});
    ProgressPrinter silent(ProgressMode::kNever);
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        const Problem problem(mode, false, false, true, 0); // bad radii are in no octave
        method->runSets(problem.search, {silent, 0, 1});
        const WrongPairs wrong = findWrongPairs(method->found(), findTruth(problem.search, {}));
        EXPECT_EQ(wrong.missing, 0u);
        EXPECT_EQ(wrong.duplicates, 0u);
        EXPECT_GT(wrong.extra, 0u);
    }
}

TEST(BenchAccuracy, WrongPairsOfSomeQueries)
{
    Truth truth;
    truth.queries = {0, 1, 2};
    truth.neighbors = {1, 2, 5};
    truth.begin = {0, 2, 3, 3};
    RowBuffers rows;
    rows.places = {{0, 3, 0}, {3, 0, 0}, {3, 2, 0}};
    rows.buffers = {{2, 7, 2, 9, 9}};
    WrongPairs wrong = findWrongPairs(rows, truth);
    EXPECT_EQ(wrong.missing, 2u);    // 0 has not 1, 1 has not 5
    EXPECT_EQ(wrong.extra, 2u);      // 0 has 7, 2 has 9
    EXPECT_EQ(wrong.duplicates, 2u); // 2 and 9 are there twice
    EXPECT_EQ(wrong.checkedQueries, 3u);
    const std::uint8_t asked[] = {0, 1, 0};
    wrong = findWrongPairs(rows, truth, {asked, 3});
    EXPECT_EQ(wrong.wrong(), 1u);
    EXPECT_EQ(wrong.checkedQueries, 1u);
    wrong = findWrongPairs(CountedNeighbors({5, 0, 0}), truth);
    EXPECT_EQ(wrong.missing, 1u);
    EXPECT_EQ(wrong.extra, 3u);
}

// What the cases of --stability say of themselves.
TEST(BenchSetTruth, OfTheStabilityCases)
{
    std::set<std::string> withNobody;
    std::size_t longest = 0;
    for (const StabilityCase& c : stabilityCases({"radii", "sets", "nearest"})) {
        const CaseParticles particles = c.make();
        const Truth truth = findTruth(*particles.search, {});
        EXPECT_TRUE(truth.complete) << c.name;
        if (truth.pairs() == 0) withNobody.insert(c.name);
        for (std::size_t k = 0; k < truth.queries.size(); ++k)
            longest = std::max(longest, truth.row(k).size());
    }
    EXPECT_EQ(withNobody, (std::set<std::string>{"groups-no-candidate", "groups-no-query", "sets-apart"}));
    EXPECT_GT(longest, 1024u);
}

// ---- the studies ------------------------------------------------------------------------------------------

TEST(BenchRadiiPoints, SpacingFollowsTheRadius)
{
    for (const std::uint64_t count : {1u, 100u, 3000u, 60000u}) {
        const RadiiPoints points = gradedPoints(count, 0.5, 1);
        ASSERT_EQ(points.radii.size(), points.view.size());
        EXPECT_GE(points.radii.size(), 12u);
        if (count >= 3000) {
            EXPECT_NEAR(static_cast<double>(points.radii.size()), static_cast<double>(count),
                        0.05 * static_cast<double>(count));
        }
        const auto [least, most] = std::minmax_element(points.radii.begin(), points.radii.end());
        EXPECT_NEAR(*most / *least, 100, 1e-9);
        EXPECT_NEAR(*most * *least, 0.25, 1e-9);
        EXPECT_EQ(gradedPoints(count, 0.5, 1).xyz, points.xyz);
        EXPECT_NE(gradedPoints(count, 0.5, 2).xyz, points.xyz);
    }
    // As many neighbors at all radii: about (4 pi / 3) 2^3 of a lattice, fewer at the ends and faces.
    const RadiiPoints points = gradedPoints(60000, 0.5, 1);
    SetSearch search(points.view, 0);
    search.radius.ofQueries = {points.radii.data(), points.radii.size()};
    const Truth truth = findTruth(search, {});
    double sums[4] = {}, counts[4] = {};
    for (std::size_t i = 0; i < points.radii.size(); ++i) {
        const auto part = static_cast<std::size_t>(std::min(3.0, 2 * std::log10(points.radii[i] / 0.05)));
        sums[part] += static_cast<double>(truth.row(i).size());
        ++counts[part];
    }
    for (int part = 0; part < 4; ++part) EXPECT_NEAR(sums[part] / counts[part], 33, 5) << part;
}

BenchPoints block(std::uint64_t count)
{
    SceneOptions options;
    options.name = "block";
    options.count = count;
    return sceneBenchPoints(options, nullptr);
}

TEST(BenchRadiiPoints, OneInAHundredIsFourTimesAsLarge)
{
    const BenchPoints points = block(20000);
    const RadiiPoints mixed = mixedPoints(points, 0.2, 1);
    const auto large = std::count(mixed.radii.begin(), mixed.radii.end(), 0.8);
    EXPECT_NEAR(static_cast<double>(large), 200, 50);
    EXPECT_EQ(std::count(mixed.radii.begin(), mixed.radii.end(), 0.2), 20000 - large);
    EXPECT_EQ(&mixed.view.source(), &points.view.source());
}

SetStudyOptions studyOptions(const BenchPoints& points)
{
    SetStudyOptions options;
    options.radius = *points.suggestedRadius;
    options.repeat = 2;
    return options;
}

void expectRows(const std::vector<SetResult>& results, std::size_t studies)
{
    std::size_t ours = 0;
    for (const SetResult& result : results) {
        SCOPED_TRACE(result.radii + " " + result.mode + " " + result.method);
        EXPECT_EQ(result.message, "");
        EXPECT_EQ(result.isOurs, result.method == "ours");
        EXPECT_EQ(result.runs, 2u);
        EXPECT_GT(result.totalSeconds, 0);
        EXPECT_LE(result.minSeconds, result.totalSeconds);
        EXPECT_LE(result.totalSeconds, result.maxSeconds);
        EXPECT_GT(result.ratio, 0);
        EXPECT_GT(result.truePairs, 0u);
        if (!result.isOurs) continue;
        ++ours;
        EXPECT_EQ(result.ratio, 1);
        EXPECT_EQ(result.wrong.wrong(), 0u);
        EXPECT_EQ(result.wrong.checkedQueries, result.queries);
        EXPECT_EQ(result.pairs, result.truePairs);
    }
    EXPECT_EQ(ours, studies);
}

std::uint64_t wrongOf(const std::vector<SetResult>& results, const std::string& method)
{
    std::uint64_t wrong = 0;
    for (const SetResult& result : results) wrong += result.method == method ? result.wrong.wrong() : 0;
    return wrong;
}

TEST(BenchSetStudies, OfRadii)
{
    const BenchPoints points = block(2000);
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<SetResult> results = studyRadii(points, studyOptions(points), {silent, 0, 1});
    expectRows(results, 6);
    std::set<std::string> parts, methods;
    for (const SetResult& result : results) {
        parts.insert(result.radii + ", " + result.mode);
        methods.insert(result.method);
        EXPECT_EQ(result.queries, result.points);
    }
    EXPECT_EQ(parts, (std::set<std::string>{"graded 1:100, gather", "graded 1:100, scatter",
                                            "graded 1:100, symmetric", "mixed 1:4, gather",
                                            "mixed 1:4, scatter", "mixed 1:4, symmetric"}));
    for (const char* method : {"ours", "largest-filtered", "octaves"})
        EXPECT_TRUE(methods.count(method)) << method;
    EXPECT_EQ(methods.count("nanoflann-k") == 1, missingPeer("nanoflann-double").empty());
    if (methods.count("nanoflann-k")) {
        EXPECT_GT(wrongOf(results, "nanoflann-k"), 1000u);
    }
    const std::string text = radiiText(results), csv = setResultsCsv(results);
    EXPECT_NE(text.find("\nradii mixed 1:4, symmetric, 2000 particles\n"), std::string::npos) << text;
    EXPECT_EQ(text.find("scaled"), std::string::npos) << text;
    EXPECT_EQ(static_cast<std::size_t>(std::count(csv.begin(), csv.end(), '\n')), results.size() + 1);
    EXPECT_EQ(setResultsJson(results).size(), results.size());
}

TEST(BenchSetStudies, TimeSomeQueriesWhereAllTakeLong)
{
    const BenchPoints points = block(2000);
    SetStudyOptions options = studyOptions(points);
    options.mostTests = 1e5;
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<SetResult> results = studyRadii(points, options, {silent, 0, 1});
    expectRows(results, 6);
    std::size_t some = 0;
    for (const SetResult& result : results) {
        some += result.queries < result.points;
        EXPECT_GE(result.queries, 1u);
        EXPECT_EQ(result.wrong.checkedQueries, result.queries);
    }
    EXPECT_GE(some, 6u);
    EXPECT_NE(radiiText(results).find("are scaled up to all"), std::string::npos);
}

TEST(BenchSetStudies, OfTheNearest)
{
    const BenchPoints points = block(3000);
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<SetResult> results = studyNearest(points, studyOptions(points), {silent, 0, 1});
    expectRows(results, 3);
    std::set<std::uint32_t> nearest;
    for (const SetResult& result : results) {
        nearest.insert(result.nearest);
        EXPECT_EQ(result.mode, "");
        EXPECT_EQ(result.radii, "one");
    }
    EXPECT_EQ(nearest, (std::set<std::uint32_t>{1, 8, 32}));
    EXPECT_GT(wrongOf(results, "full"), 0u); // they are longer
    EXPECT_EQ(wrongOf(results, "full-cut"), 0u);
    if (missingPeer("nanoflann-double").empty()) {
        EXPECT_GT(wrongOf(results, "nanoflann-k"), 0u); // at the surface they reach too far
        EXPECT_EQ(wrongOf(results, "nanoflann-cut"), 0u);
    }
    EXPECT_NE(nearestText(results).find("\nnearest 8 within the radius, 3000 particles\n"),
              std::string::npos);
}

TEST(BenchSetStudies, ARefusalIsARow)
{
    const BenchPoints points = block(3000);
    SetStudyOptions options = studyOptions(points);
    options.search.hostMemoryBytes = 120'000; // enough for no list
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<SetResult> results = studyNearest(points, options, {silent, 0, 1});
    ASSERT_FALSE(results.empty());
    for (const SetResult& result : results) {
        if (result.method.rfind("nanoflann", 0) == 0) continue; // which knows no limit
        EXPECT_NE(result.message.find("allow more host memory"), std::string::npos) << result.method;
        EXPECT_THROW(std::rethrow_exception(result.refusal), CapacityError);
    }
    EXPECT_NE(nearestText(results).find("ours              refused: the grid of"), std::string::npos);
    const nlohmann::ordered_json json = setResultsJson(results);
    EXPECT_TRUE(json[0]["seconds"]["total"].is_null());
    EXPECT_TRUE(json[0]["pairs"].is_null());
}

TEST(BenchSetStudies, OfNobody)
{
    const BenchPoints nobody;
    SetStudyOptions options;
    options.radius = 1;
    ProgressPrinter silent(ProgressMode::kNever);
    EXPECT_TRUE(studyRadii(nobody, options, {silent, 0, 1}).empty());
    EXPECT_TRUE(studyNearest(nobody, options, {silent, 0, 1}).empty());
}

} // namespace
} // namespace vdb_nns::cli
