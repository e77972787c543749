// The search of two sets against the exact oracle: roles, radii of particles in three modes, two sets with transforms of their own,
// the nearest, the query in its own list; on every distribution, form of input, reach, instruction set and encoding. And what
// must hold whatever the answer is.
#include "agreement/point_views.h"
#include "support/comparator.h"
#include "support/set_oracle.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <random>
#include <string>

namespace vdb_nns::testing {

namespace {

// A view of voxels somewhere in the world.
class PlacedSource final : public ParticleSource {
public:
    PlacedSource(const PointSet& set, const std::array<double, 3>& translation) : mVoxels(set)
    {
        mSize = mVoxels.size();
        mLinear = mVoxels.linear();
        mReference = mVoxels.reference();
        mIsArray = false;
        mTranslation = {translation[0], translation[1], translation[2]};
    }
    StoredPosition stored(std::size_t i) const override { return mVoxels.stored(i); }
    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override
    {
        mVoxels.read(begin, count, reference, x, y, z);
    }

private:
    VoxelSource mVoxels;
};

RadiusMode modeOf(OracleMode mode)
{
    return mode == OracleMode::kGather    ? RadiusMode::kGather
           : mode == OracleMode::kScatter ? RadiusMode::kScatter
                                          : RadiusMode::kSymmetric;
}

template <typename T>
Span<const T> spanOf(const std::vector<T>& values)
{
    return {values.data(), values.size()};
}

// A problem as the engine takes it.
struct EngineProblem {
    ParticleView queryView, candidateView;
    std::vector<std::uint8_t> queryChosen, candidateChosen;
    const SetProblem& problem;

    EngineProblem(const SetProblem& setProblem, const ParticleView& queries, const ParticleView& candidates)
        : queryView(queries),
          candidateView(candidates),
          queryChosen(setProblem.queries.chosen.begin(), setProblem.queries.chosen.end()),
          candidateChosen(setProblem.candidates.chosen.begin(), setProblem.candidates.chosen.end()),
          problem(setProblem)
    {
    }

