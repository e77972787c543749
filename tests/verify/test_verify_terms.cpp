// `vdb_nns verify` on searches of two sets, with roles, radii of particles, the nearest K, rows by distance and self: what is
// right by brute force in rational numbers passes, and each fault is found.
#include "../support/distributions.h"
#include "../support/lists_writer.h"
#include "../support/oracle.h"
#include "set_source.h"
#include "vdb_nns/error.h"
#include "verify/independent_search.h"

#include <boost/multiprecision/cpp_int.hpp>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numeric>
#include <random>

namespace vdb_nns::testing {
namespace {

using boost::multiprecision::cpp_rational;
using cli::Fault;
using cli::SearchTerms;
using cli::VerifyReport;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

struct Scene {
    std::string name;
    PointSet queries, candidates;
    Vec3d queryTranslation{}, candidateTranslation{};
    bool isOneSet = false;
};

// All squared distances; nothing for pairs with a point that is not finite.
class Distances {
public:
    explicit Distances(const Scene& scene) : mColumns(scene.candidates.points.size())
    {
        std::vector<std::array<cpp_rational, 3>> columns;
        for (const ExactPoint& point : scene.candidates.points)
            columns.push_back(world(point, scene.candidates.linear, scene.candidateTranslation));
        for (const ExactPoint& point : scene.queries.points) {
            const auto row = world(point, scene.queries.linear, scene.queryTranslation);
            for (const auto& column : columns) {
                cpp_rational sum = 0;
                for (std::size_t k = 0; k < 3; ++k) sum += (row[k] - column[k]) * (row[k] - column[k]);
                mSquares.push_back(sum);
            }
        }
    }

    const cpp_rational& square(std::size_t query, std::size_t candidate) const
    {
        return mSquares[query * mColumns + candidate];
    }

private:
    static std::array<cpp_rational, 3> world(const ExactPoint& point, const Linear& linear,
                                             const Vec3d& translation)
    {
        std::array<cpp_rational, 3> result;
        if (!isFinite(point)) return result;
        for (std::size_t k = 0; k < 3; ++k) {
            result[k] = cpp_rational(translation[k]);
            for (std::size_t c = 0; c < 3; ++c) {
                result[k] += cpp_rational(linear[k][c]) *
                             (cpp_rational(point.voxel[c]) + cpp_rational(point.offset[c]));
            }
        }
        return result;
    }

