// The study of measures: its truth by hand, its errors, the order in which its methods come out, and when it fails.
#include "bench/bench_verdict.h"
#include "bench/measure_truth.h"
#include "bench/methods/measure_methods.h"
#include "bench/report/measure_report.h"
#include "bench/studies/measure_study.h"
#include "exit_codes.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

const double kPi = std::acos(-1.0);

std::vector<TrueMeasures> truthOf(const ParticleView& view, double radius)
{
    return trueMeasures(view, radius, findTruth(view, radius, {}));
}

// ---- the truth --------------------------------------------------------------------------------------------

// W(0) is 8 / pi; W / W(0) is 1/4 at half of the radius, 23/32 at a quarter, 2 (1 - q)^3 beyond half.
TEST(BenchMeasureTruth, OfThreeParticlesByHand)
{
    const float xyz[] = {0, 0, 0, 0.5f, 0, 0, 0, 0.25f, 0};
    const std::vector<TrueMeasures> truth = truthOf(ParticleView::fromArray(xyz, 3), 1);
    ASSERT_EQ(truth.size(), 3u);
    const double far = 2 * std::pow(1 - std::sqrt(0.3125), 3);
    EXPECT_NEAR(truth[0].density, 8 / kPi * (1 + 0.25 + 23.0 / 32), 1e-14);
    EXPECT_NEAR(truth[1].density, 8 / kPi * (1 + 0.25 + far), 1e-14);
    EXPECT_NEAR(truth[2].density, 8 / kPi * (1 + 23.0 / 32 + far), 1e-14);
    const double x = 0.25 * 0.5, y = 23.0 / 32 * 0.25, length = std::hypot(x, y);
    EXPECT_TRUE(truth[0].hasNormal);
    EXPECT_NEAR(truth[0].normal[0], -x / length, 1e-15);
    EXPECT_NEAR(truth[0].normal[1], -y / length, 1e-15);
    EXPECT_EQ(truth[0].normal[2], 0);
    for (const TrueMeasures& each : truth) EXPECT_FALSE(each.isEllipsoid);
}

// Ten at either end of a line: 20, which is the threshold. One variance is there, the others are raised to a quarter.
TEST(BenchMeasureTruth, OfAnEllipsoidByHand)
{
    std::vector<float> xyz(60, 0.0f);
    for (std::size_t i = 10; i < 20; ++i) xyz[3 * i + 1] = 0.5f;
    const std::vector<TrueMeasures> truth = truthOf(ParticleView::fromArray(xyz.data(), 20), 1);
    ASSERT_EQ(truth.size(), 20u);
    for (const TrueMeasures& each : truth) {
        ASSERT_TRUE(each.isEllipsoid && each.hasStretch && each.hasAxis);
        EXPECT_NEAR(each.stretch[0], std::cbrt(16.0), 1e-14);
        EXPECT_NEAR(each.stretch[1], std::cbrt(16.0) / 4, 1e-14);
        EXPECT_NEAR(each.stretch[2], std::cbrt(16.0) / 4, 1e-14);
        EXPECT_NEAR(std::fabs(each.axis[1]), 1, 1e-15);
    }
}

TEST(BenchMeasureTruth, LeavesOutWhatIsNotFiniteAndKnowsWhoIsAlone)
{
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float xyz[] = {0, 0, 0, nan, 0, 0, 5, 0, 0};
    const std::vector<TrueMeasures> truth = truthOf(ParticleView::fromArray(xyz, 3), 1);
    ASSERT_EQ(truth.size(), 2u);
    EXPECT_EQ(truth[1].query, 2u);
    EXPECT_NEAR(truth[1].density, 8 / kPi, 1e-15);
    EXPECT_TRUE(truth[1].hasNormal); // it is 0 for certain
    EXPECT_EQ(truth[1].normal, (Vec3d{0, 0, 0}));
}

// ---- errors -----------------------------------------------------------------------------------------------

TEST(BenchMeasureErrors, RmsAndQuantile)
{
    std::vector<double> errors;
    for (int k = 200; k > 0; --k) errors.push_back(k);
    const ErrorSummary summary = summarizeErrors(errors);
    EXPECT_EQ(summary.compared, 200u);
    EXPECT_EQ(summary.p99, 198);
    EXPECT_EQ(summary.max, 200);
    EXPECT_NEAR(summary.rms, std::sqrt(201.0 * 401 / 6), 1e-12);
    std::vector<double> one{3}, none;
    EXPECT_EQ(summarizeErrors(one).p99, 3);
    EXPECT_EQ(summarizeErrors(none).compared, 0u);
}