    ParticleSet queries() const { return {queryView, spanOf(queryChosen)}; }
    ParticleSet candidates() const { return {candidateView, spanOf(candidateChosen)}; }
    Radius radius() const
    {
        Radius radius = problem.radius;
        radius.ofQueries = spanOf(problem.queries.radii);
        radius.ofCandidates = spanOf(problem.candidates.radii);
        radius.mode = modeOf(problem.mode);
        return radius;
    }
    SearchOptions options() const
    {
        SearchOptions options;
        options.nearest = static_cast<std::uint32_t>(problem.nearest);
        options.includeSelf = problem.includeSelf;
        return options;
    }
};

Lists listsOf(const NeighborLists& lists)
{
    Lists result(lists.size());
    for (std::size_t i = 0; i < lists.size(); ++i) {
        lists.neighbors(i, result[i]);
        std::sort(result[i].begin(), result[i].end());
    }
    return result;
}

void expectAnswer(const NeighborLists& lists, const SetAnswer& answer, const SetProblem& problem,
                  const std::string& what)
{
    ASSERT_EQ(lists.size(), problem.queries.points.size()) << what;
    const ListStatistics& statistics = lists.statistics();
    EXPECT_EQ(statistics.shortened, answer.shortened) << what;
    EXPECT_EQ(statistics.isolated, answer.isolated) << what;
    EXPECT_EQ(statistics.min, answer.min) << what;
    EXPECT_EQ(statistics.max, answer.max) << what;
    const double queries = static_cast<double>(std::max<std::uint64_t>(answer.finiteQueries, 1));
    EXPECT_EQ(statistics.mean, static_cast<double>(answer.neighbors) / queries) << what;
    std::uint64_t pairs = 0;
    for (std::size_t i = 0; i < lists.size(); ++i) {
        const std::vector<std::uint32_t>& row = answer.byNumber[i];
        pairs += row.size();
        const bool hasSelf = problem.includeSelf && std::binary_search(row.begin(), row.end(), i);
        ASSERT_EQ(lists.count(i), row.size() - hasSelf) << what << ", query " << i;
    }
    EXPECT_EQ(statistics.pairs, pairs) << what;
    if (lists.encoding() == Encoding::kNone) return;
    const Lists found = listsOf(lists);
    for (std::size_t i = 0; i < found.size(); ++i)
        ASSERT_EQ(found[i], answer.byNumber[i]) << what << ", query " << i;
    const Csr csr = lists.toCsr();
    std::uint64_t visited = 0;
    for (std::size_t i = 0; i < found.size(); ++i) {
        ASSERT_EQ(csr.offsets[i + 1] - csr.offsets[i], found[i].size()) << what;
        ASSERT_TRUE(std::equal(found[i].begin(), found[i].end(),
                               csr.indices.begin() + static_cast<std::ptrdiff_t>(csr.offsets[i])));
        visited += found[i].size();
    }
    EXPECT_EQ(visited, pairs);
}

void expectRight(const EngineProblem& engineProblem, const std::string& what)
{
    const SetProblem& problem = engineProblem.problem;
    const SetAnswer answer = setOracle(problem);
    SearchEngine engine;
    for (const double cellSize : {0.0, 1.0, 0.5, 0.4, 2.5}) {
        SearchOptions options = engineProblem.options();
        options.cellSize = cellSize;
        SearchSets sets;
        try {
            sets = engine.sort(engineProblem.candidates(), engineProblem.queries(), engineProblem.radius(),
                               options);
        } catch (const InputError&) { // too many cells from end to end
            ASSERT_NE(cellSize, 0) << what;
            continue;
        }
        // Every instruction set in cells of one size, the best in all.
        const int best = static_cast<int>(bestSimdLevel());
        for (int level = cellSize == 0.5 ? 0 : best; level <= best; ++level) {
            options.simd = static_cast<SimdLevel>(level);
            for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
                if (encoding == Encoding::kMask && problem.nearest > 0) continue;
                options.encoding = encoding;
                expectAnswer(engine.search(sets, options), answer, problem,
                             what + ", cells of " + std::to_string(cellSize) + ", level " +
                                 std::to_string(level) + ", encoding " +
                                 std::to_string(static_cast<int>(encoding)));
                if (::testing::Test::HasFatalFailure()) return;
            }
        }
    }
}

std::vector<char> someOf(std::size_t count, double share, std::mt19937& random)
{
    std::vector<char> chosen(count);
    for (char& c : chosen) c = std::uniform_real_distribution<>()(random) < share;
    return chosen;
}

// Around a radius, over `octaves`, with some that reach nobody.
std::vector<double> someRadii(std::size_t count, double radius, double octaves, std::mt19937& random)
{
    std::vector<double> radii(count);
    for (double& r : radii) {
        const double draw = std::uniform_real_distribution<>()(random);
        r = draw < 0.02   ? std::nan("")
            : draw < 0.04 ? 0
            : draw < 0.06 ? -radius
            : draw < 0.08 ? HUGE_VAL
            : draw < 0.4  ? radius
                          : radius * std::exp2(-octaves * std::uniform_real_distribution<>()(random));
    }
    return radii;
}

struct Case {
    PointSet set;
    Form form;
};

const std::vector<Case>& cases()
{
    static const std::vector<Case> kCases = [] {
    // Of the distributions under each linear map every fourth one, with others under the next; under a sanitizer fewer.
#if defined(__SANITIZE_ADDRESS__)
        constexpr std::size_t kStep = 13;
#else
        constexpr std::size_t kStep = 4;
#endif
        std::size_t taken = 0;
        std::vector<Case> all;
        for (const PointSet& set : arraySets(Precision::kFloat, 5))
            all.push_back({roundedToFloats(set), Form::kFloats});
        for (const PointSet& set : arraySets(Precision::kDouble, 6)) all.push_back({set, Form::kDoubles});
        for (const PointSet& set : gridSets(7)) {
            if (taken++ % kStep == 0) all.push_back({set, Form::kVoxels});
        }
        return all;
    }();
    return kCases;
}

class Sets : public ::testing::TestWithParam<std::size_t> {
protected:
    const PointSet& set() const { return cases()[GetParam()].set; }
    SetProblem problem() const
    {
        SetProblem problem;
        problem.queries.points = problem.candidates.points = set().points;
        problem.queries.linear = problem.candidates.linear = set().linear;
        problem.radius = set().radius;
        return problem;
    }
    void expect(const SetProblem& problem, const std::string& what) const
    {
        const SetView input(set(), cases()[GetParam()].form);
        expectRight(EngineProblem(problem, input.view(), input.view()), set().name + ": " + what);
    }
    std::mt19937 random{static_cast<std::uint32_t>(GetParam())};
};

TEST_P(Sets, RolesAreKept)
{
    SetProblem roles = problem();
    const std::size_t n = set().points.size();
    roles.queries.chosen = someOf(n, 0.2, random);
    expect(roles, "some queries");
    roles.candidates.chosen = someOf(n, 0.5, random);
    expect(roles, "some of both");
    roles.includeSelf = true;
    expect(roles, "some of both, with themselves");
    roles.queries.chosen.clear();
    expect(roles, "some candidates, with themselves");
    roles.candidates.chosen.assign(n, 0);
    expect(roles, "no candidates");
}

TEST_P(Sets, RadiiOfParticlesDecide)
{
    const std::size_t n = set().points.size();
    for (const OracleMode mode : {OracleMode::kGather, OracleMode::kScatter, OracleMode::kSymmetric}) {
        SetProblem radii = problem();
        radii.mode = mode;
        radii.queries.radii = radii.candidates.radii = someRadii(n, set().radius, 4, random);
        expect(radii, "radii, mode " + std::to_string(static_cast<int>(mode)));
        radii.includeSelf = true;
        expect(radii, "radii, with themselves, mode " + std::to_string(static_cast<int>(mode)));
        radii.queries.chosen = someOf(n, 0.6, random);
        radii.nearest = 3;
        expect(radii, "radii and roles, mode " + std::to_string(static_cast<int>(mode)));
    }
}

TEST_P(Sets, TheNearestAreKept)
{
    for (const std::size_t nearest : {1, 3, 20}) {
        SetProblem some = problem();
        some.nearest = nearest;
        expect(some, "nearest " + std::to_string(nearest));
        some.includeSelf = true;
        expect(some, "nearest " + std::to_string(nearest) + " with themselves");
    }
}

INSTANTIATE_TEST_SUITE_P(All, Sets, ::testing::Range<std::size_t>(0, cases().size()),
                         [](const ::testing::TestParamInfo<std::size_t>& info) {
                             std::string name = std::to_string(info.param) + "_";
                             for (const char c : cases()[info.param].set.name)
                                 name += std::isalnum(static_cast<unsigned char>(c)) ? c : '_';
                             return name;
                         });

// Two sets of voxels with transforms and places of their own, and arrays among them.
TEST(TwoSets, TransformsOfTheirOwnAreExact)
{
    std::mt19937 random(11);
    const std::vector<PointSet> grids = gridSets(8);
    const auto uniform = [&](double low, double high) {
        return std::uniform_real_distribution<>(low, high)(random);
    };
    for (std::size_t trial = 0; trial < 60; ++trial) {
        const PointSet& a = grids[random() % grids.size()];
        PointSet b = grids[random() % grids.size()];
        if (trial % 3 == 0) b.linear = a.linear; // then the translation alone differs
        SetProblem problem;
        problem.areSame = false;
        problem.queries.points = a.points;
        problem.queries.linear = a.linear;
        problem.candidates.points = b.points;
        problem.candidates.linear = b.linear;
        for (std::size_t k = 0; k < 3; ++k) {
            problem.queries.translation[k] = trial % 4 == 0 ? 0 : uniform(-3, 3) * a.radius;
            problem.candidates.translation[k] = trial % 5 == 0 ? 1 : uniform(-3, 3) * b.radius;
        }
        problem.radius = a.radius;
        if (trial % 2) problem.nearest = 1 + random() % 9;
        if (trial % 3 == 1) {
            problem.queries.radii = someRadii(a.points.size(), a.radius, 3, random);
            problem.candidates.radii = someRadii(b.points.size(), a.radius, 3, random);
            problem.mode = static_cast<OracleMode>(random() % 3);
        }
        const ParticleView queries(std::make_shared<PlacedSource>(a, problem.queries.translation));
        const ParticleView candidates(std::make_shared<PlacedSource>(b, problem.candidates.translation));
        expectRight(EngineProblem(problem, queries, candidates),
                    "trial " + std::to_string(trial) + ": " + a.name + " among " + b.name);
        if (HasFatalFailure()) return;
    }
}

// Lattices whose points coincide, or lie at the radius exactly, though they are stored in voxels of different sizes.
TEST(TwoSets, TiesAreDecidedExactly)
{
    PointSet fine, coarse;
    for (int i = 0; i < 12 * 12 * 12; ++i) {
        ExactPoint p;
        p.voxel = {i / 144 - 6, i / 12 % 12 - 6, i % 12 - 6};
        fine.points.push_back(p);
        if (i % 2) coarse.points.push_back(p);
    }
    for (std::size_t k = 0; k < 3; ++k) {
        fine.linear[k] = coarse.linear[k] = {0, 0, 0};
        fine.linear[k][k] = 0.1;
        coarse.linear[k][k] = k == 1 ? -0.2 : 0.2;
    }
    SetProblem problem;
    problem.areSame = false;
    problem.queries.points = fine.points;
    problem.queries.linear = fine.linear;
    problem.candidates.points = coarse.points;
    problem.candidates.linear = coarse.linear;
    problem.candidates.translation = {0.1, 0, 0.3};
    const ParticleView queries(std::make_shared<PlacedSource>(fine, problem.queries.translation));
    const ParticleView candidates(std::make_shared<PlacedSource>(coarse, problem.candidates.translation));
    for (const double radius : {0.2, 0.1 + 0.1, 0.3, 0.1 * 3}) {
        problem.radius = radius;
        problem.nearest = 0;
        expectRight(EngineProblem(problem, queries, candidates), "ties at " + std::to_string(radius));
        problem.nearest = 5;
        expectRight(EngineProblem(problem, queries, candidates),
                    "nearest of ties at " + std::to_string(radius));
    }
}

// Points in boxes within boxes, with radii as wide as their own box: lattices that are up to 2^26 times as wide as others, and none in
// between.
TEST(NestedLattices, AreExact)
{
    std::mt19937 random(17);
    std::uniform_real_distribution<> place(-1, 1), share(0.3, 0.6);
    PointSet set;
    std::vector<double> radii;
    for (const int octaves : {0, 1, 2, 3, 4, 9, 26}) {
        for (int i = 0; i < 45; ++i) {
            ExactPoint p;
            for (double& x : p.offset) x = std::ldexp(place(random), -octaves);
            set.points.push_back(p);
            radii.push_back(std::ldexp(share(random), -octaves));
        }
    }
    radii[3] = std::nan("");
    radii[100] = 0;
    set = roundedToFloats(set);
    const auto radiusOf = [&](OracleMode mode) {
        Radius radius;
        radius.ofQueries = radius.ofCandidates = spanOf(radii);
        radius.mode = modeOf(mode);
        return radius;
    };
    for (const Form form : {Form::kDoubles, Form::kVoxels}) {
        set.name = nameOf(form);
        if (form == Form::kVoxels) set.linear = linearMaps().back().linear;
        const SetView input(set, form);
        for (const OracleMode mode : {OracleMode::kScatter, OracleMode::kSymmetric}) {
            EXPECT_GE(SearchEngine().sort(input.view(), input.view(), radiusOf(mode)).latticeCount(), 7u);
            SetProblem problem;
            problem.queries.points = problem.candidates.points = set.points;
            problem.queries.linear = problem.candidates.linear = set.linear;
            problem.queries.radii = problem.candidates.radii = radii;
            problem.mode = mode;
            for (const std::size_t nearest : {0, 1, 7, 300}) {
                problem.nearest = nearest;
                problem.includeSelf = nearest != 1;
                expectRight(EngineProblem(problem, input.view(), input.view()),
                            set.name + ", mode " + std::to_string(static_cast<int>(mode)) + ", nearest " +
                                std::to_string(nearest));
                if (HasFatalFailure()) return;
            }
        }
    }
}

// What must hold, whatever the lists are: on a few thousand particles.
class SetInvariance : public ::testing::Test {
protected:
    void SetUp() override
    {
        std::mt19937 random(3);
        std::uniform_real_distribution<float> place(0, 1);
        for (int i = 0; i < 3 * 6000; ++i) mPositions.push_back(place(random) * place(random));
        for (int i = 0; i < 6000; ++i) mRadii.push_back(0.05 * std::exp2(-6 * place(random)));
        for (int i = 0; i < 6000; ++i) mGroup.push_back(static_cast<std::uint8_t>(random() % 3));
        mView = ParticleView::fromArray(mPositions.data(), 6000);
    }
    std::vector<std::uint8_t> group(int g) const
    {
        std::vector<std::uint8_t> chosen;
        for (const std::uint8_t of : mGroup) chosen.push_back(of == g);
        return chosen;
    }
    Radius radii(RadiusMode mode) const
    {
        Radius radius;
        radius.ofQueries = radius.ofCandidates = spanOf(mRadii);
        radius.mode = mode;
        return radius;
    }