    std::size_t mColumns;
    std::vector<cpp_rational> mSquares;
};

bool isUsable(double radius)
{
    return radius > 0 && std::isfinite(radius);
}

// Whether one of the radii that the mode reads reaches that far.
bool reaches(const SearchTerms& terms, std::size_t i, std::size_t j, const cpp_rational& square)
{
    const auto isWithin = [&](double radius) {
        return isUsable(radius) && square <= cpp_rational(radius) * cpp_rational(radius);
    };
    const Radius& radius = terms.radius;
    if (radius.isOne()) return isWithin(radius.value);
    return (radius.mode != RadiusMode::kScatter && isWithin(radius.ofQueries[i])) ||
           (radius.mode != RadiusMode::kGather && isWithin(radius.ofCandidates[j]));
}

// The rows by definition.
Lists bruteForce(const Scene& scene, const Distances& distances, const SearchTerms& terms)
{
    Lists rows(scene.queries.points.size());
    const auto isChosen = [](const ParticleSet& set, std::size_t i) {
        return set.chosen.empty() || set.chosen[i];
    };
    for (std::size_t i = 0; i < rows.size(); ++i) {
        if (!isFinite(scene.queries.points[i]) || !isChosen(terms.queries, i)) continue;
        const auto isNearer = [&](std::uint32_t a, std::uint32_t b) {
            const cpp_rational &one = distances.square(i, a), &other = distances.square(i, b);
            return one != other ? one < other : a < b;
        };
        std::vector<std::uint32_t>& row = rows[i];
        bool hasSelf = false;
        for (std::uint32_t j = 0; j < scene.candidates.points.size(); ++j) {
            if (!isFinite(scene.candidates.points[j]) || !isChosen(terms.candidates, j)) continue;
            if (scene.isOneSet && i == j) {
                hasSelf = terms.includeSelf;
            } else if (reaches(terms, i, j, distances.square(i, j))) {
                row.push_back(j);
            }
        }
        std::sort(row.begin(), row.end(), isNearer);
        if (terms.nearest && row.size() > terms.nearest) row.resize(terms.nearest);
        if (hasSelf) row.push_back(static_cast<std::uint32_t>(i));
        if (terms.byDistance) {
            std::sort(row.begin(), row.end(), isNearer);
        } else {
            std::sort(row.begin(), row.end());
        }
    }
    return rows;
}

std::vector<ExactPoint> latticePoints(int side, double step, double offset)
{
    std::vector<ExactPoint> points;
    for (int n = 0; n < side * side * side; ++n) {
        points.push_back({{n / (side * side), n / side % side, n % side}, {offset, 0, step * (n % 2)}});
    }
    return points;
}

std::vector<ExactPoint> randomPoints(std::mt19937& random, std::size_t count, int voxels)
{
    std::vector<ExactPoint> points;
    const auto below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
    for (std::size_t i = 0; i < count; ++i) {
        ExactPoint point;
        for (std::size_t k = 0; k < 3; ++k) {
            point.voxel[k] = below(voxels) - voxels / 2;
            point.offset[k] = static_cast<float>(below(4096)) / 4096.0F - 0.5F;
        }
        points.push_back(point);
    }
    points[3].offset[1] = kNaN;
    points[5] = points[4]; // coincident
    return points;
}

PointSet setOf(std::vector<ExactPoint> points, const Linear& linear, double radius)
{
    return {"", radius, std::move(points), linear};
}

std::vector<Scene> makeScenes()
{
    std::mt19937 random(7);
    const Linear half{{{0.5, 0, 0}, {0, 0.5, 0}, {0, 0, 0.5}}},
        mirrored{{{-0.25, 0, 0}, {0, 0.25, 0}, {0, 0, 0.25}}};
    const Linear sheared{{{0.3, 0.1, 0}, {0, 0.25, -0.05}, {0.02, 0, 0.4}}};
    std::vector<Scene> scenes;
    const auto one = [&](const char* name, const PointSet& set) {
        scenes.push_back({name, set, set, {}, {}, true});
    };
    one("lattice", setOf(latticePoints(4, 0, 0), half, 0.5));
    one("sheared", setOf(randomPoints(random, 60, 6), sheared, 0.7));
    one("mirrored", setOf(randomPoints(random, 60, 6), mirrored, 0.5));
    scenes.push_back({"two lattices",
                      setOf(latticePoints(4, 0, 0), mirrored, 0.5),
                      setOf(latticePoints(4, 0, 0), half, 0.5),
                      {1, 0.25, 0},
                      {0, 0, -0.5}});
    scenes.push_back({"two grids",
                      setOf(randomPoints(random, 50, 8), mirrored, 0.5),
                      setOf(randomPoints(random, 70, 6), sheared, 0.5),
                      {0.1, -0.2, 0.05},
                      {0.3, 0.1, 0}});
    scenes.push_back({"two grids far away",
                      setOf(randomPoints(random, 50, 8), mirrored, 0.5),
                      setOf(randomPoints(random, 70, 6), sheared, 0.5),
                      {1e7 + 0.1, -1e9, 3e5},
                      {1e7, -1e9, 3e5}});
    PointSet array = setOf({}, kIdentity, 0.4);
    for (int i = 0; i < 40; ++i) {
        const auto coordinate = [&] { return static_cast<double>(random()) / 4294967296.0 * 2 - 1; };
        array.points.push_back({{0, 0, 0}, {coordinate(), coordinate(), coordinate()}});
    }
    scenes.push_back(
        {"array and grid", array, setOf(randomPoints(random, 60, 6), sheared, 0.4), {}, {0.3, 0.1, 0}});
    scenes.push_back({"apart", array, setOf(randomPoints(random, 60, 6), sheared, 0.4), {}, {300, 0, 0}});
    scenes.push_back({"no candidates", array, setOf({}, half, 0.4), {}, {}});
    scenes.push_back({"no queries", setOf({}, half, 0.4), array, {}, {}});
    return scenes;
}

// Radii about that of the scene, some of them distances of pairs, and some that count as nothing.
std::vector<double> radiiOf(std::mt19937& random, std::size_t count, double radius, double spread)
{
    std::vector<double> radii;
    const double odd[] = {kNaN, kInf, -kInf, 0, -1, 1e305, 1e-305, 5e-324};
    for (std::size_t i = 0; i < count; ++i) {
        const double share = static_cast<double>(random()) / 4294967296.0;
        radii.push_back(i % 9 == 4 ? odd[random() % 8]
                        : i % 3    ? radius * std::pow(spread, share) / std::sqrt(spread)
                                   : radius);
    }
    return radii;
}

class VerifyTerms : public ::testing::Test {
protected:
    VerifyTerms()
    {
        mPath = ::testing::TempDir() + "vdb_nns_verify_terms_" +
                ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".npz";
    }
    ~VerifyTerms() override { std::filesystem::remove(mPath); }