TEST(BenchMeasureErrors, OfEachMeasure)
{
    std::vector<TrueMeasures> truth(3);
    for (std::uint32_t i = 0; i < 3; ++i) truth[i].query = i;
    for (TrueMeasures& each : truth) {
        each.density = 2;
        each.hasNormal = true;
        each.normal = {0, 0, 1};
        each.isEllipsoid = each.hasStretch = each.hasAxis = true;
        each.stretch = {2, 1, 0.5};
        each.axis = {1, 0, 0};
    }
    truth[2].normal = {0, 0, 0};
    truth[2].isEllipsoid = truth[2].hasStretch = truth[2].hasAxis = false;

    MeasureValues values;
    const float density[] = {2, 3, std::numeric_limits<float>::infinity()};
    values.density = density;
    MeasureErrors errors = findMeasureErrors("density", values, truth);
    EXPECT_EQ(errors.value.compared, 2u);
    EXPECT_EQ(errors.value.max, 0.5);
    EXPECT_EQ(errors.oneSided, 1u);
    EXPECT_EQ(errors.wrong, 1u);
    EXPECT_FALSE(errors.axis.has_value());
    truth[2].density = 1e39; // beyond the range of floats
    EXPECT_EQ(findMeasureErrors("density", values, truth).oneSided, 0u);

    const float normal[] = {0, 0, 1, 1, 0, 0, 0, 1, 0};
    values.normal = normal;
    errors = findMeasureErrors("normal", values, truth);
    EXPECT_EQ(errors.value.compared, 2u);
    EXPECT_NEAR(errors.value.max, 90, 1e-12);
    EXPECT_EQ(errors.oneSided, 1u);
    EXPECT_EQ(errors.wrong, 1u);

    const float stretch[] = {2, 1, 0.5f, 2.5f, 0.8f, 0.5f, 1, 1, 1};
    std::vector<float> xform(27, 0.0f);
    xform[0] = -1;            // the axis the other way round
    xform[9] = xform[12] = 1; // 45 degrees off
    const std::uint8_t ellipsoids[] = {1, 1, 0};
    values.stretch = stretch;
    values.xform = xform.data();
    values.ellipsoids = ellipsoids;
    errors = findMeasureErrors("pca", values, truth);
    EXPECT_EQ(errors.value.compared, 2u);
    EXPECT_EQ(errors.value.max, 0.25);
    EXPECT_EQ(errors.oneSided, 0u);
    EXPECT_EQ(errors.wrong, 1u);
    ASSERT_TRUE(errors.axis.has_value());
    EXPECT_EQ(errors.axis->compared, 2u);
    EXPECT_NEAR(errors.axis->max, 45, 1e-12);
    EXPECT_NEAR(errors.axis->rms, 45 / std::sqrt(2.0), 1e-12);
    truth[1].stretchBound = 1;
    EXPECT_EQ(findMeasureErrors("pca", values, truth).wrong, 1u); // the axis is
    truth[1].axisBound = 1;
    EXPECT_EQ(findMeasureErrors("pca", values, truth).wrong, 0u);
    const std::uint8_t others[] = {0, 1, 1};
    values.ellipsoids = others;
    EXPECT_EQ(findMeasureErrors("pca", values, truth).oneSided, 2u);
}

// ---- methods and the study --------------------------------------------------------------------------------

// A pair counts for both or for none, twice if at all.
TEST(BenchMeasureMethods, HalfOfThePairs)
{
    std::vector<float> xyz;
    for (int i = 0; i < 2000; ++i) {
        const auto at = static_cast<float>(4 * (i / 2));
        xyz.insert(xyz.end(), {at + (i % 2 == 1 ? 0.5f : 0.0f), 0, 0});
    }
    const ParticleView view = ParticleView::fromArray(xyz.data(), 2000);
    const auto method = makeFloatMeasures(view, 1, {}, NeighborShare::kHalf);
    method->run("density");
    const float* const density = method->values().density;
    int kept = 0;
    for (int pair = 0; pair < 1000; ++pair) {
        ASSERT_EQ(density[2 * pair], density[2 * pair + 1]);
        const bool isKept = density[2 * pair] > 3;
        kept += isKept;
        EXPECT_NEAR(density[2 * pair], 8 / kPi * (isKept ? 1.5 : 1), 1e-5);
    }
    EXPECT_NEAR(kept, 500, 80);
}

BenchPoints block(std::uint64_t count)
{
    SceneOptions options;
    options.name = "block";
    options.count = count;
    return sceneBenchPoints(options, nullptr);
}

MeasureStudyOptions studyOptions(const BenchPoints& points)
{
    MeasureStudyOptions options;
    options.radius = *points.suggestedRadius;
    options.voxelSize = *points.voxelSize;
    options.repeat = 2;
    return options;
}

