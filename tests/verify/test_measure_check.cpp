// `vdb_nns verify` on attributes: what is right by brute force in doubles or by hand passes, and each fault is found.
#include "vdb_nns/error.h"
#include "verify/measure_check.h"

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::testing {
namespace {

using cli::MeasureClaims;
using cli::MeasureReport;
using cli::SearchTerms;
using cli::ValueFinding;
using cli::verifyMeasures;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kPi = 3.14159265358979323846;

template <typename T>
PointAttribute attribute(const std::string& name, AttributeType type, std::vector<T> values)
{
    const auto owner = std::make_shared<std::vector<T>>(std::move(values));
    return {name, type, owner->size() / attributeWidth(type), {owner, owner->data()}};
}

PointAttribute floats(const std::string& name, std::vector<float> values)
{
    return attribute(name, AttributeType::kFloat, std::move(values));
}

PointAttribute integers(const std::string& name, std::vector<std::int32_t> values)
{
    return attribute(name, AttributeType::kInt32, std::move(values));
}

PointAttribute vectors(const std::string& name, std::vector<float> values)
{
    return attribute(name, AttributeType::kVec3s, std::move(values));
}

PointGroup group(const std::string& name, std::vector<std::uint8_t> members)
{
    const auto owner = std::make_shared<std::vector<std::uint8_t>>(std::move(members));
    return {name, owner->size(), {owner, owner->data()}};
}

template <typename T>
std::vector<T> numbersOf(const PointValues& values, const std::string& name)
{
    for (const PointAttribute& a : values.attributes) {
        if (a.name != name) continue;
        const T* const first = static_cast<const T*>(a.values.get());
        return {first, first + a.count * attributeWidth(a.type)};
    }
    ADD_FAILURE() << "no " << name;
    return {};
}

// The same values with one number of one attribute changed.
template <typename T>
PointValues changed(const PointValues& values, const std::string& name, std::size_t at,
                    const std::function<T(T)>& change)
{
    PointValues result = values;
    for (PointAttribute& a : result.attributes) {
        if (a.name != name) continue;
        std::vector<T> numbers = numbersOf<T>(values, name);
        numbers[at] = change(numbers[at]);
        a = attribute(name, a.type, numbers);
    }
    return result;
}

PointValues flipped(const PointValues& values, const std::string& name, std::size_t at)
{
    PointValues result = values;
    for (PointGroup& g : result.groups) {
        if (g.name != name) continue;
        std::vector<std::uint8_t> members(g.members.get(), g.members.get() + g.count);
        members[at] = !members[at];
        g = group(name, members);
    }
    return result;
}

// ---- brute force, in doubles ------------------------------------------------------------------------------------------

using Point = std::array<double, 3>;

bool isFinite(const Point& p)
{
    return std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]);
}

double weight(SmoothingKernel kernel, double d, double radius)
{
    const double q = std::min(d / radius, 1.0), cube = radius * radius * radius;
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return 8 / (kPi * cube) * (q < 0.5 ? 1 - 6 * q * q + 6 * q * q * q : 2 * std::pow(1 - q, 3));
    case SmoothingKernel::kWendland2:
        return 21 / (2 * kPi * cube) * std::pow(1 - q, 4) * (1 + 4 * q);
    case SmoothingKernel::kPoly6:
        return 315 / (64 * kPi * cube) * std::pow(1 - q * q, 3);
    case SmoothingKernel::kTophat:
        return 3 / (4 * kPi * cube);
    }
    return 0;
}

// A search among arrays, and the values of the candidates.
struct Case {
    std::vector<Point> queries, candidates; // the same points where `isOneSet`
    bool isOneSet = true;
    std::vector<std::uint8_t> queryChosen, candidateChosen;
    double radius = 0.1;
    std::vector<double> queryRadii, candidateRadii; // where not empty, instead
    RadiusMode mode = RadiusMode::kGather;
    std::uint64_t nearest = 0;
    std::vector<double> masses;
    MeasureOptions options;

    SearchTerms terms() const
    {
        SearchTerms terms;
        terms.candidates = ParticleView::fromArray(candidates[0].data(), candidates.size());
        terms.queries =
            isOneSet ? terms.candidates : ParticleView::fromArray(queries[0].data(), queries.size());
        terms.queries.chosen = {queryChosen.data(), queryChosen.size()};
        terms.candidates.chosen = {candidateChosen.data(), candidateChosen.size()};
        terms.radius = radius;
        if (!queryRadii.empty() || !candidateRadii.empty()) {
            terms.radius.value = 0;
            terms.radius.mode = mode;
            if (mode != RadiusMode::kScatter) terms.radius.ofQueries = {queryRadii.data(), queryRadii.size()};
            if (mode != RadiusMode::kGather)
                terms.radius.ofCandidates = {candidateRadii.data(), candidateRadii.size()};
        }
        terms.nearest = nearest;
        return terms;
    }

    // 0: they do not reach each other, whatever the distance.
    double radiusOf(std::size_t i, std::size_t j) const
    {
        const auto usable = [](double r) { return r > 0 && std::isfinite(r) ? r : 0; };
        if (queryRadii.empty() && candidateRadii.empty()) return radius;
        if (mode == RadiusMode::kGather) return usable(queryRadii[i]);
        if (mode == RadiusMode::kScatter) return usable(candidateRadii[j]);
        return std::max(usable(queryRadii[i]), usable(candidateRadii[j]));
    }
};