    VerifyReport verify(const Scene& scene, const SearchTerms& terms, const Lists& rows,
                        const cli::VerifyOptions& options = {})
    {
        RawLists lists = rawLists(rows);
        lists.columns = scene.candidates.points.size();
        writeBytes(mPath, zipBytes(listMembers(lists)));
        return cli::verifyLists(terms, cli::ListsFile::open(mPath), options);
    }

    // use(scene, terms, right rows) for each combination.
    template <typename Use>
    void forEachCase(const Use& use)
    {
        std::mt19937 random(11);
        for (const Scene& scene : makeScenes()) {
            const Distances distances(scene);
            const ParticleView candidates = viewOf(scene.candidates);
            const ParticleView queries = scene.isOneSet ? candidates : viewOf(scene.queries);
            const std::size_t rows = queries.size(), columns = candidates.size();
            for (int number = 0; number < 48; ++number) {
                SCOPED_TRACE(scene.name + ", case " + std::to_string(number));
                SearchTerms terms{
                    queries, candidates, scene.queryTranslation, scene.candidateTranslation, {}, 0,
                    false,   false};
                std::vector<std::uint8_t> chosen[2];
                if (number % 3 == 1) {
                    for (std::size_t i = 0; i < rows; ++i) chosen[0].push_back(random() % 2);
                    for (std::size_t j = 0; j < columns; ++j) chosen[1].push_back(random() % 3 > 0);
                    terms.queries.chosen = {chosen[0].data(), rows};
                    if (number % 2) terms.candidates.chosen = {chosen[1].data(), columns};
                }
                const double spread = number % 8 < 4 ? 4 : 1e4;
                const std::vector<double> radii = radiiOf(random, rows, scene.candidates.radius, spread);
                const std::vector<double> others =
                    scene.isOneSet ? radii : radiiOf(random, columns, scene.candidates.radius, spread);
                terms.radius = scene.candidates.radius;
                if (number % 4 > 0 && rows > 0 && columns > 0) {
                    terms.radius.mode = static_cast<RadiusMode>(number % 4 - 1);
                    if (terms.radius.mode != RadiusMode::kScatter)
                        terms.radius.ofQueries = {radii.data(), rows};
                    if (terms.radius.mode != RadiusMode::kGather)
                        terms.radius.ofCandidates = {others.data(), columns};
                }
                const std::uint64_t nearest[] = {0, 1, 3, 1000};
                terms.nearest = nearest[number / 4 % 4];
                terms.byDistance = number / 16 % 2 == 1;
                terms.includeSelf = scene.isOneSet && number / 8 % 2 == 1;
                use(scene, terms, bruteForce(scene, distances, terms));
            }
        }
    }

