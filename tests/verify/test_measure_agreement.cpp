// The engine's measures against the independent check of `vdb_nns verify`: on every distribution and under several transforms,
// with every kernel, radii of particles, roles, two sets, the nearest, and DBSCAN.
#include "../agreement/point_views.h"
#include "../support/distributions.h"
#include "../support/oracle.h"
#include "../support/tiny_rows.h"
#include "set_source.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/search.h"
#include "verify/measure_check.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <memory>
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

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// A set somewhere in the world.
class PlacedSource final : public SetSource {
public:
    PlacedSource(const PointSet& set, const Vec3d& translation) : SetSource(set)
    {
        mTranslation = translation;
    }
};

struct Distribution {
    PointSet set;
    bool isGrid;
};

// A set as an array of doubles or as a grid, moved aside.
struct Placed {
    std::vector<double> array;
    Vec3d translation{};
    ParticleView view;

    explicit Placed(const Distribution& set, const Vec3d& aside = {})
    {
        if (set.isGrid) {
            translation = aside;
            view = ParticleView(std::make_shared<PlacedSource>(set.set, aside));
            return;
        }
        array = doublesOf(set.set);
        for (std::size_t k = 0; k < array.size(); ++k) array[k] += aside[k % 3];
        view = ParticleView::fromArray(array.data(), array.size() / 3);
    }
    Placed(const Placed&) = delete;
    Placed& operator=(const Placed&) = delete;
};

// Attributes of each type that has an average, and masses.
struct Values {
    std::vector<float> f, v;
    std::vector<double> d, w, masses;
    std::vector<std::int32_t> i;

    explicit Values(std::size_t count)
    {
        std::mt19937 random(11);
        std::normal_distribution<double> normal;
        for (std::size_t k = 0; k < count; ++k) {
            f.push_back(static_cast<float>(1000 + normal(random)));
            d.push_back(std::ldexp(normal(random), static_cast<int>(random() % 40)));
            i.push_back(static_cast<std::int32_t>(random() % 1000) - 500);
            masses.push_back(k % 5 == 0 ? 0 : std::fabs(normal(random)));
            for (int c = 0; c < 3; ++c) {
                v.push_back(static_cast<float>(normal(random)));
                w.push_back(normal(random));
            }
        }
        for (std::size_t k = 7; k < count; k += 31) v[3 * k + k % 3] = kNaN;
    }

    std::vector<PointAttribute> attributes() const
    {
        const std::uint64_t count = f.size();
        return {viewAttribute("f", AttributeType::kFloat, f.data(), count),
                viewAttribute("d", AttributeType::kDouble, d.data(), count),
                viewAttribute("v", AttributeType::kVec3s, v.data(), count),
                viewAttribute("w", AttributeType::kVec3d, w.data(), count),
                viewAttribute("i", AttributeType::kInt32, i.data(), count)};
    }
};

const std::vector<std::string>& rowMeasures()
{
    static const std::vector<std::string> names{"count",     "density",   "mean_distance", "nearest_distance",
                                                "nearest",   "average:f", "average:d",     "average:v",
                                                "average:w", "average:i", "normal",        "eigenvalues",
                                                "pca",       "isolated",  "nonfinite"};
    return names;
}

std::string describe(const MeasureReport& report)
{
    std::string text;
    for (const ValueFinding& finding : report.findings) {
        if (finding.count == 0) continue;
        char line[256];
        std::snprintf(line, sizeof line, "%s: %d of %d\n", finding.name.c_str(),
                      static_cast<int>(finding.count), static_cast<int>(finding.checked));
        text += line;
        for (const cli::ValueExample& example : finding.examples) {
            std::snprintf(line, sizeof line, "    %d [%d]: %.17g, expected %.17g within %g %s\n",
                          static_cast<int>(example.query), static_cast<int>(example.component), example.value,
                          example.expected, example.bound, example.what.c_str());
            text += line;
        }
    }
    return text;
}

// What is searched, and the translations of both views.
struct Scene {
    ParticleSet queries, candidates;
    Radius radius;
    Vec3d queryTranslation{}, candidateTranslation{};
};

void expectAgreement(const Scene& scene, const std::vector<std::string>& names, MeasureOptions options)
{
    SearchTerms terms;
    terms.queries = scene.queries;
    terms.candidates = scene.candidates;
    terms.queryTranslation = scene.queryTranslation;
    terms.candidateTranslation = scene.candidateTranslation;
    terms.radius = scene.radius;
    terms.nearest = options.search.nearest;
    SearchEngine engine;
    const SearchSets sets = engine.sort(scene.candidates, scene.queries, scene.radius, options.search);
    MeasureClaims claims;
    claims.names = names;
    claims.options = options;
    claims.values = engine.measure(sets, names, options).values;
    const MeasureReport report = cli::verifyMeasures(terms, claims, {{}, 1, 3});
    EXPECT_TRUE(report.passed()) << describe(report);
    for (const ValueFinding& finding : report.findings) {
        if (finding.name == "density") {
            EXPECT_EQ(finding.undetermined, 0u);
        }
    }
}