struct Seen {
    std::size_t number;
    Point offset; // from the query
    double distance, radius;
};

struct Row {
    std::vector<Seen> neighbors;
    bool asks = false, countsItself = false;
};

std::vector<Row> rowsOf(const Case& scene)
{
    const std::vector<Point>& queries = scene.isOneSet ? scene.candidates : scene.queries;
    std::vector<Row> rows(queries.size());
    const auto isChosen = [](const std::vector<std::uint8_t>& chosen, std::size_t i) {
        return chosen.empty() || chosen[i];
    };
    for (std::size_t i = 0; i < rows.size(); ++i) {
        Row& row = rows[i];
        row.asks = isFinite(queries[i]) && isChosen(scene.queryChosen, i);
        if (!row.asks) continue;
        for (std::size_t j = 0; j < scene.candidates.size(); ++j) {
            const Point& other = scene.candidates[j];
            if (!isFinite(other) || !isChosen(scene.candidateChosen, j)) continue;
            const double radius = scene.radiusOf(i, j);
            if (scene.isOneSet && i == j) {
                row.countsItself = radius > 0;
                continue;
            }
            Seen seen{j, {}, 0, radius};
            for (int k = 0; k < 3; ++k) seen.offset[k] = other[k] - queries[i][k];
            seen.distance = std::sqrt(seen.offset[0] * seen.offset[0] + seen.offset[1] * seen.offset[1] +
                                      seen.offset[2] * seen.offset[2]);
            if (radius > 0 && seen.distance <= radius) row.neighbors.push_back(seen);
        }
        std::stable_sort(row.neighbors.begin(), row.neighbors.end(),
                         [](const Seen& a, const Seen& b) { return a.distance < b.distance; });
        if (scene.nearest > 0 && row.neighbors.size() > scene.nearest) row.neighbors.resize(scene.nearest);
    }
    return rows;
}

// The neighbors, and the query where it counts.
std::vector<Seen> allOf(const Case& scene, const Row& row, std::size_t i)
{
    std::vector<Seen> all = row.neighbors;
    if (row.countsItself) all.push_back({i, {}, 0, scene.radiusOf(i, i)});
    return all;
}

struct Covariance {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero(), values = Eigen::Vector3d::Zero();
    Eigen::Matrix3d vectors = Eigen::Matrix3d::Identity();
};