    std::vector<float> mPositions;
    std::vector<double> mRadii;
    std::vector<std::uint8_t> mGroup;
    ParticleView mView;
};

TEST_F(SetInvariance, ScatterIsTheTransposeOfGather)
{
    const Lists gather = listsOf(search(mView, mView, radii(RadiusMode::kGather)));
    const Lists scatter = listsOf(search(mView, mView, radii(RadiusMode::kScatter)));
    Lists transpose(gather.size());
    for (std::uint32_t i = 0; i < gather.size(); ++i) {
        for (const std::uint32_t j : gather[i]) transpose[j].push_back(i);
    }
    EXPECT_EQ(scatter, transpose);
}

// As many rows at once as the memory of a thread holds, and the next ones then: of a crowd with radii of its own among others.
TEST(NestedLattices, CrowdsAreSearchedInParts)
{
    constexpr std::uint32_t kCrowd = 9000, kOthers = 100;
    std::vector<float> positions(3 * kCrowd, 0.5f);
    std::vector<double> radii(kCrowd, 0.01);
    for (std::uint32_t i = 0; i < kOthers; ++i) {
        for (int k = 0; k < 3; ++k)
            positions.push_back(0.5f + 0.25f * static_cast<float>(k == 0) * i / kOthers);
        radii.push_back(0.3);
    }
    const ParticleView view = ParticleView::fromArray(positions.data(), kCrowd + kOthers);
    Radius radius;
    radius.ofQueries = radius.ofCandidates = spanOf(radii);
    radius.mode = RadiusMode::kScatter;
    SearchOptions options;
    options.encoding = Encoding::kNone;
    const std::vector<std::uint32_t> counts = search(view, view, radius, options).counts();
    SearchEngine engine;
    std::atomic<std::uint32_t> wrong{0};
    engine.visitRows(engine.sort(view, view, radius),
                     [&](std::uint32_t query, Span<const std::uint32_t> row) {
                         std::vector<std::uint32_t> numbers(row.begin(), row.end());
                         std::sort(numbers.begin(), numbers.end());
                         const bool isSet = std::unique(numbers.begin(), numbers.end()) == numbers.end();
                         wrong += !isSet || numbers.size() != counts[query] ||
                                  std::binary_search(numbers.begin(), numbers.end(), query);
                     });
    EXPECT_EQ(wrong, 0u);
    for (std::uint32_t i = 0; i < kCrowd; ++i) ASSERT_EQ(counts[i], kCrowd - 1 + kOthers);
}

TEST_F(SetInvariance, SymmetricIsSymmetric)
{
    const Lists lists = listsOf(search(mView, mView, radii(RadiusMode::kSymmetric)));
    for (std::uint32_t i = 0; i < lists.size(); ++i) {
        for (const std::uint32_t j : lists[i])
            ASSERT_TRUE(std::binary_search(lists[j].begin(), lists[j].end(), i)) << i << " " << j;
    }
}

TEST_F(SetInvariance, GroupsAddUp)
{
    const Lists whole = listsOf(search(mView, mView, 0.04));
    Lists sum(whole.size());
    for (int q = 0; q < 3; ++q) {
        for (int c = 0; c < 3; ++c) {
            const std::vector<std::uint8_t> queries = group(q), candidates = group(c);
            const Lists part = listsOf(search({mView, spanOf(candidates)}, {mView, spanOf(queries)}, 0.04));
            for (std::size_t i = 0; i < part.size(); ++i)
                sum[i].insert(sum[i].end(), part[i].begin(), part[i].end());
        }
    }
    for (std::vector<std::uint32_t>& row : sum) std::sort(row.begin(), row.end());
    EXPECT_EQ(sum, whole);
}

TEST_F(SetInvariance, SoManyNearestAreAll)
{
    SearchOptions options;
    options.nearest = 6000;
    const NeighborLists all = findNeighbors(mView, 0.04), nearest = search(mView, mView, 0.04, options);
    EXPECT_EQ(listsOf(nearest), listsOf(all));
    EXPECT_EQ(nearest.statistics().shortened, 0u);
}

TEST_F(SetInvariance, EqualRadiiAreOne)
{
    const std::vector<double> equal(6000, 0.04);
    const NeighborLists one = findNeighbors(mView, 0.04);
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        Radius radius;
        radius.ofQueries = radius.ofCandidates = spanOf(equal);
        radius.mode = mode;
        const NeighborLists many = search(mView, mView, radius);
        for (std::size_t i = 0; i < one.size(); ++i) {
            const Span<const std::uint32_t> a = one.indices(i), b = many.indices(i);
            ASSERT_TRUE(std::equal(a.begin(), a.end(), b.begin(), b.end())) << i;
        }
    }
}