std::vector<std::string> withClusters()
{
    std::vector<std::string> names = rowMeasures();
    names.insert(names.end(), {"cluster", "cluster_size"});
    return names;
}

void expectAgreement(const Placed& all, double radius, const MeasureOptions& options)
{
    expectAgreement({all.view, all.view, Radius(radius), all.translation, all.translation}, withClusters(),
                    options);
}

std::vector<Distribution> allSets()
{
    std::vector<Distribution> sets;
    for (PointSet& set : arraySets(Precision::kDouble)) sets.push_back({std::move(set), false});
    for (PointSet& set : gridSets()) sets.push_back({roundedToFloats(std::move(set)), true});
    return sets;
}

TEST(MeasureAgreement, EveryDistribution)
{
    for (const Distribution& set : allSets()) {
        SCOPED_TRACE(set.set.name);
        const Values values(set.set.points.size());
        const Placed all(set, {3, -2, 0.125});
        MeasureOptions options;
        options.attributes = values.attributes();
        options.mass = 0.5;
        expectAgreement(all, set.set.radius, options);
        options.pca = {0.5, 2, 3, 0.3};
        options.minNeighbors = 4;
        options.masses = {values.masses.data(), values.masses.size()};
        options.kernel = SmoothingKernel::kWendland2;
        expectAgreement(all, set.set.radius, options);
    }
}

TEST(MeasureAgreement, RowsOfTinyTerms)
{
    for (const double radius : {0.1, 1e-60, 1e60}) {
        SCOPED_TRACE(radius);
        const std::vector<double> xyz = rowsOfTinyTerms(radius);
        const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
        const Values values(view.size());
        MeasureOptions options;
        options.attributes = values.attributes();
        options.pca = {0.5, 1, 2, 0.01};
        expectAgreement({view, view, Radius(radius)}, withClusters(), options);
    }
}

TEST(MeasureAgreement, OtherKernelsAndTheNearest)
{
    for (const Distribution& set : allSets()) {
        SCOPED_TRACE(set.set.name);
        const Values values(set.set.points.size());
        const Placed all(set);
        MeasureOptions options;
        options.attributes = values.attributes();
        options.prefix = "p_";
        options.pca.threshold = 1;
        for (const auto kernel : {SmoothingKernel::kPoly6, SmoothingKernel::kTophat}) {
            options.kernel = kernel;
            expectAgreement(all, set.set.radius, options);
        }
        options.search.nearest = 5;
        expectAgreement({all.view, all.view, Radius(set.set.radius)}, rowMeasures(), options);
    }
}

TEST(MeasureAgreement, RadiiOfParticles)
{
    for (const Distribution& set : allSets()) {
        SCOPED_TRACE(set.set.name);
        const std::size_t count = set.set.points.size();
        if (count == 0) continue; // of nobody there are no radii
        const Values values(count);
        const Placed all(set);
        MeasureOptions options;
        options.attributes = values.attributes();
        options.pca.threshold = 4;
        std::vector<double> radii(count);
        for (std::size_t i = 0; i < count; ++i) {
            radii[i] = set.set.radius * std::ldexp(1.0, -static_cast<int>(i % 4));
            if (i % 17 == 3) radii[i] = -1;
            if (i % 19 == 4) radii[i] = kNaN;
        }
        for (const auto mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
            SCOPED_TRACE(static_cast<int>(mode));
            Radius radius;
            radius.mode = mode;
            radius.ofQueries = radius.ofCandidates = {radii.data(), count};
            options.minNeighbors.reset();
            expectAgreement({all.view, all.view, radius}, withClusters(), options);
            options.minNeighbors = 3;
            expectAgreement({all.view, all.view, radius}, {"cluster", "cluster_size"}, options);
        }
    }
}

TEST(MeasureAgreement, RolesAndTwoSets)
{
    for (const Distribution& set : allSets()) {
        SCOPED_TRACE(set.set.name);
        const std::size_t count = set.set.points.size();
        const double radius = set.set.radius;
        const Values values(count);
        const Placed all(set), aside(set, {0.3 * radius, -0.2 * radius, 0.1 * radius});
        MeasureOptions options;
        options.attributes = values.attributes();
        options.pca.threshold = 3;
        std::vector<std::uint8_t> asks(count), isAmong(count);
        for (std::size_t i = 0; i < count; ++i) asks[i] = i % 3 != 1, isAmong[i] = i % 4 != 2;
        expectAgreement(
            {{all.view, {asks.data(), count}}, {all.view, {isAmong.data(), count}}, Radius(radius)},
            rowMeasures(), options);
        expectAgreement({aside.view, all.view, Radius(radius), aside.translation, {}}, rowMeasures(),
                        options);
    }
}

} // namespace
} // namespace vdb_nns::testing