// Eigenvalues descending; the signs of the vectors as the header of measures says.
Covariance covarianceOf(const std::vector<Seen>& all, const std::function<double(const Seen&)>& weightOf)
{
    Covariance result;
    double total = 0;
    for (const Seen& seen : all) {
        total += weightOf(seen);
        result.mean += weightOf(seen) * Eigen::Vector3d(seen.offset.data());
    }
    if (total == 0) return result;
    result.mean /= total;
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Zero();
    for (const Seen& seen : all) {
        const Eigen::Vector3d from = Eigen::Vector3d(seen.offset.data()) - result.mean;
        matrix += weightOf(seen) / total * from * from.transpose();
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(matrix);
    for (int k = 0; k < 3; ++k) {
        result.values[k] = solver.eigenvalues()[2 - k];
        result.vectors.col(k) = solver.eigenvectors().col(2 - k);
    }
    for (int k = 0; k < 2; ++k) {
        Eigen::Index largest = 0;
        result.vectors.col(k).cwiseAbs().maxCoeff(&largest);
        if (result.vectors(largest, k) < 0) result.vectors.col(k) *= -1;
    }
    result.vectors.col(2) = result.vectors.col(0).cross(result.vectors.col(1));
    return result;
}

// Labels by spreading the smallest number over pairs until nothing changes.
std::vector<std::int32_t> clustersOf(const Case& scene, const std::vector<Row>& rows)
{
    const std::size_t count = rows.size();
    std::vector<std::vector<std::size_t>> pairs(count);
    std::vector<bool> isCore(count);
    for (std::size_t i = 0; i < count; ++i) {
        isCore[i] = rows[i].asks &&
                    (!scene.options.minNeighbors || rows[i].neighbors.size() >= *scene.options.minNeighbors);
        for (const Seen& seen : rows[i].neighbors) {
            pairs[i].push_back(seen.number);
            pairs[seen.number].push_back(i);
        }
    }
    std::vector<std::size_t> smallest(count);
    std::iota(smallest.begin(), smallest.end(), std::size_t(0));
    for (bool goesOn = true; goesOn;) {
        goesOn = false;
        for (std::size_t i = 0; i < count; ++i) {
            for (const std::size_t j : pairs[i]) {
                if (!isCore[i] || !isCore[j] || smallest[i] <= smallest[j]) continue;
                smallest[i] = smallest[j];
                goesOn = true;
            }
        }
    }
    std::map<std::size_t, std::int32_t> ranks;
    for (std::size_t i = 0; i < count; ++i) {
        if (isCore[i]) ranks.emplace(smallest[i], static_cast<std::int32_t>(ranks.size()));
    }
    std::vector<std::int32_t> labels(count, -1);
    for (std::size_t i = 0; i < count; ++i) {
        if (isCore[i]) labels[i] = ranks[smallest[i]];
        if (isCore[i]) continue;
        std::size_t core = count;
        for (const std::size_t j : pairs[i]) {
            if (isCore[j]) core = std::min(core, j);
        }
        if (core < count) labels[i] = ranks[smallest[core]];
    }
    return labels;
}

// The values of all measures that have a meaning for the case, with the prefix "t_"; "v" is a vector of the candidates.
struct Truth {
    PointValues values;
    std::vector<std::string> names;
};

Truth bruteForce(const Case& scene)
{
    const std::vector<Row> rows = rowsOf(scene);
    const std::vector<Point>& queries = scene.isOneSet ? scene.candidates : scene.queries;
    const MeasureOptions& options = scene.options;
    const std::size_t count = rows.size();
    std::vector<std::int32_t> counts(count), nearest(count, -1);
    std::vector<float> density(count), mean(count, -1), least(count, -1), normal(3 * count), eigen(3 * count),
        average(3 * count), stretch(3 * count), xform(9 * count);
    std::vector<double> pws(3 * count);
    std::vector<std::uint8_t> ellipsoids(count), isolated(count), nonfinite(count);
    const auto* const v = static_cast<const float*>(options.attributes[0].values.get());
    for (std::size_t i = 0; i < count; ++i) {
        const std::vector<Seen>& row = rows[i].neighbors;
        const std::vector<Seen> all = allOf(scene, rows[i], i);
        const auto weightOf = [&](const Seen& seen) {
            return weight(options.kernel, seen.distance, seen.radius);
        };
        counts[i] = static_cast<std::int32_t>(row.size());
        double sum = 0, distances = 0, total = 0;
        std::array<double, 3> sums{}, away{};
        for (const Seen& seen : all) {
            sum += weightOf(seen) * (scene.masses.empty() ? options.mass : scene.masses[seen.number]);
            const float* const value = v + 3 * seen.number;
            if (!std::isfinite(value[0]) || !std::isfinite(value[1]) || !std::isfinite(value[2])) continue;
            total += weightOf(seen);
            for (int k = 0; k < 3; ++k) sums[k] += weightOf(seen) * value[k];
        }
        density[i] = static_cast<float>(sum);
        for (const Seen& seen : row) {
            distances += seen.distance;
            for (int k = 0; k < 3; ++k) away[k] -= weightOf(seen) * seen.offset[k];
        }
        const double length = std::hypot(away[0], std::hypot(away[1], away[2]));
        if (!row.empty()) {
            mean[i] = static_cast<float>(distances / static_cast<double>(row.size()));
            least[i] = static_cast<float>(row[0].distance);
            nearest[i] = static_cast<std::int32_t>(row[0].number);
        }
        const Covariance smooth = covarianceOf(all, weightOf);
        const Covariance pca = covarianceOf(all, [](const Seen& seen) {
            return 1 - std::pow(std::min(seen.distance / seen.radius, 1.0), 3);
        });
        ellipsoids[i] = options.pca.threshold > 0 && all.size() >= options.pca.threshold;
        std::array<double, 3> lengths{};
        const double floor = options.pca.anisotropy * pca.values[0];
        for (int k = 0; k < 3; ++k) lengths[k] = pca.values[0] > 0 ? std::max(pca.values[k], floor) : 1;
        for (int k = 0; k < 3; ++k) {
            if (total > 0) average[3 * i + k] = static_cast<float>(sums[k] / total);
            if (length > 0) normal[3 * i + k] = static_cast<float>(away[k] / length);
            eigen[3 * i + k] = static_cast<float>(smooth.values[k]);
            stretch[3 * i + k] = static_cast<float>(
                ellipsoids[i] ? lengths[k] / std::cbrt(lengths[0] * lengths[1] * lengths[2])
                              : options.pca.stretch);
            pws[3 * i + k] = queries[i][k] + options.pca.average * pca.mean[k];
            for (int c = 0; c < 3; ++c)
                xform[9 * i + 3 * k + c] = static_cast<float>(ellipsoids[i] ? pca.vectors(k, c) : k == c);
        }
        isolated[i] = rows[i].asks && row.empty();
        nonfinite[i] = !isFinite(queries[i]);
    }
    Truth truth;
    truth.values.attributes = {integers("t_count", counts),
                               floats("t_density", density),
                               floats("t_mean_distance", mean),
                               floats("t_nearest_distance", least),
                               integers("t_nearest", nearest),
                               vectors("t_average:v", average),
                               vectors("t_normal", normal),
                               vectors("t_eigenvalues", eigen),
                               vectors("stretch", stretch),
                               attribute("xform", AttributeType::kMat3s, xform),
                               attribute("pws", AttributeType::kVec3d, pws)};
    truth.values.groups = {group("ellipsoids", ellipsoids), group("t_isolated", isolated),
                           group("t_nonfinite", nonfinite)};
    truth.names = {"count",  "density",     "mean_distance", "nearest_distance", "nearest",  "average:v",
                   "normal", "eigenvalues", "pca",           "isolated",         "nonfinite"};
    if (!scene.isOneSet || scene.nearest > 0 || !scene.queryChosen.empty() || !scene.candidateChosen.empty())
        return truth;
    const std::vector<std::int32_t> labels = clustersOf(scene, rows);
    std::vector<std::int32_t> sizes(count);
    for (std::size_t i = 0; i < count; ++i) {
        if (labels[i] >= 0)
            sizes[i] = static_cast<std::int32_t>(std::count(labels.begin(), labels.end(), labels[i]));
    }
    truth.values.attributes.push_back(integers("t_cluster", labels));
    truth.values.attributes.push_back(integers("t_cluster_size", sizes));
    truth.names.insert(truth.names.end(), {"cluster", "cluster_size"});
    return truth;
}

MeasureClaims claimsOf(const Case& scene, const PointValues& values, const std::vector<std::string>& names)
{
    MeasureClaims claims;
    claims.path = "result.vdb";
    claims.names = names;
    claims.options = scene.options;
    claims.options.masses = {scene.masses.data(), scene.masses.size()};
    claims.values = values;
    return claims;
}

MeasureReport checked(const Case& scene, const PointValues& values, const std::vector<std::string>& names,
                      const cli::VerifyOptions& options = {})
{
    const SearchTerms terms = scene.terms();
    return verifyMeasures(terms, claimsOf(scene, values, names), options);
}

const ValueFinding& findingOf(const MeasureReport& report, const std::string& name)
{
    for (const ValueFinding& finding : report.findings) {
        if (finding.name == name) return finding;
    }
    throw InvalidInput("no finding " + name);
}

std::string describe(const MeasureReport& report)
{
    std::string text;
    for (const ValueFinding& finding : report.findings) {
        for (const cli::ValueExample& example : finding.examples) {
            char line[256];
            std::snprintf(line, sizeof line, "%s of %d [%d]: %.17g, expected %.17g within %g %s\n",
                          finding.name.c_str(), static_cast<int>(example.query),
                          static_cast<int>(example.component), example.value, example.expected, example.bound,
                          example.what.c_str());
            text += line;
        }
    }
    return text;
}

std::vector<Point> cloud(std::size_t count, unsigned seed)
{
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform;
    std::vector<Point> points(count);
    for (Point& point : points) point = {uniform(random), uniform(random), uniform(random)};
    return points;
}

// Of about 15 neighbors each, with a few odd points.
Case randomCase(SmoothingKernel kernel = SmoothingKernel::kCubic)
{
    Case scene;
    scene.candidates = cloud(600, 5);
    scene.candidates[17] = {kNaN, 0.5, 0.5};
    scene.candidates[18] = {9, 9, 9};
    scene.candidates[19] = scene.candidates[20];
    scene.radius = 0.18;
    scene.options.prefix = "t_";
    scene.options.kernel = kernel;
    scene.options.mass = 0.25;
    scene.options.pca.threshold = 12;
    std::vector<float> v(3 * scene.candidates.size());
    std::mt19937 random(7);
    std::normal_distribution<float> normal;
    for (float& number : v) number = normal(random);
    v[3 * 40 + 1] = std::numeric_limits<float>::infinity();
    scene.options.attributes = {vectors("v", v)};
    return scene;
}

void expectRight(const Case& scene)
{
    const Truth truth = bruteForce(scene);
    const MeasureReport report = checked(scene, truth.values, truth.names);
    EXPECT_TRUE(report.passed()) << describe(report);
    EXPECT_EQ(report.queries, scene.isOneSet ? scene.candidates.size() : scene.queries.size());
}

// ---- right values pass --------------------------------------------------------------------------------------------

TEST(MeasureCheck, RightValuesPass)
{
    for (const auto kernel : {SmoothingKernel::kCubic, SmoothingKernel::kWendland2, SmoothingKernel::kPoly6,
                              SmoothingKernel::kTophat}) {
        SCOPED_TRACE(static_cast<int>(kernel));
        Case scene = randomCase(kernel);
        expectRight(scene);
        scene.options.minNeighbors = 14;
        for (std::size_t i = 0; i < scene.candidates.size(); ++i)
            scene.masses.push_back(static_cast<double>(i % 7));
        scene.options.pca = {0.1, 2, 5, 0.5};
        expectRight(scene);
    }
}

TEST(MeasureCheck, RolesRadiiAndTheNearest)
{
    Case scene = randomCase();
    const std::size_t count = scene.candidates.size();
    std::vector<double> radii(count);
    for (std::size_t i = 0; i < count; ++i) radii[i] = 0.06 + 0.002 * static_cast<double>(i % 60);
    radii[3] = -1;
    radii[4] = kNaN;
    for (const auto mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        SCOPED_TRACE(static_cast<int>(mode));
        Case own = scene;
        own.mode = mode;
        own.queryRadii = own.candidateRadii = radii;
        expectRight(own);
        own.options.minNeighbors = 6;
        expectRight(own);
    }
    scene.nearest = 8;
    expectRight(scene);
    for (std::size_t i = 0; i < count; ++i) {
        scene.queryChosen.push_back(i % 3 != 0);
        scene.candidateChosen.push_back(i % 4 != 0);
    }
    expectRight(scene);
    Case other = randomCase();
    other.isOneSet = false;
    other.queries = cloud(200, 9);
    other.queries[0] = {kNaN, 0, 0};
    other.queries[1] = {5, 5, 5};
    expectRight(other);
}

TEST(MeasureCheck, ASampleChecksClustersOfAll)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    const MeasureReport report = checked(scene, truth.values, truth.names, {50, 3, 10});
    EXPECT_TRUE(report.passed()) << describe(report);
    EXPECT_EQ(report.queries, 50u);
    EXPECT_EQ(findingOf(report, "density").checked, 50u);
    EXPECT_EQ(findingOf(report, "cluster").checked, scene.candidates.size());
}