    std::string mPath;
};

TEST_F(VerifyTerms, WhatIsRightPasses)
{
    std::uint64_t pairs = 0;
    forEachCase([&](const Scene& scene, const SearchTerms& terms, const Lists& rows) {
        cli::VerifyOptions sample;
        sample.sample = 30;
        for (const cli::VerifyOptions& options : {cli::VerifyOptions(), sample}) {
            const VerifyReport report = verify(scene, terms, rows, options);
            EXPECT_TRUE(report.passed());
            EXPECT_EQ(report.listedPairs, report.expectedPairs);
            EXPECT_EQ(report.queries, options.sample ? std::min<std::size_t>(rows.size(), 30) : rows.size());
            pairs += report.listedPairs;
        }
    });
    EXPECT_GT(pairs, 10000U);
}

TEST_F(VerifyTerms, APairLessIsMissingAndOneMoreExtra)
{
    std::mt19937 random(3);
    int found = 0;
    forEachCase([&](const Scene& scene, const SearchTerms& terms, const Lists& rows) {
        if (rows.empty() || scene.candidates.points.empty()) return;
        Lists wrong = rows;
        const std::size_t row = random() % rows.size();
        std::uint32_t stranger = 0;
        while (std::count(rows[row].begin(), rows[row].end(), stranger)) ++stranger;
        if (!rows[row].empty()) {
            const std::size_t at = random() % rows[row].size();
            wrong[row].erase(wrong[row].begin() + static_cast<std::ptrdiff_t>(at));
            const VerifyReport report = verify(scene, terms, wrong);
            EXPECT_EQ(report.faultCount(), 1U);
            ASSERT_EQ(report.finding(Fault::kMissing).count, 1U);
            EXPECT_EQ(report.finding(Fault::kMissing).examples[0].query, row);
            EXPECT_EQ(report.finding(Fault::kMissing).examples[0].neighbor, rows[row][at]);
            ++found;
        }
        if (stranger >= scene.candidates.points.size()) return;
        const bool isSelf = scene.isOneSet && !terms.includeSelf && stranger == row;
        wrong = rows;
        wrong[row].push_back(stranger);
        if (!terms.byDistance) std::sort(wrong[row].begin(), wrong[row].end());
        const VerifyReport report = verify(scene, terms, wrong);
        EXPECT_EQ(report.finding(isSelf ? Fault::kSelf : Fault::kExtra).count, 1U);
        EXPECT_EQ(report.faultCount(), 1U);
    });
    EXPECT_GT(found, 100);
}

TEST_F(VerifyTerms, TwoEntriesExchangedAreUnsorted)
{
    int found = 0;
    forEachCase([&](const Scene& scene, const SearchTerms& terms, const Lists& rows) {
        const auto row = std::find_if(rows.begin(), rows.end(), [](const auto& r) { return r.size() > 1; });
        if (row == rows.end()) return;
        Lists wrong = rows;
        std::vector<std::uint32_t>& changed = wrong[static_cast<std::size_t>(row - rows.begin())];
        std::swap(changed[changed.size() - 2], changed.back());
        const VerifyReport report = verify(scene, terms, wrong);
        EXPECT_EQ(report.finding(Fault::kUnsorted).count, 1U);
        EXPECT_EQ(report.faultCount(), 1U);
        ++found;
    });
    EXPECT_GT(found, 100);
}

// Six points on a line: 0 and 4 are equally far from 2.
TEST_F(VerifyTerms, TiesGoToTheSmallerNumber)
{
    Scene scene{"line", {"", 2.5, {}, kIdentity}, {}, {}, {}, true};
    for (int i = 0; i < 6; ++i) scene.queries.points.push_back({{0, 0, 0}, {double(i), 0, 0}});
    scene.candidates = scene.queries;
    SearchTerms terms;
    terms.queries = terms.candidates = viewOf(scene.queries);
    terms.radius = 2.5;
    terms.nearest = 3;
    const Lists right = {{1, 2}, {0, 2, 3}, {0, 1, 3}, {1, 2, 4}, {2, 3, 5}, {3, 4}};
    EXPECT_TRUE(verify(scene, terms, right).passed());
    Lists wrong = right;
    wrong[2] = {1, 3, 4};
    const VerifyReport report = verify(scene, terms, wrong);
    EXPECT_EQ(report.finding(Fault::kMissing).examples.at(0).neighbor, 0);
    EXPECT_EQ(report.finding(Fault::kExtra).examples.at(0).neighbor, 4);
    EXPECT_EQ(report.faultCount(), 2U);

    terms.byDistance = terms.includeSelf = true;
    Lists ordered = {{0, 1, 2}, {1, 0, 2, 3}, {2, 1, 3, 0}, {3, 2, 4, 1}, {4, 3, 5, 2}, {5, 4, 3}};
    EXPECT_TRUE(verify(scene, terms, ordered).passed());
    std::swap(ordered[2][1], ordered[2][2]); // as far, but not the smaller number
    EXPECT_EQ(verify(scene, terms, ordered).finding(Fault::kUnsorted).count, 1U);
    terms.includeSelf = false;
    EXPECT_EQ(verify(scene, terms, ordered).finding(Fault::kSelf).count, 6U);
}

TEST_F(VerifyTerms, DistancesBetweenTwoGridsAreChecked)
{
    for (const Scene& scene : makeScenes()) {
        if (scene.name != "two grids" && scene.name != "array and grid" && scene.name != "two lattices")
            continue;
        SearchTerms terms{viewOf(scene.queries),
                          viewOf(scene.candidates),
                          scene.queryTranslation,
                          scene.candidateTranslation,
                          scene.candidates.radius,
                          0,
                          true,
                          false};
        const Distances distances(scene);
        const Lists rows = bruteForce(scene, distances, terms);
        RawLists lists = rawLists(rows);
        lists.columns = scene.candidates.points.size();
        for (std::size_t i = 0; i < rows.size(); ++i) {
            for (const std::uint32_t j : rows[i]) {
                lists.distances.push_back(
                    static_cast<float>(std::sqrt(distances.square(i, j).convert_to<double>())));
            }
        }
        const auto check = [&] {
            writeBytes(mPath, zipBytes(listMembers(lists)));
            return cli::verifyLists(terms, cli::ListsFile::open(mPath)).finding(Fault::kWrongDistance).count;
        };
        ASSERT_GT(lists.distances.size(), 10U);
        EXPECT_EQ(check(), 0U) << scene.name;
        lists.distances[7] = std::nextafter(std::nextafter(lists.distances[7], 9.0F), 9.0F);
        EXPECT_EQ(check(), 1U) << scene.name;
    }
}

TEST_F(VerifyTerms, ListsOfAnotherShapeAreRefused)
{
    const Scene scene = makeScenes()[4];
    SearchTerms terms{viewOf(scene.queries), viewOf(scene.candidates), {}, {}, 1.0, 0, false, false};
    RawLists lists = rawLists(Lists(50));
    const auto errorOf = [&] {
        writeBytes(mPath, zipBytes(listMembers(lists)));
        try {
            cli::verifyLists(terms, cli::ListsFile::open(mPath));
        } catch (const InputError& e) {
            return std::string(e.what());
        }
        return std::string("none");
    };
    EXPECT_NE(errorOf().find("has 50 columns, but there are 70 points"), std::string::npos) << errorOf();
    lists = rawLists(Lists(51));
    lists.columns = 70;
    EXPECT_NE(errorOf().find("has 51 rows, but there are 50 queries"), std::string::npos) << errorOf();
    lists = rawLists(Lists(50));
    lists.columns = 70;
    const std::vector<double> radii(49, 1.0);
    terms.radius.ofQueries = {radii.data(), radii.size()};
    writeBytes(mPath, zipBytes(listMembers(lists)));
    EXPECT_THROW(cli::verifyLists(terms, cli::ListsFile::open(mPath)), InvalidInput);
}

} // namespace
} // namespace vdb_nns::testing