TEST_F(SetInvariance, NobodyMayReachAnybody)
{
    const std::vector<double> none(6000, 0.0);
    for (const float scale : {1e-6f, 1.0f, 1e12f}) {
        std::vector<float> positions = mPositions;
        for (float& x : positions) x *= scale;
        const ParticleView view = ParticleView::fromArray(positions.data(), 6000);
        for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
            Radius radius;
            radius.ofQueries = radius.ofCandidates = spanOf(none);
            radius.mode = mode;
            const NeighborLists lists = search(view, view, radius);
            EXPECT_EQ(lists.pairCount(), 0u);
            EXPECT_EQ(lists.statistics().isolated, 6000u);
        }
    }
}

// A candidate may stand past the last cell that a query may have.
TEST(TwoSets, CandidatesPastTheLimitAreFound)
{
    const double query[3] = {2147512319.5, 0, 0}, candidate[3] = {2147512320.25, 0, 0};
    SearchOptions options;
    options.cellSize = 1;
    const NeighborLists lists =
        search(ParticleView::fromArray(candidate, 1), ParticleView::fromArray(query, 1), 1, options);
    EXPECT_EQ(lists.pairCount(), 1u);
}

// Of many at one place, those of the smallest numbers are the nearest.
TEST(TwoSets, OfManyAtOnePlaceTheFirstAreNearest)
{
    const std::vector<float> positions(3 * 2000, 1.0f);
    const ParticleView view = ParticleView::fromArray(positions.data(), 2000);
    SearchOptions options;
    for (const std::uint32_t nearest : {1u, 64u, 65u, 900u, 4294967295u}) {
        options.nearest = nearest;
        for (const bool self : {false, true}) {
            options.includeSelf = self;
            const NeighborLists lists = search(view, view, 1, options);
            std::vector<std::uint32_t> row;
            lists.neighbors(1999, row);
            const std::size_t neighbors = std::min<std::size_t>(nearest, 1999);
            ASSERT_EQ(row.size(), neighbors + self);
            for (std::uint32_t k = 0; k < neighbors; ++k) ASSERT_EQ(row[k], k);
            EXPECT_EQ(row.back(), self ? 1999 : neighbors - 1);
        }
    }
}