TEST(MeasureCheck, PointsThatAreNotInTheFileAreNotLookedAt)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    PointValues values = changed<float>(truth.values, "t_density", 17, [](float) { return 5.0f; });
    values = changed<std::int32_t>(values, "t_cluster", 17, [](std::int32_t) { return 5; });
    EXPECT_EQ(checked(scene, values, truth.names).faultCount(), 2u);
    MeasureClaims claims = claimsOf(scene, values, truth.names);
    claims.isThere.assign(scene.candidates.size(), 1);
    claims.isThere[17] = 0;
    const SearchTerms terms = scene.terms();
    const MeasureReport report = verifyMeasures(terms, claims);
    EXPECT_TRUE(report.passed()) << describe(report);
    EXPECT_EQ(report.queries, scene.candidates.size() - 1);
}

// ---- faults are found -----------------------------------------------------------------------------------------------

void expectFound(const Case& scene, const Truth& truth, const PointValues& values, const std::string& name,
                 std::uint64_t query)
{
    SCOPED_TRACE(name);
    const MeasureReport report = checked(scene, values, truth.names);
    EXPECT_EQ(report.faultCount(), 1u) << describe(report);
    const ValueFinding& finding = findingOf(report, name);
    ASSERT_EQ(finding.count, 1u);
    EXPECT_EQ(finding.examples.at(0).query, query);
}