TEST(BenchMeasureStudy, OursIsRightAndTheOthersAreInOrder)
{
    const BenchPoints points = block(4000);
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<MeasureResult> results = studyMeasures(points, studyOptions(points), {silent, 0, 1});
    EXPECT_EQ(results.size(), 18u);
    std::map<std::pair<std::string, std::string>, MeasureErrors> errors;
    for (const MeasureResult& result : results) {
        SCOPED_TRACE(result.measure + " by " + result.method);
        EXPECT_EQ(result.message, "");
        EXPECT_EQ(result.runs, 2u);
        EXPECT_GT(result.passSeconds, 0);
        EXPECT_GT(result.ratio, 0);
        EXPECT_LE(result.minSeconds, result.totalSeconds);
        EXPECT_LE(result.totalSeconds, result.maxSeconds);
        EXPECT_TRUE(result.isComplete);
        EXPECT_EQ(result.checkedQueries, 4000u);
        EXPECT_GT(result.errors.value.compared, 3000u);
        EXPECT_EQ(result.errors.axis.has_value(), result.measure == "pca");
        EXPECT_EQ(result.isOurs, result.method == "ours");
        errors[{result.measure, result.method}] = result.errors;
    }
    for (const char* measure : {"density", "normal", "pca"}) {
        SCOPED_TRACE(measure);
        const auto error = [&](const char* method) { return errors[{measure, method}].value; };
        const double degrees = measure == std::string("normal") ? 180 / kPi : 1;
        EXPECT_LT(error("ours").max, 1e-6 * degrees);
        EXPECT_EQ((errors[{measure, "ours"}].wrong), 0u);
        EXPECT_EQ((errors[{measure, "ours"}].oneSided), 0u);
        EXPECT_LT(error("ours").rms, error("float32").rms);
        EXPECT_LT(error("float32").rms, 1e-5 * degrees);
        EXPECT_GT(error("half").rms, 1e3 * error("float32").rms);
        EXPECT_GT(error("fxpt8").rms, 10 * error("fxpt16").rms);
        EXPECT_GT(error("fxpt16").rms, error("ours").rms);
        EXPECT_GT(error("nearest32").max, error("ours").max);
    }
    EXPECT_LT((errors[{"pca", "ours"}].axis->max), 1e-4);
    EXPECT_GT((errors[{"pca", "half"}].oneSided), 0u);

    const std::string text = measuresText(results), csv = measureResultsCsv(results);
    EXPECT_NE(text.find("\nerrors of all 4000 queries"), std::string::npos) << text;
    EXPECT_EQ(static_cast<std::size_t>(std::count(csv.begin(), csv.end(), '\n')), results.size() + 1);
    EXPECT_EQ(measureResultsJson(results).size(), results.size());
}

TEST(BenchMeasureStudy, ARefusalIsARow)
{
    const BenchPoints points = block(3000);
    MeasureStudyOptions options = studyOptions(points);
    options.search.hostMemoryBytes = 1000;
    ProgressPrinter silent(ProgressMode::kNever);
    const std::vector<MeasureResult> results = studyMeasures(points, options, {silent, 0, 1});
    ASSERT_EQ(results.size(), 18u);
    for (const MeasureResult& result : results) {
        EXPECT_NE(result.message.find("allow"), std::string::npos) << result.message;
        EXPECT_THROW(std::rethrow_exception(result.refusal), CapacityError);
    }
    EXPECT_NE(measuresText(results).find("ours       refused: "), std::string::npos);
    EXPECT_TRUE(measureResultsJson(results)[0]["seconds"]["pass"].is_null());
    EXPECT_TRUE(measureResultsJson(results)[0]["accuracy"].is_null());
}

TEST(BenchMeasureStudy, OfNobody)
{
    ProgressPrinter silent(ProgressMode::kNever);
    MeasureStudyOptions options;
    options.radius = 1;
    EXPECT_TRUE(studyMeasures({}, options, {silent, 0, 1}).empty());
    EXPECT_EQ(measuresText({}), "");
}

MeasureResult resultOf(const std::string& method, std::uint64_t wrong, std::uint64_t oneSided)
{
    MeasureResult result;
    result.measure = "normal";
    result.method = method;
    result.isOurs = method == "ours";
    result.checkedQueries = 9;
    result.errors.wrong = wrong;
    result.errors.oneSided = oneSided;
    return result;
}

TEST(BenchVerdict, OnlyOursHasToBeRight)
{
    BenchReport report;
    report.measures = {resultOf("ours", 0, 0), resultOf("half", 5, 5)};
    EXPECT_NO_THROW(requireRight(report));
    report.measures[0].errors.wrong = 1;
    EXPECT_THROW(requireRight(report), CheckFailed);
    report.measures[0] = resultOf("ours", 0, 2);
    try {
        requireRight(report);
        FAIL();
    } catch (const CheckFailed& error) {
        EXPECT_STREQ(error.what(), "ours is wrong in normal: 2 values of 9 queries; please report it");
    }
}

TEST(BenchVerdict, WhereAllRefusedTheFirstSaysWhy)
{
    BenchReport report;
    report.measures = {resultOf("ours", 0, 0), resultOf("half", 0, 0)};
    report.measures[0].refusal = std::make_exception_ptr(CapacityError("too much", 2, 1));
    EXPECT_NO_THROW(requireRight(report));
    report.measures[1].refusal = std::make_exception_ptr(InvalidInput("another"));
    EXPECT_THROW(requireRight(report), CapacityError);
}

} // namespace
} // namespace vdb_nns::cli
