// The lattice as an input: views that share one have the same cells, a search may have a smaller radius than its lattice,
// and what does not suit is refused. The lattice that is chosen is that of the grid that is built without one.
#include "agreement/point_views.h"
#include "grid/lattice.h"
#include "plan/workload_cases.h"
#include "search/engine_state.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/lattice.h"
#include "vdb_nns/planning/executor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <mutex>
#include <random>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

Lattice latticeWith(double cellSize, int reach, const Vec3d& reference = {})
{
    Lattice lattice;
    lattice.reference = reference;
    lattice.cellSize = cellSize;
    lattice.reach = reach;
    lattice.radius = spanOfCells(cellSize, reach);
    return lattice;
}

PointSet randomSet(std::size_t count, double side, std::uint64_t seed)
{
    PointSet set{"random", 1, {}, kIdentity};
    std::mt19937_64 bits(seed);
    for (std::size_t i = 0; i < count; ++i) {
        ExactPoint point;
        for (double& x : point.offset) x = (static_cast<double>(bits() >> 40) * 0x1p-24 - 0.5) * side;
        set.points.push_back(point);
    }
    return set;
}

PointSet partOf(const PointSet& set, std::size_t begin, std::size_t end)
{
    PointSet part = set;
    part.points.assign(set.points.begin() + static_cast<std::ptrdiff_t>(begin),
                       set.points.begin() + static_cast<std::ptrdiff_t>(end));
    return part;
}

// What the error of an action says; empty where there is none.
template <typename Error, typename Action>
std::string errorOf(const Action& action)
{
    try {
        action();
    } catch (const Error& error) {
        return error.what();
    }
    return "";
}

// ---- sharing -------------------------------------------------------------------------------------------------------

// The first and the rest of the points, each sorted on the lattice, are in the cells that both have together.
void expectSameCells(const PointSet& set, Form form, const Lattice& lattice)
{
    SCOPED_TRACE(set.name);
    const std::size_t half = set.points.size() / 3;
    const SetView both(set, form), first(partOf(set, 0, half), form),
        rest(partOf(set, half, set.points.size()), form);
    const SparseGrid whole = SearchEngine().buildGrid(both.view(), lattice);
    const SparseGrid a = SearchEngine().buildGrid(first.view(), lattice);
    const SparseGrid b = SearchEngine().buildGrid(rest.view(), lattice);
    for (const SparseGrid* grid : {&whole, &a, &b}) {
        EXPECT_EQ(grid->lattice(), lattice);
        EXPECT_EQ(grid->radius(), lattice.radius);
        EXPECT_EQ(grid->reach(), lattice.reach);
        EXPECT_EQ(grid->cellSize(), lattice.cellSize);
    }
    EXPECT_TRUE(a.lattice() == b.lattice());
    const std::vector<Vec3i> cells = cellsOf(whole), ofFirst = cellsOf(a), ofRest = cellsOf(b);
    for (std::size_t i = 0; i < cells.size(); ++i)
        ASSERT_EQ(cells[i], i < half ? ofFirst[i] : ofRest[i - half]) << "particle " << i;
}

TEST(Lattice, TwoViewsOnItHaveTheCellsOfOneViewOfBoth)
{
    for (int reach = 1; reach <= 3; ++reach) {
        for (const Form form : {Form::kDoubles, Form::kFloatColumns}) {
            PointSet set = roundedToFloats(randomSet(3000, 20, 5));
            set.points[17].offset[1] = std::nan("");
            expectSameCells(set, form, latticeWith(0.7, reach, {0.3, -17.25, 1e3}));
        }
        for (const PointSet& set : gridSets(7)) {
            if (set.points.empty()) continue;
            Lattice lattice = latticeWith(set.radius * 1.1 / reach, reach);
            for (std::size_t k = 0; k < 3; ++k)
                lattice.reference[k] = static_cast<double>(set.points[0].voxel[k] - 5);
            expectSameCells(set, Form::kVoxels, lattice);
        }
    }
}