TEST(MeasureCheck, AValueThatIsOffIsFound)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    const std::size_t at = 123;
    const auto expectAllFound = [&](const std::function<double(double)>& change) {
        const auto ofFloats = [&](float value) { return static_cast<float>(change(value)); };
        for (const char* name : {"density", "mean_distance", "nearest_distance"})
            expectFound(scene, truth, changed<float>(truth.values, std::string("t_") + name, at, ofFloats),
                        name, at);
        for (const char* name : {"average:v", "normal", "eigenvalues"})
            expectFound(scene, truth,
                        changed<float>(truth.values, std::string("t_") + name, 3 * at + 1, ofFloats), name,
                        at);
        expectFound(scene, truth, changed<float>(truth.values, "stretch", 3 * at + 1, ofFloats), "stretch",
                    at);
        expectFound(scene, truth, changed<float>(truth.values, "xform", 9 * at + 1, ofFloats), "xform", at);
        expectFound(scene, truth, changed<double>(truth.values, "pws", 3 * at + 1, change), "pws", at);
    };
    expectAllFound([](double value) { return value * (1 + 1e-4) + 1e-9; });
    expectAllFound([](double) { return kNaN; });
    expectAllFound([](double) { return HUGE_VAL; });
    expectFound(scene, truth,
                changed<double>(truth.values, "pws", 3 * at, [](double x) { return x + 1e-12; }), "pws", at);
    const auto oneMore = [](float value) { return std::nextafter(std::nextafter(value, 100.f), 100.f); };
    expectFound(scene, truth, changed<float>(truth.values, "t_density", at, oneMore), "density", at);
}

TEST(MeasureCheck, AnIntegerThatIsOffIsFound)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    for (const char* name : {"count", "nearest", "cluster", "cluster_size"}) {
        expectFound(scene, truth,
                    changed<std::int32_t>(truth.values, std::string("t_") + name, 55,
                                          [](std::int32_t value) { return value + 1; }),
                    name, 55);
    }
}

TEST(MeasureCheck, SwappedLabelsAreFound)
{
    Case scene = randomCase();
    scene.radius = 0.08;
    const Truth truth = bruteForce(scene);
    std::vector<std::int32_t> labels = numbersOf<std::int32_t>(truth.values, "t_cluster");
    std::uint64_t swaps = 0;
    for (std::int32_t& label : labels) {
        swaps += label == 0 || label == 1;
        if (label == 0 || label == 1) label = 1 - label;
    }
    ASSERT_GT(swaps, 2u);
    PointValues values = truth.values;
    for (PointAttribute& a : values.attributes) {
        if (a.name == "t_cluster") a = integers("t_cluster", labels);
    }
    EXPECT_EQ(findingOf(checked(scene, values, truth.names), "cluster").count, swaps);
}

TEST(MeasureCheck, AMemberThatIsNoneIsFound)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    expectFound(scene, truth, flipped(truth.values, "t_isolated", 31), "isolated", 31);
    expectFound(scene, truth, flipped(truth.values, "t_isolated", 18), "isolated", 18);
    expectFound(scene, truth, flipped(truth.values, "t_nonfinite", 17), "nonfinite", 17);
    expectFound(scene, truth, flipped(truth.values, "ellipsoids", 31), "ellipsoids", 31);
}