TEST_F(SetInvariance, ThreadsChangeNothing)
{
    SearchOptions options;
    for (const RadiusMode mode : {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric}) {
        for (const std::uint32_t nearest : {0u, 7u}) {
            options.nearest = nearest;
            const Lists lists = listsOf(search(mView, mView, radii(mode), options));
            for (const int threads : {1, 3, 8}) {
                runOnThreads(threads,
                             [&] { EXPECT_EQ(listsOf(search(mView, mView, radii(mode), options)), lists); });
            }
        }
    }
}

TEST_F(SetInvariance, BadSetsAreRefused)
{
    const std::vector<double> few(10, 0.1);
    Radius radius;
    radius.ofQueries = spanOf(few);
    EXPECT_THROW(search(mView, mView, radius), InvalidInput);
    radius.ofQueries = spanOf(mRadii);
    radius.mode = RadiusMode::kScatter; // and the candidates have none
    EXPECT_THROW(search(mView, mView, radius), InvalidInput);
    EXPECT_THROW(search(mView, mView, Radius(0.0)), InvalidInput);
    const std::vector<std::uint8_t> short_(3, 1);
    EXPECT_THROW(search({mView, spanOf(short_)}, mView, 0.1), InvalidInput);
    SearchOptions options;
    options.nearest = 3;
    options.encoding = Encoding::kMask;
    EXPECT_THROW(search(mView, mView, 0.1, options), InvalidInput);
    options = {};
    options.includeSelf = true;
    const ParticleView other = ParticleView::fromArray(mPositions.data(), 100);
    EXPECT_THROW(search(mView, other, 0.1, options), InvalidInput);
    options = {};
    options.radius = 0.01; // beside radii of particles
    EXPECT_THROW(search(mView, mView, radii(RadiusMode::kGather), options), InvalidInput);
}

} // namespace

} // namespace vdb_nns::testing