TEST(Lattice, ACellBeginsAtItsReference)
{
    const double xyz[6] = {10.5001, -2.9999, 7.0001, 10.4999, -2.5001, 7.4999};
    const Lattice lattice = latticeWith(0.5, 1, {10, -3, 7});
    const SparseGrid grid = SearchEngine().buildGrid(ParticleView::fromArray(xyz, 2), lattice);
    EXPECT_EQ(cellsOf(grid), (std::vector<Vec3i>{{1, 0, 0}, {0, 0, 0}}));
}

// ---- choosing ------------------------------------------------------------------------------------------------------

// What is chosen is what a grid for the radius is sorted on, and sorting on it gives the same grid.
void expectChoiceOfGrid(SearchEngine& engine, const ParticleView& view, double radius,
                        const SearchOptions& options)
{
    std::string error;
    SparseGrid grid;
    try {
        grid = engine.buildGrid(view, radius, options);
    } catch (const InputError& refused) {
        error = refused.what();
    }
    if (!error.empty()) {
        EXPECT_EQ(errorOf<InputError>([&] { chooseLattice(view, radius, options); }), error);
        return;
    }
    const Lattice lattice = chooseLattice(view, radius, options);
    EXPECT_EQ(lattice, grid.lattice());
    EXPECT_EQ(lattice.radius, radius);
    const SparseGrid again = engine.buildGrid(view, lattice, options);
    const auto numbersOf = [](const SparseGrid& g) {
        return std::vector<std::uint32_t>(g.particleNumbers().begin(), g.particleNumbers().end());
    };
    EXPECT_EQ(numbersOf(again), numbersOf(grid));
    EXPECT_EQ(cellsOf(again), cellsOf(grid));
    EXPECT_EQ(again.data().coordinateError, grid.data().coordinateError);
}

TEST(Lattice, IsChosenAsTheGridChoosesIt)
{
    SearchEngine engine;
    for (const double cellSize : {0.0, 0.4, 1.0}) {
        SearchOptions options;
        options.cellSize = cellSize;
        for (const bool voxels : {false, true}) {
            for (const PointSet& set : voxels ? gridSets(2) : arraySets(Precision::kDouble, 2)) {
                const SetView input(set, voxels ? Form::kVoxels : Form::kStridedDoubles);
                for (const double factor : {0.01, 1.0}) {
                    SCOPED_TRACE(set.name + " " + std::to_string(factor) + " " + std::to_string(cellSize));
                    expectChoiceOfGrid(engine, input.view(), factor * set.radius, options);
                }
            }
        }
    }
}

TEST(Lattice, IsChosenForExtremeNumbersToo)
{
    const double line[9] = {-1e10, 0, 0, 0, 5, 0, 1e10, 1, 1}, oneSide[6] = {0, 0, 0, 3e9, 0, 0};
    const double wide[6] = {-1e308, 0, 0, 1e308, 0, 0};
    SearchEngine engine;
    constexpr double kMax = std::numeric_limits<double>::max();
    for (int reach = 0; reach <= 3; ++reach) {
        SearchOptions options;
        options.cellSize = reach ? 1.0 / reach : 0;
        for (const double radius : {5e-324, 1e-291, 1e-100, 0.5, 1.0, 3.0, 1e9, 1e300, 1e301, kMax}) {
            SCOPED_TRACE(std::to_string(reach) + " " + std::to_string(radius));
            expectChoiceOfGrid(engine, ParticleView::fromArray(line, 3), radius, options);
            expectChoiceOfGrid(engine, ParticleView::fromArray(oneSide, 2), radius, options);
            expectChoiceOfGrid(engine, ParticleView::fromArray(wide, 2), radius, options);
        }
        // 1e308 apart twice over: out of reach of any radius but the largest ones.
        EXPECT_EQ(findNeighbors(ParticleView::fromArray(wide, 2), kMax, options).pairCount(), 0u);
        EXPECT_EQ(findNeighbors(ParticleView::fromArray(line, 3), kMax, options).pairCount(), 6u);
    }
}