TEST(MeasureCheck, AMatrixThatIsNoRotationIsFound)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    const std::vector<std::uint8_t> members(truth.values.groups[0].members.get(),
                                            truth.values.groups[0].members.get() + scene.candidates.size());
    const auto ellipsoid =
        static_cast<std::size_t>(std::find(members.begin(), members.end(), 1) - members.begin());
    const std::vector<float> xform = numbersOf<float>(truth.values, "xform");
    const auto withColumns = [&](const std::array<int, 3>& order, const std::array<int, 3>& signs) {
        std::vector<float> other = xform;
        for (std::size_t row = 0; row < 3; ++row) {
            for (std::size_t k = 0; k < 3; ++k)
                other[9 * ellipsoid + 3 * row + k] =
                    static_cast<float>(signs[k]) *
                    xform[9 * ellipsoid + 3 * row + static_cast<std::size_t>(order[k])];
        }
        PointValues values = truth.values;
        for (PointAttribute& a : values.attributes) {
            if (a.name == "xform") a = attribute("xform", AttributeType::kMat3s, other);
        }
        return values;
    };
    expectFound(scene, truth, withColumns({0, 1, 2}, {1, 1, -1}), "xform", ellipsoid);  // a reflection
    expectFound(scene, truth, withColumns({0, 1, 2}, {-1, -1, 1}), "xform", ellipsoid); // signs
    expectFound(scene, truth, withColumns({1, 2, 0}, {1, 1, 1}), "xform", ellipsoid);   // other axes
    expectFound(scene, truth, withColumns({0, 0, 2}, {1, 1, 1}), "xform", ellipsoid);
}

TEST(MeasureCheck, ExamplesAreTheFirst)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    PointValues values = truth.values;
    for (PointAttribute& a : values.attributes) {
        if (a.name == "t_density") a = floats("t_density", std::vector<float>(scene.candidates.size(), -1));
    }
    const ValueFinding finding = findingOf(checked(scene, values, truth.names, {{}, 1, 3}), "density");
    EXPECT_EQ(finding.count, scene.candidates.size());
    ASSERT_EQ(finding.examples.size(), 3u);
    EXPECT_EQ(finding.examples[0].query, 0u);
    EXPECT_EQ(finding.examples[2].query, 2u);
}

TEST(MeasureCheck, ValuesThatCannotBeComparedAreRefused)
{
    const Case scene = randomCase();
    const Truth truth = bruteForce(scene);
    PointValues values = truth.values;
    values.attributes.erase(values.attributes.begin());
    EXPECT_THROW(checked(scene, values, {"count"}), InvalidInput);
    values.groups.clear();
    EXPECT_THROW(checked(scene, values, {"pca"}), InvalidInput);
    EXPECT_THROW(checked(scene, truth.values, {"heaviness"}), InvalidInput);
    EXPECT_THROW(checked(scene, truth.values, {"average:w"}), InvalidInput);
    values = {};
    values.attributes = {
        attribute("t_density", AttributeType::kDouble, std::vector<double>(scene.candidates.size()))};
    EXPECT_THROW(checked(scene, values, {"density"}), InputError);
    values.attributes = {floats("t_density", std::vector<float>(scene.candidates.size() - 1))};
    EXPECT_THROW(checked(scene, values, {"density"}), InputError);
    Case few = scene;
    few.nearest = 3;
    EXPECT_THROW(checked(few, truth.values, {"cluster"}), InvalidInput);
}

// ---- by hand ----------------------------------------------------------------------------------------------------------

// Of points, with the prefix "t_".
Case handCase(std::vector<Point> points, double radius)
{
    Case scene;
    scene.candidates = std::move(points);
    scene.radius = radius;
    scene.options.prefix = "t_";
    return scene;
}

void expectValues(const Case& scene, const std::string& name, const PointAttribute& values)
{
    PointValues claimed;
    claimed.attributes = {values};
    const MeasureReport report = checked(scene, claimed, {name});
    EXPECT_TRUE(report.passed()) << describe(report);
    EXPECT_EQ(report.findings.at(0).undetermined, 0u) << name;
}

TEST(MeasureCheck, TwoPointsHalfARadiusApart)
{
    struct Known {
        SmoothingKernel kernel;
        double density;
    };
    // W(0) + W(1/2) for R = 1, unit masses.
    for (const Known& known : {Known{SmoothingKernel::kCubic, 3.1830988618379067},      // 10 / pi
                               Known{SmoothingKernel::kWendland2, 3.9689263790},        // 399 / (32 pi)
                               Known{SmoothingKernel::kPoly6, 2.2276252167},            // 28665 / (4096 pi)
                               Known{SmoothingKernel::kTophat, 0.47746482927568600}}) { // 3 / (2 pi)
        Case scene = handCase({{0, 0, 0}, {0, 1, 0}}, 2);
        scene.options.kernel = known.kernel;
        const auto density = static_cast<float>(known.density / 8);
        expectValues(scene, "density", floats("t_density", {density, density}));
    }
    const Case scene = handCase({{0, 0, 0}, {0, 1, 0}}, 2);
    expectValues(scene, "normal", vectors("t_normal", {0, -1, 0, 0, 1, 0}));
    expectValues(scene, "mean_distance", floats("t_mean_distance", {1, 1}));
    expectValues(scene, "nearest", integers("t_nearest", {1, 0}));
    // W 4 : 1, so the mean is 1/5 away and the variance 4/25.
    expectValues(scene, "eigenvalues", vectors("t_eigenvalues", {0.16f, 0, 0, 0.16f, 0, 0}));
}

TEST(MeasureCheck, MassesAndSkippedValues)
{
    Case scene = handCase({{0, 0, 0}, {0.5, 0, 0}}, 1);
    scene.masses = {0, 2};
    expectValues(scene, "density",
                 floats("t_density", {static_cast<float>(4 / kPi), static_cast<float>(16 / kPi)}));
    scene.options.attributes = {floats("a", {std::numeric_limits<float>::quiet_NaN(), 5})};
    expectValues(scene, "average:a", floats("t_average:a", {5, 5}));
    scene.options.attributes = {integers("a", {10, 20})}; // W 4 : 1
    expectValues(scene, "average:a", floats("t_average:a", {12, 18}));
    scene.options.attributes = {attribute("a", AttributeType::kDouble, std::vector<double>{kNaN, HUGE_VAL})};
    expectValues(scene, "average:a",
                 attribute("t_average:a", AttributeType::kDouble, std::vector<double>{0, 0}));
}

TEST(MeasureCheck, OnePointAlone)
{
    Case scene = handCase({{1, 2, 3}}, 0.5);
    scene.options.attributes = {floats("a", {7})};
    expectValues(scene, "count", integers("t_count", {0}));
    expectValues(scene, "density", floats("t_density", {static_cast<float>(64 / kPi)}));
    expectValues(scene, "mean_distance", floats("t_mean_distance", {-1}));
    expectValues(scene, "nearest_distance", floats("t_nearest_distance", {-1}));
    expectValues(scene, "nearest", integers("t_nearest", {-1}));
    expectValues(scene, "average:a", floats("t_average:a", {7}));
    expectValues(scene, "normal", vectors("t_normal", {0, 0, 0}));
    expectValues(scene, "eigenvalues", vectors("t_eigenvalues", {0, 0, 0}));
    expectValues(scene, "cluster", integers("t_cluster", {0}));
    expectValues(scene, "cluster_size", integers("t_cluster_size", {1}));
}

// Values of pca for the points, of which the first is looked at; the others have its axes and are not there.
PointValues pcaOf(std::size_t count, const std::vector<float>& stretch, const std::vector<float>& xform,
                  const std::vector<double>& pws, bool isEllipsoid)
{
    const auto repeated = [&](auto values) {
        const auto one = values;
        for (std::size_t i = 1; i < count; ++i) values.insert(values.end(), one.begin(), one.end());
        return values;
    };
    PointValues values;
    values.attributes = {vectors("stretch", repeated(stretch)),
                         attribute("xform", AttributeType::kMat3s, repeated(xform)),
                         attribute("pws", AttributeType::kVec3d, repeated(pws))};
    values.groups = {group("ellipsoids", std::vector<std::uint8_t>(count, isEllipsoid))};
    return values;
}

MeasureReport checkedFirst(const Case& scene, const PointValues& values)
{
    MeasureClaims claims = claimsOf(scene, values, {"pca"});
    claims.isThere.assign(scene.candidates.size(), 0);
    claims.isThere[0] = 1;
    const SearchTerms terms = scene.terms();
    return verifyMeasures(terms, claims);
}

void expectPca(const Case& scene, const std::vector<float>& stretch, const std::vector<float>& xform,
               const std::vector<double>& pws, bool isEllipsoid = true)
{
    const MeasureReport report =
        checkedFirst(scene, pcaOf(scene.candidates.size(), stretch, xform, pws, isEllipsoid));
    EXPECT_TRUE(report.passed()) << describe(report);
}

const std::vector<float> kIdentity{1, 0, 0, 0, 1, 0, 0, 0, 1};

TEST(MeasureCheck, CoincidentPoints)
{
    Case scene = handCase({{1, 1, 1}, {1, 1, 1}, {1, 1, 1}}, 1);
    const auto density = static_cast<float>(24 / kPi);
    expectValues(scene, "density", floats("t_density", {density, density, density}));
    expectValues(scene, "nearest_distance", floats("t_nearest_distance", {0, 0, 0}));
    expectValues(scene, "nearest", integers("t_nearest", {1, 0, 0}));
    expectValues(scene, "eigenvalues", vectors("t_eigenvalues", std::vector<float>(9)));
    scene.options.pca.threshold = 3;
    expectPca(scene, {1, 1, 1}, kIdentity, {1, 1, 1});
    scene.options.pca.threshold = 4;
    scene.options.pca.stretch = 0.5;
    expectPca(scene, {0.5, 0.5, 0.5}, kIdentity, {1, 1, 1}, false);
    scene.options.pca.threshold = 0;
    expectPca(scene, {0.5, 0.5, 0.5}, kIdentity, {1, 1, 1}, false);
}