TEST(Lattice, SpansItsRadius)
{
    for (int reach = 1; reach <= 3; ++reach) {
        for (const double edge : {1e-200, 0.1, 1.0, 7e5}) {
            const double span = spanOfCells(edge, reach);
            EXPECT_LT(span, reach * edge);
            EXPECT_GT(span, reach * edge * (1 - 1e-4));
        }
    }
    // The longest pairs across cells that a lattice is made for, at every place in them.
    const Lattice lattice = latticeWith(1, 2, {0.1, 0, 0});
    std::vector<double> xyz;
    for (int i = 0; i < 2000; ++i) {
        const double x = 0.1 + 10 * i + i * 1e-6;
        for (const double end : {x, x + lattice.radius}) xyz.insert(xyz.end(), {end, 0, 0});
    }
    SearchEngine engine;
    const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const SparseGrid grid = engine.buildGrid(view, lattice);
    const NeighborLists lists = engine.search(grid);
    const Lists oracle = [&] {
        PointSet set{"pairs", lattice.radius, {}, kIdentity};
        for (std::size_t i = 0; i < view.size(); ++i) set.points.push_back({{0, 0, 0}, {xyz[3 * i], 0, 0}});
        return oracleLists(set);
    }();
    EXPECT_EQ(decoded(lists), oracle);
}

// ---- a smaller radius ----------------------------------------------------------------------------------------------

// Every way to search a grid gives the lists of the oracle for the radius of the set.
void expectOraclesLists(SearchEngine& engine, const SparseGrid& grid, const PointSet& set,
                        const Lists& oracle, SimdLevel simd)
{
    SearchOptions options;
    options.radius = set.radius;
    options.simd = simd;
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
        options.encoding = encoding;
        const NeighborLists lists = engine.search(grid, options);
        EXPECT_EQ(lists.radius(), set.radius);
        EXPECT_EQ(lists.grid().radius(), grid.radius());
        EXPECT_TRUE(sameCounts(lists.counts(), oracle));
        if (encoding == Encoding::kNone) continue;
        EXPECT_TRUE(sameLists(lists, oracle, set));
    }
    std::mutex mutex;
    Lists visited(oracle.size()), rows(oracle.size());
    const auto keep = [&](Lists& to, std::uint32_t query, Span<const std::uint32_t> row) {
        const std::lock_guard<std::mutex> lock(mutex);
        to[query].assign(row.begin(), row.end());
    };
    engine.visit(
        grid,
        [&](std::uint32_t query, Span<const std::uint32_t> row, Span<const double>) {
            keep(visited, query, row);
        },
        options);
    engine.visitRows(
        grid, [&](std::uint32_t query, Span<const std::uint32_t> row) { keep(rows, query, row); }, options);
    EXPECT_TRUE(sameLists(visited, oracle, set));
    EXPECT_TRUE(sameLists(rows, oracle, set));
}

TEST(SmallerRadius, GivesTheListsOfAGridThatIsBuiltForIt)
{
    SearchEngine engine;
    for (const bool voxels : {false, true}) {
        for (const PointSet& set : voxels ? gridSets(4) : arraySets(Precision::kDouble, 4)) {
            const SetView input(set, voxels ? Form::kVoxels : Form::kDoubles);
            const Lists oracle = oracleLists(set);
            for (int reach = 1; reach <= 3; ++reach) {
                for (const double factor : {1.0, 1.3, 40.0}) {
                    if (voxels && factor == 1.3) continue;
                    SCOPED_TRACE(set.name + ", reach " + std::to_string(reach) + ", lattice for " +
                                 std::to_string(factor) + " times the radius");
                    const SparseGrid grid = gridOf(input.view(), factor * set.radius, reach);
                    expectOraclesLists(engine, grid, set, oracle, SimdLevel::kBest);
                    if (factor == 1.3) expectOraclesLists(engine, grid, set, oracle, SimdLevel::kScalar);
                }
            }
        }
    }
}

TEST(SmallerRadius, LeavesTheLayoutOfMasks)
{
    const SceneGrid scene("block", 5000);
    SearchEngine engine;
    SearchOptions options;
    options.encoding = Encoding::kMask;
    const NeighborLists full = engine.search(scene.grid, options);
    options.radius = 0.6 * scene.grid.radius();
    const NeighborLists fewer = engine.search(scene.grid, options);
    EXPECT_EQ(full.radius(), scene.grid.radius());
    EXPECT_EQ(fewer.data().rowBytes, full.data().rowBytes);
    EXPECT_LT(fewer.pairCount(), full.pairCount() / 3);
    EXPECT_EQ(fewer.toCsr().indices, findNeighbors(scene.grid.view(), options.radius).toCsr().indices);
}