TEST(MeasureCheck, PrincipalAxesOfALineAPlaneAndALattice)
{
    Case line = handCase({{0, 0, 0}, {0, -1, 0}, {0, 1, 0}}, 2);
    line.options.pca.threshold = 3;
    const float along = 2.5198421f, across = 0.62996052f; // 1 and 1/4, over the cube root of 1/16
    expectPca(line, {along, across, across}, {0, 0, 1, 1, 0, 0, 0, 1, 0}, {0, 0, 0});
    EXPECT_FALSE(checkedFirst(line, pcaOf(3, {along, across, across}, kIdentity, {0, 0, 0}, true)).passed());
    Case end = line;
    end.candidates = {{0, -1, 0}, {0, 0, 0}, {0, 1, 0}};
    end.options.pca.average = 0.5; // weights 1, 7/8 and 0: the mean is 7/15 away
    expectPca(end, {along, across, across}, {0, 0, 1, 1, 0, 0, 0, 1, 0}, {0, -1 + 7.0 / 30, 0});

    std::vector<Point> plane{{0, 0, 0}}, lattice{{0, 0, 0}};
    for (int x = -1; x <= 1; ++x) {
        for (int y = -1; y <= 1; ++y) {
            for (int z = -1; z <= 1; ++z) {
                if (x == 0 && y == 0 && z == 0) continue;
                const Point point{double(x), double(y), double(z)};
                lattice.push_back(point);
                if (z == 0) plane.push_back(point);
            }
        }
    }
    Case flat = handCase(plane, 2);
    flat.options.pca.threshold = 9;
    const float broad = std::cbrt(4.f), thin = broad / 4; // 1 and 1/4, over the cube root of 1/4
    expectPca(flat, {broad, broad, thin}, kIdentity, {0, 0, 0});
    const float half = std::sqrt(0.5f);
    expectPca(flat, {broad, broad, thin}, {half, half, 0, half, -half, 0, 0, 0, -1},
              {0, 0, 0}); // another basis
    EXPECT_FALSE(
        checkedFirst(flat, pcaOf(9, {broad, broad, thin}, {1, 0, 0, 0, 0, -1, 0, 1, 0}, {0, 0, 0}, true))
            .passed());
    Case even = handCase(lattice, 2);
    expectPca(even, {1, 1, 1}, kIdentity, {0, 0, 0});
}

TEST(MeasureCheck, ALattice)
{
    std::vector<Point> points;
    std::vector<std::int32_t> counts, nearest;
    std::vector<float> ones;
    for (int x = 0; x < 3; ++x) {
        for (int y = 0; y < 3; ++y) {
            for (int z = 0; z < 3; ++z) {
                points.push_back({double(x), double(y), double(z)});
                counts.push_back((x == 1 ? 2 : 1) + (y == 1 ? 2 : 1) + (z == 1 ? 2 : 1));
                const int number = 9 * x + 3 * y + z;
                nearest.push_back(x > 0 ? number - 9 : y > 0 ? number - 3 : z > 0 ? number - 1 : number + 1);
                ones.push_back(1);
            }
        }
    }
    const Case scene = handCase(points, 1); // all neighbors at the radius, where W is 0
    expectValues(scene, "count", integers("t_count", counts));
    expectValues(scene, "nearest", integers("t_nearest", nearest));
    expectValues(scene, "mean_distance", floats("t_mean_distance", ones));
    expectValues(scene, "density", floats("t_density", std::vector<float>(27, static_cast<float>(8 / kPi))));
}

TEST(MeasureCheck, BorderPointsOfClusters)
{
    std::vector<Point> points;
    for (const double x : {0, 1, 2, 3, 5, 7, 8, 9, 10, 20}) points.push_back({x, 0, 0});
    Case scene = handCase(points, 2);
    scene.options.minNeighbors = 3; // cores: 1 2 3 and 7 8 9; 5 is a neighbor of 3 and of 7
    expectValues(scene, "cluster", integers("t_cluster", {0, 0, 0, 0, 0, 1, 1, 1, 1, -1}));
    expectValues(scene, "cluster_size", integers("t_cluster_size", {5, 5, 5, 5, 5, 4, 4, 4, 4, 0}));
    std::reverse(scene.candidates.begin(), scene.candidates.end()); // then 7 has the smaller number
    expectValues(scene, "cluster", integers("t_cluster", {-1, 0, 0, 0, 0, 0, 1, 1, 1, 1}));
    scene.options.minNeighbors.reset();
    expectValues(scene, "cluster", integers("t_cluster", {0, 1, 1, 1, 1, 1, 1, 1, 1, 1}));
    Case oneWay = handCase({{0, 0, 0}, {1, 0, 0}, {5, 0, 0}}, 0); // 1 does not reach 0, but 0 reaches 1
    oneWay.queryRadii = {2, 0.5, kNaN};
    expectValues(oneWay, "cluster", integers("t_cluster", {0, 0, 1}));
    oneWay.options.minNeighbors = 1; // 0 is the only core
    expectValues(oneWay, "cluster", integers("t_cluster", {0, 0, -1}));
}

// What is decided far from the origin, where positions have few digits, is still compared closely.
TEST(MeasureCheck, FarFromTheOrigin)
{
    Case scene = handCase({{1e9, 0, 0}, {1e9 + 0.5, 0, 0}}, 1);
    const auto density = static_cast<float>(10 / kPi);
    expectValues(scene, "density", floats("t_density", {density, density}));
    scene.options.pca.threshold = 9;
    expectPca(scene, {1, 1, 1}, kIdentity, {1e9 + 0.5 * 7 / 15, 0, 0}, false);
    EXPECT_FALSE(checkedFirst(scene, pcaOf(2, {1, 1, 1}, kIdentity, {1e9 + 0.5 * 7 / 15 + 1e-5, 0, 0}, false))
                     .passed());
}

} // namespace
} // namespace vdb_nns::testing