TEST(SmallerRadius, HoldsOnDevicesToo)
{
    for (const char* name : {"block", "clusters", "spray"}) {
        const SceneGrid scene(name, 6000);
        const double radius = 0.7 * scene.grid.radius();
        EstimateOptions estimating;
        estimating.radius = radius;
        EstimatedGrid problem(scene.grid);
        problem.estimate = estimateWork(scene.grid, estimating);
        EXPECT_EQ(problem.estimate.radius, radius);
        for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask, Encoding::kNone}) {
            SearchOptions options;
            options.encoding = encoding;
            options.radius = radius;
            const NeighborLists truth = SearchEngine().search(scene.grid, options);
            for (const BoundaryMode boundary : {BoundaryMode::kHalo, BoundaryMode::kCpu}) {
                SCOPED_TRACE(std::string(name) + ", encoding " + std::to_string(static_cast<int>(encoding)));
                const std::vector<DeviceLimits> devices(2, deviceOf(problem.need(encoding) / 3));
                RunOptions run;
                run.search = options;
                run.schedule.boundary = boundary;
                run.schedule.useCpu = false;
                MemoryModel model;
                model.encoding = encoding;
                const std::uint64_t bytes =
                    nodeBytesFor(scene.grid, problem.estimate, model, devices, run.schedule);
                const Schedule schedule =
                    makeSchedule(scene.grid, problem.tree(encoding, bytes), devices, run.schedule);
                EXPECT_GT(schedule.blocks.size(), 1u);
                ScheduleRun report;
                const NeighborLists lists = SearchEngine().search(scene.grid, schedule, devices, run, report);
                EXPECT_EQ(lists.radius(), radius);
                EXPECT_GT(report.devices[0].particles + report.devices[1].particles, 0u);
                expectSameLists(lists, truth);
            }
        }
    }
}

// ---- what is refused -----------------------------------------------------------------------------------------------

TEST(SmallerRadius, IsRefusedAboveTheLatticesRadiusNamingBoth)
{
    const SceneGrid scene("block", 1000);
    SearchEngine engine;
    const SparseGrid grid = gridOf(scene.grid.view(), 0.125, 1);
    const auto expectNamed = [](const std::string& error) {
        EXPECT_NE(error.find("0.25"), std::string::npos) << error;
        EXPECT_NE(error.find("0.125"), std::string::npos) << error;
    };
    SearchOptions options;
    options.radius = 0.25;
    expectNamed(errorOf<InvalidInput>([&] { engine.search(grid, options); }));
    expectNamed(errorOf<InvalidInput>([&] { engine.visit(grid, {}, options); }));
    expectNamed(errorOf<InvalidInput>([&] { engine.visitRows(grid, {}, options); }));
    EstimateOptions estimating;
    estimating.radius = 0.25;
    expectNamed(errorOf<InvalidInput>([&] { estimateWork(grid, estimating); }));
    expectNamed(errorOf<InvalidInput>([&] { expectNeighbors(grid, estimating); }));
    RunOptions run;
    run.search = options;
    ScheduleRun report;
    expectNamed(errorOf<InvalidInput>([&] { engine.search(grid, Schedule(), {}, run, report); }));
    options.radius = std::nextafter(0.125, 1.0);
    EXPECT_THROW(engine.search(grid, options), InvalidInput);
    options.radius = 0.125;
    EXPECT_EQ(engine.search(grid, options).radius(), 0.125);
    for (const double bad : {-1.0, kInf, std::nan("")}) {
        options.radius = bad;
        EXPECT_THROW(engine.search(grid, options), InvalidInput) << bad;
        EXPECT_THROW(chooseLattice(grid.view(), bad), InvalidInput) << bad;
    }
}

TEST(Lattice, IsRefusedWhereNoSearchCouldUseIt)
{
    const double one[3] = {1, 2, 3};
    const ParticleView view = ParticleView::fromArray(one, 1);
    const auto refused = [&](const Lattice& lattice) {
        return errorOf<InvalidInput>([&] { SearchEngine().buildGrid(view, lattice); });
    };
    EXPECT_EQ(refused(latticeWith(0.5, 3)), "");
    EXPECT_NE(refused(Lattice()), "");
    for (const double edge : {0.0, -1.0, kInf, std::nan(""), 1e-300}) {
        Lattice lattice = latticeWith(1, 1);
        lattice.cellSize = edge;
        EXPECT_NE(refused(lattice), "") << edge;
    }
    for (const int reach : {0, 4, -1}) {
        Lattice lattice = latticeWith(1, 1);
        lattice.reach = reach;
        EXPECT_NE(refused(lattice).find("spans " + std::to_string(reach)), std::string::npos);
    }
    for (const double radius : {0.0, -1.0, kInf, std::nan("")}) {
        Lattice lattice = latticeWith(1, 1);
        lattice.radius = radius;
        EXPECT_NE(refused(lattice), "") << radius;
    }
    for (int reach = 1; reach <= 3; ++reach) { // cells that do not surely span the radius
        Lattice lattice = latticeWith(1, reach);
        lattice.radius = reach;
        const std::string error = refused(lattice);
        EXPECT_NE(error.find("not " + std::to_string(reach)), std::string::npos) << error;
    }
    Lattice lattice = latticeWith(1, 1);
    lattice.reference[2] = kInf;
    EXPECT_NE(refused(lattice).find("reference"), std::string::npos);
}

TEST(Lattice, IsRefusedWhereItDoesNotSuitTheView)
{
    const PointSet set = randomSet(20, 4, 3);
    const SetView array(set, Form::kDoubles), voxels(set, Form::kVoxels);
    // Voxels as cells, of particles that have none.
    Lattice lattice;
    lattice.cellSize = 1;
    lattice.radius = 0.9;
    lattice.usesVoxels = true;
    const std::string noVoxels =
        errorOf<InvalidInput>([&] { SearchEngine().buildGrid(array.view(), lattice); });
    EXPECT_NE(noVoxels.find("no"), std::string::npos);
    EXPECT_NE(noVoxels.find("voxels of edge 1"), std::string::npos) << noVoxels;
    // A reference that is no voxel.
    lattice = latticeWith(1, 1, {0, 0.5, 0});
    EXPECT_EQ(errorOf<InvalidInput>([&] { SearchEngine().buildGrid(array.view(), lattice); }), "");
    EXPECT_NE(errorOf<InvalidInput>([&] { SearchEngine().buildGrid(voxels.view(), lattice); }).find("0.5"),
              std::string::npos);
    // Too many cells from the reference, though not from the particles' middle.
    const double far[6] = {5e9, 0, 0, 5e9 + 1, 0, 0};
    const ParticleView farView = ParticleView::fromArray(far, 2);
    lattice = latticeWith(1, 1);
    const std::string error = errorOf<InputError>([&] { SearchEngine().buildGrid(farView, lattice); });
    const std::string before = "a lattice with cells of at least ";
    const std::size_t at = error.find(before);
    ASSERT_NE(at, std::string::npos) << error;
    EXPECT_NE(error.find("2^31 - 4096"), std::string::npos) << error;
    const double told = std::strtod(error.c_str() + at + before.size(), nullptr);
    EXPECT_EQ(SearchEngine().buildGrid(farView, latticeWith(told, 1)).particleCount(), 2u);
    EXPECT_THROW(SearchEngine().buildGrid(farView, latticeWith(0.98 * told, 1)), InputError);
    EXPECT_EQ(SearchEngine().buildGrid(farView, latticeWith(1, 1, {5e9, 0, 0})).particleCount(), 2u);
    // A transform that loses the cells.
    const PointSet thin{"thin",
                        1,
                        {{{-30000, 0, 0}, {0, 0, 0}}, {{30000, -7, 5}, {0, 0.25, 0}}},
                        {{{1, 1, 0}, {1, 1 + 0x1p-24, 0}, {0, 0, 1}}}};
    const SetView thinView(thin, Form::kVoxels);
    const std::string lost =
        errorOf<InputError>([&] { SearchEngine().buildGrid(thinView.view(), latticeWith(0.001, 1)); });
    EXPECT_NE(lost.find("nearly singular"), std::string::npos) << lost;
}

} // namespace

} // namespace vdb_nns::testing
