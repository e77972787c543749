// Point grids and point files: every value as OpenVDB's own handles give it, damage noticed, and a file
// written again with nothing changed but the attribute that was added.
#include "grid/sparse_grid_data.h"
#include "points/particle_source.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/openvdb_bridge.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>
#include <openvdb/io/Stream.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointCount.h>
#include <openvdb/points/PointGroup.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <random>
#include <set>

#include <sys/resource.h>

// OpenVDB loses the nodes and page handles it has just made when its input throws, as the one of a cut
// stream-written file does. LeakSanitizer asks for this; without it nobody does.
extern "C" const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions()
{
    return "leak:readTopology\nleak:openvdb*AttributeSet\nleak:PagedInputStream\n";
}

namespace vdb_nns {
namespace {

namespace fs = std::filesystem;
namespace points = openvdb::points;
using openvdb::Coord;
using openvdb::Vec3f;
using points::PointDataGrid;
using Leaf = points::PointDataTree::LeafNodeType;
using Truncate = points::TruncateCodec;
using Fixed16 = points::FixedPointCodec<false, points::PositionRange>;
using Fixed8 = points::FixedPointCodec<true, points::PositionRange>;

constexpr OutputOptions kOverwrite{true};

class PointFileTest : public ::testing::Test {
protected:
    PointFileTest()
    {
        openvdb::initialize();
        std::string name = (fs::temp_directory_path() / "vdb_nns_points_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~PointFileTest() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    static std::string contents(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(stream), {}};
    }

    static void create(const std::string& file, const std::string& bytes)
    {
        std::ofstream(file, std::ios::binary | std::ios::trunc) << bytes;
    }

    std::size_t fileCount() const
    {
        return static_cast<std::size_t>(std::distance(fs::directory_iterator(mFolder), {}));
    }

    std::string writeFile(const std::string& name, const openvdb::GridCPtrVec& grids,
                          std::uint32_t compression, const openvdb::MetaMap& metadata = {}) const
    {
        openvdb::io::File file(path(name));
        file.setCompression(compression);
        file.write(grids, metadata);
        return path(name);
    }

    fs::path mFolder;
};

constexpr std::uint32_t kDefaultCompression = openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK;

std::vector<openvdb::Vec3R> randomPositions(std::size_t count, double extent)
{
    std::mt19937_64 random(7);
    std::vector<openvdb::Vec3R> positions;
    const auto coordinate = [&] { return (static_cast<double>(random() >> 11) * 0x1p-53 - 0.5) * extent; };
    for (std::size_t i = 0; i < count; ++i) positions.emplace_back(coordinate(), coordinate(), coordinate());
    return positions;
}

template <typename Codec>
PointDataGrid::Ptr makeGrid(
    std::size_t count, const std::string& name = "points",
    const openvdb::math::Transform::Ptr& transform = openvdb::math::Transform::createLinearTransform(0.1))
{
    PointDataGrid::Ptr grid =
        points::createPointDataGrid<Codec, PointDataGrid>(randomPositions(count, 4.0), *transform);
    grid->setName(name);
    return grid;
}

// A leaf with the given points: voxel within the leaf, ascending, and P.
void addLeaf(PointDataGrid& grid, const Coord& origin,
             const std::vector<std::pair<openvdb::Index, Vec3f>>& content)
{
    Leaf* const leaf = grid.tree().touchLeaf(origin);
    const auto descriptor =
        points::AttributeSet::Descriptor::create(points::TypedAttributeArray<Vec3f>::attributeType());
    leaf->initializeAttributes(descriptor, static_cast<openvdb::Index>(content.size()));
    std::vector<Leaf::ValueType> ends;
    std::size_t next = 0;
    points::AttributeWriteHandle<Vec3f> handle(leaf->attributeArray("P"));
    for (openvdb::Index voxel = 0; voxel < Leaf::SIZE; ++voxel) {
        for (; next < content.size() && content[next].first == voxel; ++next) {
            handle.set(static_cast<openvdb::Index>(next), content[next].second);
        }
        ends.emplace_back(static_cast<openvdb::Index32>(next));
    }
    leaf->setOffsets(ends);
}

struct Expected {
    Coord voxel;
    Vec3f offset;
};

// All points by OpenVDB's own iterators and handles, in the numbering of the design.
std::vector<Expected> expectedPoints(const PointDataGrid& grid)
{
    std::vector<Expected> all;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        if (leaf->pointCount() == 0) continue;
        const points::AttributeHandle<Vec3f> handle(leaf->constAttributeArray("P"));
        for (auto index = leaf->beginIndexAll(); index; ++index) {
            all.push_back({index.getCoord(), handle.get(*index)});
        }
    }
    return all;
}

bool isSame(double a, double b)
{
    return a == b || (std::isnan(a) && std::isnan(b));
}

void checkView(const ParticleView& view, const PointDataGrid& grid)
{
    const std::vector<Expected> expected = expectedPoints(grid);
    ASSERT_EQ(view.size(), expected.size());
    const ParticleSource& source = view.source();
    EXPECT_FALSE(source.isArray());
    // Several ranges, so that they begin and end within leaves and voxels.
    const Vec3d reference = source.reference();
    std::vector<double> x(view.size()), y(view.size()), z(view.size());
    std::size_t step = 1;
    for (std::size_t begin = 0; begin < view.size(); begin += step, step = step * 3 + 1) {
        step = std::min(step, view.size() - begin);
        source.read(begin, step, reference, &x[begin], &y[begin], &z[begin]);
    }
    for (std::size_t i = 0; i < view.size(); ++i) {
        const StoredPosition stored = source.stored(i);
        const double got[3] = {x[i], y[i], z[i]};
        for (int k = 0; k < 3; ++k) {
            ASSERT_EQ(stored.voxel[k], expected[i].voxel[k]) << i;
            ASSERT_TRUE(isSame(stored.offset[k], expected[i].offset[k])) << i;
            const double exactPart =
                static_cast<double>(stored.voxel[k] - static_cast<std::int64_t>(reference[k]));
            ASSERT_TRUE(isSame(got[k], exactPart + stored.offset[k])) << i;
        }
    }
}

// ------------------------------------------------------------------------------------------------ leaves taken over

// Searches with the cells that suit the grid, tells whether they are its voxels, and holds the lists against the oracle.
bool usesVoxels(const PointDataGrid::Ptr& grid, double radius)
{
    SCOPED_TRACE("radius " + std::to_string(radius));
    const ParticleView view = viewOf(grid);
    testing::PointSet set{"grid", radius, {}, view.linear()};
    for (const Expected& point : expectedPoints(*grid)) {
        set.points.push_back({{point.voxel.x(), point.voxel.y(), point.voxel.z()},
                              {point.offset.x(), point.offset.y(), point.offset.z()}});
    }
    const testing::Lists oracle = testing::oracleLists(set);
    SearchEngine engine;
    SearchOptions options;
    options.wideCells = false; // so that any other cells are of the radius
    const SparseGrid cells = engine.buildGrid(view, radius, options);
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        options.encoding = encoding;
        EXPECT_TRUE(testing::sameLists(engine.search(cells, options), oracle, set));
    }
    const std::vector<std::uint32_t> numbers(cells.particleNumbers().begin(), cells.particleNumbers().end());
    EXPECT_EQ(std::set<std::uint32_t>(numbers.begin(), numbers.end()).size(), cells.particleCount());
    std::uint64_t occupied = 0, leaves = 0;
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        leaves += leaf->pointCount() > 0;
        for (openvdb::Index v = 0; v < Leaf::SIZE; ++v) {
            occupied += openvdb::Index32(leaf->getValue(v)) !=
                        (v ? openvdb::Index32(leaf->getValue(v - 1)) : openvdb::Index32(0));
        }
    }
    const double edge = std::fabs(view.linear()[0][0]);
    const bool uses = std::fabs(cells.cellSize() / edge - 1) < 1e-12;
    if (uses) {
        EXPECT_EQ(cells.leafCount(), leaves);
        EXPECT_EQ(cells.cellCount(), occupied);
    } else {
        EXPECT_NEAR(cells.cellSize(), radius, 1e-4 * radius);
    }
    return uses;
}

TEST_F(PointFileTest, voxelsServeAsCellsWhereTheRadiusIsHalfToOneVoxel)
{
    const auto scale = [](double edge) { return openvdb::math::Transform::createLinearTransform(edge); };
    const auto check = [](const PointDataGrid::Ptr& grid, double edge) {
        for (const double ratio : {0.5, 0.75, 0.999999}) EXPECT_TRUE(usesVoxels(grid, ratio * edge)) << ratio;
        for (const double ratio : {0.49999, 1.0, 1.5}) EXPECT_FALSE(usesVoxels(grid, ratio * edge)) << ratio;
    };
    check(makeGrid<points::NullCodec>(600, "points", scale(0.3)), 0.3);
    check(makeGrid<Truncate>(600, "points", scale(0.3)), 0.3);
    check(makeGrid<Fixed16>(600, "points", scale(0.3)), 0.3);
    check(makeGrid<Fixed8>(600, "points", scale(0.3)), 0.3);
    const auto mirror = scale(0.3);
    mirror->postScale(openvdb::Vec3d(-1, 1, 1));
    mirror->postTranslate(openvdb::Vec3d(1e3, -1e-3, 7));
    check(makeGrid<points::NullCodec>(600, "points", mirror), 0.3);
}

TEST_F(PointFileTest, voxelsDoNotServeAsCellsWherePairsCouldBeLost)
{
    const auto uneven = openvdb::math::Transform::createLinearTransform(0.3);
    uneven->postScale(openvdb::Vec3d(1, 1, 1.001));
    EXPECT_FALSE(usesVoxels(makeGrid<points::NullCodec>(600, "points", uneven), 0.25));
    const auto turned = openvdb::math::Transform::createLinearTransform(0.3);
    turned->postRotate(1e-3, openvdb::math::X_AXIS);
    EXPECT_FALSE(usesVoxels(makeGrid<points::NullCodec>(600, "points", turned), 0.25));

    const auto gridWith = [](const Vec3f& offset) {
        const PointDataGrid::Ptr grid = PointDataGrid::create();
        // Neighbors whose voxels are two apart, when the first leaves its own.
        addLeaf(*grid, Coord(0), {{0, offset}, {2, Vec3f(0, 0, -0.5f)}, {2, Vec3f(0.5f)}, {511, Vec3f(0)}});
        addLeaf(*grid, Coord(0, 0, -8), {{7, Vec3f(-0.5f, 0.5f, 0.5f)}, {448, Vec3f(0.25f)}});
        return grid;
    };
    EXPECT_TRUE(usesVoxels(gridWith(Vec3f(0.5f)), 0.99));
    EXPECT_FALSE(usesVoxels(gridWith(Vec3f(0, 0, 0.50001f)), 0.99));
    EXPECT_FALSE(usesVoxels(gridWith(Vec3f(0, 0, 0.75f)), 0.99));
    EXPECT_FALSE(usesVoxels(gridWith(Vec3f(std::numeric_limits<float>::quiet_NaN(), 0, 0)), 0.99));
}

TEST_F(PointFileTest, voxelsAreALatticeOfTheirOwn)
{
    const auto edge = openvdb::math::Transform::createLinearTransform(0.3);
    const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(600, "points", edge);
    const ParticleView view = viewOf(grid);
    SearchEngine engine;
    const SparseGrid cells = engine.buildGrid(view, 0.28);
    const Lattice lattice = chooseLattice(view, 0.28);
    EXPECT_TRUE(lattice.usesVoxels);
    EXPECT_EQ(lattice, cells.lattice());
    const SparseGrid again = engine.buildGrid(view, lattice);
    EXPECT_EQ(again.lattice(), lattice);
    EXPECT_EQ(again.leafCount(), cells.leafCount());
    EXPECT_EQ(again.cellCount(), cells.cellCount());
    // A smaller radius, also below that from which voxels are taken unasked.
    for (const double radius : {0.2, 0.05}) {
        SearchOptions options;
        options.radius = radius;
        const NeighborLists lists = engine.search(again, options);
        EXPECT_EQ(lists.checksum(), findNeighbors(view, radius).checksum());
    }
    // Another grid of the same voxels shares the lattice; one with others, and one with particles outside their voxels, cannot.
    const PointDataGrid::Ptr other = makeGrid<Truncate>(100, "points", edge->copy());
    EXPECT_TRUE(engine.buildGrid(viewOf(other), lattice).lattice() == cells.lattice());
    const PointDataGrid::Ptr wider =
        makeGrid<points::NullCodec>(100, "points", openvdb::math::Transform::createLinearTransform(0.31));
    EXPECT_THROW(engine.buildGrid(viewOf(wider), lattice), InvalidInput);
    const PointDataGrid::Ptr outside = PointDataGrid::create();
    outside->setTransform(edge->copy());
    addLeaf(*outside, Coord(0), {{0, Vec3f(0.75f, 0, 0)}});
    EXPECT_THROW(engine.buildGrid(viewOf(outside), lattice), InputError);
    EXPECT_FALSE(chooseLattice(viewOf(outside), 0.28).usesVoxels);
    // Cells of their own that begin at a voxel.
    Lattice own = chooseLattice(viewOf(outside), 0.28);
    own.reference = {-3, 5, 0};
    EXPECT_EQ(engine.search(engine.buildGrid(view, own)).checksum(), findNeighbors(view, 0.28).checksum());
}

// ------------------------------------------------------------------------------------------------ views

TEST_F(PointFileTest, viewGivesWhatHandlesGive)
{
    checkView(viewOf(makeGrid<points::NullCodec>(20000)), *makeGrid<points::NullCodec>(20000));
    checkView(viewOf(makeGrid<Truncate>(20000)), *makeGrid<Truncate>(20000));
    checkView(viewOf(makeGrid<Fixed16>(20000)), *makeGrid<Fixed16>(20000));
    checkView(viewOf(makeGrid<Fixed8>(20000)), *makeGrid<Fixed8>(20000));
}

TEST_F(PointFileTest, viewReadsUniformArrays)
{
    const auto check = [](const PointDataGrid::Ptr& grid) {
        for (auto leaf = grid->tree().beginLeaf(); leaf; ++leaf) {
            points::AttributeWriteHandle<Vec3f>(leaf->attributeArray("P"))
                .collapse(Vec3f(0.25f, -0.125f, 0.3f));
            ASSERT_TRUE(leaf->constAttributeArray("P").isUniform());
        }
        checkView(viewOf(grid), *grid);
    };
    check(makeGrid<points::NullCodec>(3000));
    check(makeGrid<Truncate>(3000));
    check(makeGrid<Fixed16>(3000));
    check(makeGrid<Fixed8>(3000));
}

TEST_F(PointFileTest, viewReachesTheEndsOfIndexSpaceAndSkipsEmptyLeaves)
{
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    const float kNan = std::numeric_limits<float>::quiet_NaN();
    const float kInf = std::numeric_limits<float>::infinity();
    constexpr std::int32_t kMin = std::numeric_limits<std::int32_t>::min();
    addLeaf(*grid, Coord(kMin, 0, 2147483640),
            {{0, Vec3f(0.5f)}, {0, Vec3f(-3.25f, 1e6f, 0)}, {511, Vec3f(kNan, 0, 0)}});
    addLeaf(*grid, Coord(0),
            {{7, Vec3f(kInf)}, {8, Vec3f(0)}, {63, Vec3f(0)}, {64, Vec3f(0)}, {448, Vec3f(-0.5f)}});
    addLeaf(*grid, Coord(2147483640), {{511, Vec3f(0.5f)}});
    grid->tree().touchLeaf(Coord(8, 8, 8));        // no attributes at all
    addLeaf(*grid, Coord(800), {});                // attributes without points
    grid->tree().addTile(1, Coord(4096), 0, true); // an active tile
    checkView(viewOf(grid), *grid);
    const Vec3d reference = viewOf(grid).source().reference();
    for (int k = 0; k < 3; ++k) EXPECT_EQ(reference[k], std::floor(reference[k]));
    EXPECT_EQ(viewOf(grid).source().stored(0).voxel[0], kMin);
}

TEST_F(PointFileTest, viewHoldsTheTransformForColumnVectors)
{
    openvdb::math::Transform::Ptr transform = openvdb::math::Transform::createLinearTransform(0.5);
    transform->postRotate(0.3, openvdb::math::X_AXIS);
    transform->postScale(openvdb::Vec3d(1, -2, 3));
    transform->postShear(0.2, openvdb::math::X_AXIS, openvdb::math::Y_AXIS);
    transform->postTranslate(openvdb::Vec3d(5, 6, 7));
    const ParticleView view = viewOf(makeGrid<points::NullCodec>(10, "points", transform));
    const openvdb::Mat4d matrix = transform->baseMap()->getAffineMap()->getMat4();
    const openvdb::Vec3d index(1.5, -2.25, 4);
    const openvdb::Vec3d world = transform->indexToWorld(index);
    for (int row = 0; row < 3; ++row) {
        double sum = view.source().translation()[row];
        for (int column = 0; column < 3; ++column) {
            EXPECT_EQ(view.linear()[row][column], matrix(column, row));
            sum += view.linear()[row][column] * index[column];
        }
        EXPECT_NEAR(sum, world[row], 1e-12);
    }
}

TEST_F(PointFileTest, viewRefusesWhatItCannotRead)
{
    EXPECT_THROW(viewOf(nullptr), InvalidInput);

    const PointDataGrid::Ptr frustum = makeGrid<points::NullCodec>(10);
    frustum->setTransform(openvdb::math::Transform::createFrustumTransform(
        openvdb::BBoxd(openvdb::Vec3d(0), openvdb::Vec3d(100)), 0.5, 10));
    EXPECT_THROW(viewOf(frustum), InputError);

    // OpenVDB makes no such matrix itself, but reads one.
    const PointDataGrid::Ptr flat = makeGrid<points::NullCodec>(10);
    const openvdb::Mat4d nearlySingular(1., 2., 3., 0., 4., 5., 6., 0., 7., 8., 9. + 1e-14, 0., 0., 0., 0.,
                                        1.);
    try {
        flat->setTransform(openvdb::math::Transform::createLinearTransform(nearlySingular));
        EXPECT_THROW(viewOf(flat), InputError);
    } catch (const openvdb::ArithmeticError&) {
        SUCCEED();
    }

    // Thin, but no dimension is lost.
    const PointDataGrid::Ptr thin = makeGrid<points::NullCodec>(10);
    thin->setTransform(openvdb::math::Transform::createLinearTransform(
        openvdb::Mat4d(1e-4, 0., 0., 0., 0., 1e-4, 0., 0., 0., 0., 1e-5, 0., 0., 0., 0., 1.)));
    EXPECT_EQ(viewOf(thin).size(), 10u);

    const PointDataGrid::Ptr noP = makeGrid<points::NullCodec>(10);
    points::renameAttribute(noP->tree(), "P", "Q");
    EXPECT_THROW(viewOf(noP), InputError);

    const PointDataGrid::Ptr doubles = makeGrid<points::NullCodec>(10);
    points::renameAttribute(doubles->tree(), "P", "Q");
    points::appendAttribute<openvdb::Vec3d>(doubles->tree(), "P");
    try {
        viewOf(doubles);
        ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("vec3d"), std::string::npos) << error.what();
    }

    const PointDataGrid::Ptr unit = makeGrid<points::NullCodec>(10);
    points::renameAttribute(unit->tree(), "P", "Q");
    points::appendAttribute<Vec3f, points::UnitVecCodec>(unit->tree(), "P");
    try {
        viewOf(unit);
        ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("uvec"), std::string::npos) << error.what();
    }
}

TEST_F(PointFileTest, viewRefusesDamagedOffsets)
{
    for (const openvdb::Index32 wrong : {0u, 1000000u, 0xFFFFFFFFu}) {
        const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(5000);
        Leaf& leaf = *grid->tree().beginLeaf();
        leaf.setOffsetOnly(Leaf::SIZE - 2, wrong); // the offsets before it are above 0, the last one is small
        EXPECT_THROW(viewOf(grid), InputError) << wrong;
    }
    const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(5000);
    Leaf& leaf = *grid->tree().beginLeaf();
    leaf.setOffsetOnly(Leaf::SIZE - 1, leaf.getLastValue() + 1u);
    EXPECT_THROW(viewOf(grid), InputError);
}

// ------------------------------------------------------------------------------------------------ attributes

TEST_F(PointFileTest, setsAndReplacesAnAttribute)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000);
    addLeaf(*PointDataGrid::create(), Coord(0), {});
    std::vector<std::uint32_t> values(5000);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<std::uint32_t>(i * 3);
    const auto check = [&] {
        std::size_t next = 0;
        for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
            const points::AttributeHandle<std::int32_t> handle(leaf->constAttributeArray("nns_count"));
            for (auto index = leaf->beginIndexAll(); index; ++index) {
                ASSERT_EQ(handle.get(*index), static_cast<std::int32_t>(values[next++]));
            }
        }
        EXPECT_EQ(next, values.size());
        checkView(viewOf(grid), *makeGrid<Fixed16>(5000));
    };
    setPointAttribute(*grid, "nns_count", {values.data(), values.size()});
    check();
    values[7] = std::numeric_limits<std::int32_t>::max();
    EXPECT_THROW(setPointAttribute(*grid, "nns_count", {values.data(), values.size()}), InvalidInput);
    setPointAttribute(*grid, "nns_count", {values.data(), values.size()}, true);
    check();

    EXPECT_THROW(setPointAttribute(*grid, "other", {values.data(), values.size() - 1}), InvalidInput);
    EXPECT_THROW(setPointAttribute(*grid, "not valid", {values.data(), values.size()}), InvalidInput);
    EXPECT_THROW(setPointAttribute(*grid, "P", {values.data(), values.size()}, true), InvalidInput);
    values[7] = 0x80000000u;
    EXPECT_THROW(setPointAttribute(*grid, "other", {values.data(), values.size()}), InvalidInput);
}

// Number of each point as an attribute of any type; and two groups.
template <typename T>
void appendNumbers(PointDataGrid& grid, const std::string& name)
{
    points::appendAttribute<T>(grid.tree(), name);
    int next = 0;
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        points::AttributeWriteHandle<T> handle(leaf->attributeArray(name));
        for (auto index = leaf->beginIndexAll(); index; ++index) handle.set(*index, T(++next));
    }
}

void appendGroup(PointDataGrid& grid, const std::string& name, int divisor)
{
    points::appendGroup(grid.tree(), name);
    int next = 0;
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        points::GroupWriteHandle handle = leaf->groupWriteHandle(name);
        for (auto index = leaf->beginIndexAll(); index; ++index) handle.set(*index, next++ % divisor == 0);
    }
}

template <typename Thrown, typename F>
void expectThrows(const std::string& what, F&& f)
{
    try {
        f();
        ADD_FAILURE() << "nothing thrown: " << what;
    } catch (const Thrown& e) {
        EXPECT_NE(std::string(e.what()).find(what), std::string::npos) << e.what();
    }
}

TEST_F(PointFileTest, readsScalarsOfAVdb)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000);
    appendNumbers<float>(*grid, "pscale");
    appendNumbers<double>(*grid, "mass");
    appendNumbers<std::int32_t>(*grid, "id");
    appendNumbers<Vec3f>(*grid, "v");
    points::appendAttribute(grid->tree(), "name", points::StringAttributeArray::attributeType());
    points::appendAttribute<float>(grid->tree(), "three", 0.0f, 3);
    points::appendAttribute<float, Truncate>(grid->tree(), "half", 0.25f);
    appendGroup(*grid, "fluid", 2);
    for (const std::uint32_t compression : {0u, kDefaultCompression}) {
        const PointDataGrid::Ptr other = makeGrid<Fixed16>(100, "other");
        const PointFile file = PointFile::read(writeFile("a.vdb", {other, grid}, compression), {"points"});
        std::vector<double> numbers(5000);
        for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = static_cast<double>(i + 1);
        EXPECT_EQ(file.readScalars("pscale"), numbers);
        EXPECT_EQ(file.readScalars("mass"), numbers);
        EXPECT_EQ(file.readScalars("half"), std::vector<double>(5000, 0.25));
        expectThrows<InvalidInput>(
            "grid 'points': has no attribute 'pscael'; did you mean 'pscale'? Its attributes are 'P', ",
            [&] { file.readScalars("pscael"); });
        expectThrows<InputError>("attribute 'v' has type vec3s; expected is float or double",
                                 [&] { file.readScalars("v"); });
        expectThrows<InputError>("'id' has type int32; expected", [&] { file.readScalars("id"); });
        expectThrows<InputError>("'name' has type string; expected", [&] { file.readScalars("name"); });
        for (const AttributeInfo& info : file.info().attributes) {
            if (info.codec == "grp")
                expectThrows<InputError>("has type group; expected", [&] { file.readScalars(info.name); });
        }
        expectThrows<InputError>("'P' has type vec3s with codec fxpt16", [&] { file.readScalars("P"); });
        expectThrows<InputError>("'three' has several values a point", [&] { file.readScalars("three"); });
    }
}

TEST_F(PointFileTest, namedValuesKeepToTheMemoryAllowed)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000);
    appendNumbers<float>(*grid, "pscale");
    appendGroup(*grid, "fluid", 2);
    PointFileOptions options;
    options.hostMemoryBytes = 79999; // 14 bytes a point fit, 16 do not
    const std::string name = writeFile("a.vdb", {grid}, 0);
    const PointFile file = PointFile::read(name, options);
    EXPECT_THROW(file.readScalars("pscale"), CapacityError);
    EXPECT_EQ(file.readGroups("fluid").size(), 5000u);
    options.hostMemoryBytes = 80000;
    EXPECT_EQ(PointFile::read(name, options).readScalars("pscale").size(), 5000u);
}

TEST_F(PointFileTest, noticesAFileThatHasChanged)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000), fewer = makeGrid<Fixed16>(4999);
    appendNumbers<float>(*grid, "pscale");
    appendNumbers<float>(*fewer, "pscale");
    const PointFile file = PointFile::read(writeFile("a.vdb", {grid}, 0));
    writeFile("a.vdb", {fewer}, 0);
    expectThrows<InputError>("has changed since", [&] { file.readScalars("pscale"); });
    fs::resize_file(writeFile("a.vdb", {grid}, 0), 5000);
    expectThrows<InputError>("has changed since", [&] { file.readScalars("pscale"); });
    // The same size, but points of other leaves.
    create(path("a.vdb"), contents(writeFile("b.vdb", {grid}, 0)));
    EXPECT_EQ(file.readScalars("pscale").size(), 5000u);
    const PointDataGrid::Ptr moved = grid->deepCopy();
    moved->clear();
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        auto* copy = new Leaf(*leaf);
        copy->setOrigin(leaf->origin().offsetBy(8, 0, 0));
        moved->tree().addLeaf(copy);
    }
    writeFile("a.vdb", {moved}, 0);
    ASSERT_EQ(fs::file_size(path("a.vdb")), fs::file_size(path("b.vdb")));
    expectThrows<InputError>("grid 'points' has changed since", [&] { file.readScalars("pscale"); });
}

TEST_F(PointFileTest, readsGroupsOfAVdb)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000);
    for (int k = 2; k < 13; ++k) appendGroup(*grid, "by" + std::to_string(k), k); // more than one array holds
    const PointFile file = PointFile::read(writeFile("a.vdb", {grid}, kDefaultCompression));
    EXPECT_EQ(file.info().groups.size(), 11u);
    EXPECT_EQ(file.info().groups[0], "by10");
    const auto check = [&](const std::string& list, const auto& isIn) {
        const std::vector<std::uint8_t> chosen = file.readGroups(list);
        ASSERT_EQ(chosen.size(), 5000u);
        for (std::size_t i = 0; i < chosen.size(); ++i)
            ASSERT_EQ(chosen[i] != 0, isIn(i)) << list << " " << i;
    };
    check("by3", [](std::size_t i) { return i % 3 == 0; });
    check("by2, by11", [](std::size_t i) { return i % 2 == 0 || i % 11 == 0; });
    check(" ^by4 ,by2 ,^ by12", [](std::size_t i) { return i % 2 == 0 && i % 4 != 0 && i % 12 != 0; });
    check("^by2", [](std::size_t i) { return i % 2 != 0; });
    check("by2,^by2", [](std::size_t) { return false; });
    expectThrows<InvalidInput>("an empty name", [&] { file.readGroups("by2,"); });
    expectThrows<InvalidInput>("an empty name", [&] { file.readGroups(""); });
    expectThrows<InvalidInput>("an empty name", [&] { file.readGroups("by2,^"); });
    expectThrows<InvalidInput>("has no point group 'bye3'; did you mean 'by3'? Its groups are 'by10', ",
                               [&] { file.readGroups("bye3"); });
    const PointFile plain = PointFile::read(writeFile("b.vdb", {makeGrid<Fixed16>(10)}, 0));
    expectThrows<InvalidInput>("has no point group 'a'; it has no groups", [&] { plain.readGroups("a"); });
    create(path("a.xyz"), "1 2 3\n");
    expectThrows<InvalidInput>("a .xyz file has no point groups",
                               [&] { PointFile::read(path("a.xyz")).readGroups("a"); });
    expectThrows<InvalidInput>("a .xyz file has no named values",
                               [&] { PointFile::read(path("a.xyz")).readScalars("a"); });
}

TEST_F(PointFileTest, readsScalarsOfLeavesThatDiffer)
{
    // One leaf has the attribute and the group, another one neither, and one is without points.
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    grid->setName("points");
    addLeaf(*grid, Coord(0), {{3, Vec3f(0.1f)}, {5, Vec3f(0.2f)}});
    points::appendAttribute<float>(grid->tree(), "pscale", 2.5f);
    points::appendGroup(grid->tree(), "some");
    points::setGroup(grid->tree(), "some", true);
    addLeaf(*grid, Coord(80), {{7, Vec3f(0)}});
    addLeaf(*grid, Coord(160), {});
    const PointFile file = PointFile::read(writeFile("a.vdb", {grid}, kDefaultCompression));
    EXPECT_EQ(file.readScalars("pscale"), (std::vector<double>{2.5, 2.5, 0}));
    EXPECT_EQ(file.readGroups("some"), (std::vector<std::uint8_t>{1, 1, 0}));
    EXPECT_EQ(file.readGroups("^some"), (std::vector<std::uint8_t>{0, 0, 1}));
}

TEST_F(PointFileTest, readsScalarsOfAPly)
{
    create(path("a.ply"), "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                          "property float z\nproperty double r\nend_header\n1 2 3 0.5\n4 5 6 0.7\n");
    const PointFile file = PointFile::read(path("a.ply"));
    EXPECT_EQ(file.readScalars("r"), (std::vector<double>{0.5, 0.7}));
    ASSERT_EQ(file.info().attributes.size(), 4u);
    EXPECT_EQ(file.info().attributes[3].name, "r");
    EXPECT_EQ(file.info().attributes[3].type, "double");
    EXPECT_EQ(file.info().attributes[3].codec, "");
    expectThrows<InvalidInput>("has no property 'q'", [&] { file.readScalars("q"); });
    std::ofstream(path("a.ply"), std::ios::app) << "7 8 9 1\n";
    expectThrows<InputError>("has changed since", [&] { file.readScalars("r"); });
}

// --------------------------------------------------------------------------------------------- reading files

TEST_F(PointFileTest, readsEveryCodecAndCompression)
{
    const PointDataGrid::Ptr grids[] = {makeGrid<points::NullCodec>(3000), makeGrid<Truncate>(3000),
                                        makeGrid<Fixed16>(3000), makeGrid<Fixed8>(3000)};
    const char* const codecs[] = {"null", "trnc", "fxpt16", "fxpt8"};
    for (int i = 0; i < 4; ++i) {
        for (const std::uint32_t compression : {0u, 1u, kDefaultCompression}) {
            const PointFile file = PointFile::read(writeFile("a.VDB", {grids[i]}, compression));
            checkView(file.view(), *grids[i]);
            EXPECT_EQ(file.info().codec, codecs[i]);
        }
    }
}

TEST_F(PointFileTest, viewsOutliveTheFile)
{
    const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(1000);
    const ParticleView view = PointFile::read(writeFile("a.vdb", {grid}, 0)).view();
    checkView(view, *grid);
    create(path("a.xyz"), "1 2 3\n4 5 6\n");
    const ParticleView array = PointFile::read(path("a.xyz")).view();
    EXPECT_EQ(array.worldPosition(1), (Vec3d{4, 5, 6}));
}

// A byte is missing at 50 places spread over the file, the last ones among them.
TEST_F(PointFileTest, noticesTruncationAnywhere)
{
    const openvdb::FloatGrid::Ptr volume = openvdb::FloatGrid::create(1.0f);
    volume->fill(openvdb::CoordBBox(Coord(0), Coord(20)), 2.0f);
    const auto checkCuts = [&](const std::string& whole) {
        for (int cut = 0; cut < 50; ++cut) {
            const std::size_t kept = cut < 25 ? whole.size() - 1 - static_cast<std::size_t>(cut)
                                              : whole.size() * static_cast<std::size_t>(cut - 25) / 25;
            create(path("cut.vdb"), whole.substr(0, kept));
            EXPECT_THROW(PointFile::read(path("cut.vdb")), InputError) << kept << " of " << whole.size();
        }
    };
    for (const PointDataGrid::Ptr& grid : {makeGrid<points::NullCodec>(2000), makeGrid<Truncate>(2000),
                                           makeGrid<Fixed16>(2000), makeGrid<Fixed8>(2000)}) {
        for (const std::uint32_t compression : {0u, 1u, kDefaultCompression}) {
            checkCuts(contents(writeFile("a.vdb", {grid}, compression)));
        }
        checkCuts(contents(writeFile("a.vdb", {grid, volume}, kDefaultCompression)));
    }
    // Written as a stream: no places in the directory to hold the size against.
    std::ofstream out(path("stream.vdb"), std::ios::binary);
    openvdb::io::Stream(out).write(openvdb::GridCPtrVec{makeGrid<points::NullCodec>(2000)});
    out.close();
    checkView(PointFile::read(path("stream.vdb")).view(), *makeGrid<points::NullCodec>(2000));
    checkCuts(contents(path("stream.vdb")));
}

TEST_F(PointFileTest, takesMemoryForTheChosenGridOnly)
{
    const openvdb::FloatGrid::Ptr volume = openvdb::FloatGrid::create(1.0f);
    volume->denseFill(openvdb::CoordBBox(Coord(0), Coord(99)), 2.0f); // 4 MB
    const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(100);
    const PointDataGrid::Ptr instance = openvdb::gridPtrCast<PointDataGrid>(grid->copyGrid());
    instance->setName("instance");
    writeFile("a.vdb", {volume, grid, instance}, 0);
    ASSERT_GT(fs::file_size(path("a.vdb")), 4'000'000u);
    for (const char* const name : {"points", "instance"}) {
        EXPECT_EQ(PointFile::read(path("a.vdb"), {name, 2'000'000, nullptr}).view().size(), 100u);
        EXPECT_THROW(PointFile::read(path("a.vdb"), {name, 1'400, nullptr}),
                     CapacityError); // 14 bytes a point
    }
    // Written as a stream, what stands before it is passed over.
    std::ofstream out(path("stream.vdb"), std::ios::binary);
    openvdb::io::Stream stream(out);
    stream.setCompression(0);
    stream.write(openvdb::GridCPtrVec{volume, grid});
    out.close();
    EXPECT_EQ(PointFile::read(path("stream.vdb"), {"", 2'000'000, nullptr}).view().size(), 100u);
    EXPECT_THROW(PointFile::read(path("stream.vdb"), {"", 1'400, nullptr}), CapacityError);
}

// A damaged file, which would look as if it had no points.
TEST_F(PointFileTest, refusesAnInstanceWithoutATree)
{
    const PointDataGrid::Ptr parent = makeGrid<points::NullCodec>(100, "parent");
    const PointDataGrid::Ptr shares = openvdb::gridPtrCast<PointDataGrid>(parent->copyGrid());
    shares->setName("shares");
    writeFile("a.vdb", {parent, shares}, 0);
    std::ofstream out(path("stream.vdb"), std::ios::binary);
    openvdb::io::Stream(out).write(openvdb::GridCPtrVec{parent, shares});
    out.close();
    for (const std::string& file : {path("a.vdb"), path("stream.vdb")}) {
        EXPECT_EQ(PointFile::read(file, {"shares"}).view().size(), 100u) << file;
        std::string bytes = contents(file);
        bytes.replace(bytes.rfind("parent"), 6, "shares");
        create(file, bytes);
        EXPECT_THROW(PointFile::read(file, {"shares"}), InputError) << file;
    }
    EXPECT_EQ(PointFile::read(path("a.vdb"), {"parent"}).view().size(), 100u);
}

TEST_F(PointFileTest, choosesAGrid)
{
    const PointDataGrid::Ptr a = makeGrid<points::NullCodec>(10, "a");
    const PointDataGrid::Ptr b = makeGrid<points::NullCodec>(20, "b");
    const PointDataGrid::Ptr unnamed = makeGrid<points::NullCodec>(30, "");
    const openvdb::FloatGrid::Ptr volume = openvdb::FloatGrid::create();
    volume->setName("volume");

    writeFile("one.vdb", {volume, a}, 0);
    EXPECT_EQ(PointFile::read(path("one.vdb")).info().grid, "a");
    EXPECT_EQ(PointFile::read(path("one.vdb"), {"a"}).view().size(), 10u);
    EXPECT_THROW(PointFile::read(path("one.vdb"), {"volume"}), InvalidInput);
    EXPECT_THROW(PointFile::read(path("one.vdb"), {"c"}), InvalidInput);

    writeFile("two.vdb", {b, volume, a}, 0);
    EXPECT_EQ(PointFile::read(path("two.vdb"), {"b"}).view().size(), 20u);
    try {
        PointFile::read(path("two.vdb"));
        ADD_FAILURE() << "no error";
    } catch (const InvalidInput& error) {
        EXPECT_NE(std::string(error.what()).find("'b', 'a'"), std::string::npos) << error.what();
    }

    writeFile("same.vdb", {a, unnamed, makeGrid<points::NullCodec>(40, "a")}, 0);
    EXPECT_THROW(PointFile::read(path("same.vdb"), {"a"}), InvalidInput);
    EXPECT_EQ(PointFile::read(path("same.vdb"), {"a[0]"}).view().size(), 10u);
    EXPECT_EQ(PointFile::read(path("same.vdb"), {"a[1]"}).view().size(), 40u);
    EXPECT_EQ(PointFile::read(path("same.vdb"), {"[0]"}).view().size(), 30u);
    EXPECT_EQ(PointFile::read(writeFile("unnamed.vdb", {unnamed}, 0)).view().size(), 30u);

    EXPECT_THROW(PointFile::read(writeFile("none.vdb", {volume}, 0)), InputError);
    EXPECT_THROW(PointFile::read(writeFile("empty.vdb", {}, 0)), InputError);
}

TEST_F(PointFileTest, refusesWhatIsNoPointFile)
{
    EXPECT_THROW(PointFile::read(path("missing.vdb")), InputError);
    EXPECT_THROW(PointFile::read(path("missing.npy")), InputError);
    EXPECT_THROW(PointFile::read(path("file.obj")), InvalidInput);
    EXPECT_THROW(PointFile::read(path("noextension")), InvalidInput);
    fs::create_directory(path("folder.vdb"));
    EXPECT_THROW(PointFile::read(path("folder.vdb")), InputError);
    EXPECT_THROW(PointFile::read("/dev/null"), InvalidInput);
    create(path("text.vdb"), "this is no volume at all, but it is long enough to have a header");
    EXPECT_THROW(PointFile::read(path("text.vdb")), InputError);
    create(path("empty.vdb"), "");
    EXPECT_THROW(PointFile::read(path("empty.vdb")), InputError);
    create(path("a.xyz"), "1 2 3\n");
    EXPECT_THROW(PointFile::read(path("a.xyz"), {"points"}), InvalidInput);

    std::string old = contents(writeFile("a.vdb", {makeGrid<points::NullCodec>(10)}, 0));
    old[8] = static_cast<char>(222);
    create(path("old.vdb"), old);
    EXPECT_THROW(PointFile::read(path("old.vdb")), InputError);
}

TEST_F(PointFileTest, readsAGridWithoutPoints)
{
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    grid->tree().addTile(1, Coord(0), 0, true);
    const PointFile file = PointFile::read(writeFile("a.vdb", {grid}, 0));
    EXPECT_EQ(file.view().size(), 0u);
    EXPECT_EQ(file.info().points, 0u);
    EXPECT_FALSE(file.info().bbox);
    file.writeVdb(path("b.vdb"), {}, "nns_", {});
    EXPECT_EQ(PointFile::read(path("b.vdb")).view().size(), 0u);
}

TEST_F(PointFileTest, describesAGrid)
{
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    grid->setName("drops");
    grid->setTransform(openvdb::math::Transform::createLinearTransform(
        openvdb::Mat4d(0., 0.5, 0., 0., -0.25, 0., 0., 0., 0., 0., 2., 0., 10., 20., 30., 1.)));
    const float kNan = std::numeric_limits<float>::quiet_NaN();
    addLeaf(*grid, Coord(0), {{0, Vec3f(0.5f, 0, 0)}, {9, Vec3f(0, 0, 0.25f)}, {73, Vec3f(0, kNan, 0)}});
    grid->insertMeta("suggested_radius", openvdb::DoubleMetadata(0.1));
    const PointFile file = PointFile::read(writeFile("a.vdb", {grid}, 0));
    const PointFileInfo& info = file.info();
    EXPECT_EQ(info.path, path("a.vdb"));
    EXPECT_EQ(info.format, "vdb");
    EXPECT_EQ(info.grid, "drops");
    EXPECT_EQ(info.points, 3u);
    EXPECT_EQ(info.nonfinite, 1u);
    EXPECT_EQ(info.codec, "null");
    ASSERT_TRUE(info.voxelSize);
    EXPECT_EQ(*info.voxelSize, (Vec3d{0.5, 0.25, 2}));
    // Index (0.5, 0, 0) and (0, 1, 1.25): row vectors times the matrix above.
    ASSERT_TRUE(info.bbox);
    EXPECT_EQ((*info.bbox)[0], (Vec3d{9.75, 20, 30}));
    EXPECT_EQ((*info.bbox)[1], (Vec3d{10, 20.25, 32.5}));
    EXPECT_EQ(info.transform[0], (std::array<double, 4>{0, -0.25, 0, 10}));
    EXPECT_EQ(info.transform[3], (std::array<double, 4>{0, 0, 0, 1}));
    ASSERT_TRUE(info.suggestedRadius);
    EXPECT_EQ(*info.suggestedRadius, 0.1);
    ASSERT_EQ(info.attributes.size(), 1u);
    EXPECT_EQ(info.attributes[0].name, "P");
    EXPECT_EQ(info.attributes[0].type, "vec3s");
    EXPECT_EQ(info.attributes[0].codec, "null");

    grid->insertMeta("other", openvdb::FloatMetadata(0.5f));
    grid->removeMeta("suggested_radius");
    EXPECT_FALSE(PointFile::read(writeFile("b.vdb", {grid}, 0)).info().suggestedRadius);
    grid->insertMeta("suggested_radius", openvdb::FloatMetadata(0.5f));
    EXPECT_EQ(PointFile::read(writeFile("c.vdb", {grid}, 0)).info().suggestedRadius, 0.5);
}

TEST_F(PointFileTest, describesAnArray)
{
    create(path("a.xyz"), "1 2 3\nnan 0 0\n-4 5 6\n");
    const PointFile file = PointFile::read(path("a.xyz"));
    const PointFileInfo& info = file.info();
    EXPECT_EQ(info.format, "xyz");
    EXPECT_EQ(info.points, 3u);
    EXPECT_EQ(info.nonfinite, 1u);
    EXPECT_EQ(info.codec, "float64");
    EXPECT_FALSE(info.voxelSize);
    ASSERT_TRUE(info.bbox);
    EXPECT_EQ((*info.bbox)[0], (Vec3d{-4, 2, 3}));
    EXPECT_EQ((*info.bbox)[1], (Vec3d{1, 5, 6}));
    EXPECT_EQ(info.transform[1], (std::array<double, 4>{0, 1, 0, 0}));
    EXPECT_THROW(file.writeVdb(path("b.vdb"), {}, "nns_", {}), InvalidInput);
}

// --------------------------------------------------------------------------------------------- writing files

std::vector<std::uint32_t> numbered(std::size_t count)
{
    std::vector<std::uint32_t> values(count);
    for (std::size_t i = 0; i < count; ++i) values[i] = static_cast<std::uint32_t>(i % 97);
    return values;
}

void checkSameAttributes(const PointDataGrid& before, const PointDataGrid& after)
{
    auto a = before.tree().cbeginLeaf(), b = after.tree().cbeginLeaf();
    for (; a && b; ++a, ++b) {
        ASSERT_EQ(a->origin(), b->origin());
        for (const auto& [name, position] : a->attributeSet().descriptor().map()) {
            ASSERT_TRUE(*a->attributeSet().getConst(position) == *b->attributeSet().getConst(name)) << name;
        }
    }
    EXPECT_FALSE(a || b);
}

TEST_F(PointFileTest, writesTheSameFileWithCounts)
{
    const PointDataGrid::Ptr grid = makeGrid<Fixed16>(5000, "fluid");
    points::appendAttribute<Vec3f, Truncate>(grid->tree(), "v", Vec3f(1, 2, 3));
    points::appendGroup(grid->tree(), "spray");
    grid->insertMeta("author", openvdb::StringMetadata("somebody"));
    const PointDataGrid::Ptr second = makeGrid<points::NullCodec>(100, "fluid");
    const openvdb::FloatGrid::Ptr fog = openvdb::FloatGrid::create(0.0f);
    fog->setName("zz fog first in the file");
    fog->setGridClass(openvdb::GRID_FOG_VOLUME);
    fog->setSaveFloatAsHalf(true);
    fog->fill(openvdb::CoordBBox(Coord(0), Coord(20)), 0.3f);
    const openvdb::FloatGrid::Ptr instance = openvdb::gridPtrCast<openvdb::FloatGrid>(fog->copyGrid());
    instance->setName("instance");
    openvdb::MetaMap metadata;
    metadata.insertMeta("creator", openvdb::StringMetadata("a test"));

    for (const std::uint32_t compression : {0u, 1u, 4u, kDefaultCompression}) {
        const std::string input = writeFile("in.vdb", {fog, instance, grid, second}, compression, metadata);
        const PointFile file = PointFile::read(input, {"fluid[0]"});
        const std::vector<std::uint32_t> counts = numbered(5000);
        file.writeVdb(path("out.vdb"), {counts.data(), counts.size()}, "nns_", kOverwrite);
        checkView(file.view(), *grid); // the file in memory is as before
        EXPECT_EQ(file.info().attributes.size(), 3u);

        openvdb::io::File out(path("out.vdb"));
        out.open(false);
        EXPECT_EQ(*out.getMetadata(), metadata);
        const openvdb::GridPtrVecPtr grids = out.getGrids();
        ASSERT_EQ(grids->size(), 4u);
        const auto written = openvdb::gridPtrCast<PointDataGrid>(out.readGrid("fluid[0]"));
        openvdb::io::File in(input);
        in.open(false);
        const auto original = openvdb::gridPtrCast<PointDataGrid>(in.readGrid("fluid[0]"));
        ASSERT_TRUE(written && original);
        checkSameAttributes(*original, *written);
        EXPECT_EQ(written->transform(), original->transform());
        EXPECT_EQ(written->metaValue<std::string>("author"), "somebody");
        EXPECT_EQ(written->metaValue<std::string>("file_compression"),
                  original->metaValue<std::string>("file_compression"));
        std::size_t next = 0;
        for (auto leaf = written->tree().cbeginLeaf(); leaf; ++leaf) {
            const points::AttributeHandle<std::int32_t> handle(leaf->constAttributeArray("nns_count"));
            for (auto index = leaf->beginIndexAll(); index; ++index, ++next) {
                ASSERT_EQ(handle.get(*index), static_cast<std::int32_t>(counts[next]));
            }
        }
        EXPECT_EQ(next, counts.size());

        // Everything before the changed grid is as it was, but for the UUID (36 bytes at 21): metadata,
        // order, fog, instance.
        const std::string before = contents(input), after = contents(path("out.vdb"));
        const std::size_t changed = before.find("fluid\x1e"
                                                "0");
        ASSERT_NE(changed, std::string::npos);
        EXPECT_EQ(before.substr(0, 21), after.substr(0, 21));
        EXPECT_TRUE(before.substr(57, changed - 57) == after.substr(57, changed - 57));
        // And the grid behind it, but for the places in its descriptor.
        const std::size_t tail = before.size() -
                                 before.find("fluid\x1e"
                                             "1") -
                                 100;
        EXPECT_TRUE(before.substr(before.size() - tail) == after.substr(after.size() - tail));
    }
}

TEST_F(PointFileTest, writesTheSameBytesEveryTime)
{
    writeFile("in.vdb", {makeGrid<points::NullCodec>(5000)}, kDefaultCompression);
    const std::vector<std::uint32_t> counts = numbered(5000);
    const PointFile file = PointFile::read(path("in.vdb"));
    file.writeVdb(path("a.vdb"), {counts.data(), counts.size()}, "x_", {});
    PointFile::read(path("in.vdb")).writeVdb(path("b.vdb"), {counts.data(), counts.size()}, "x_", {});
    file.writeVdb(path("c.vdb"), {counts.data(), counts.size()}, "x_", {});
    const std::string a = contents(path("a.vdb")), b = contents(path("b.vdb")), c = contents(path("c.vdb"));
    EXPECT_TRUE(a.substr(57) == b.substr(57));
    EXPECT_TRUE(a.substr(57) == c.substr(57));
    EXPECT_FALSE(a.substr(21, 36) == b.substr(21, 36));
}

TEST_F(PointFileTest, copiesFilesWrittenAsAStream)
{
    const openvdb::FloatGrid::Ptr volume = openvdb::FloatGrid::create(1.0f);
    volume->fill(openvdb::CoordBBox(Coord(0), Coord(20)), 2.0f);
    volume->setName("volume");
    std::ofstream out(path("in.vdb"), std::ios::binary);
    openvdb::io::Stream(out).write(openvdb::GridCPtrVec{volume, makeGrid<Fixed8>(500)});
    out.close();
    const std::vector<std::uint32_t> counts = numbered(500);
    PointFile::read(path("in.vdb")).writeVdb(path("out.vdb"), {counts.data(), counts.size()}, "nns_", {});
    const PointFile file = PointFile::read(path("out.vdb"));
    checkView(file.view(), *makeGrid<Fixed8>(500));
    EXPECT_EQ(file.info().attributes.size(), 2u);
    openvdb::io::File copy(path("out.vdb"));
    copy.open(false);
    EXPECT_TRUE(openvdb::gridPtrCast<openvdb::FloatGrid>(copy.readGrid("volume"))
                    ->tree()
                    .hasSameTopology(volume->tree()));
}

TEST_F(PointFileTest, replacesItsInputWhenAllowed)
{
    const PointDataGrid::Ptr grid = makeGrid<points::NullCodec>(5000);
    const openvdb::FloatGrid::Ptr volume = openvdb::FloatGrid::create(1.0f);
    writeFile("in.vdb", {volume, grid}, kDefaultCompression);
    const std::vector<std::uint32_t> counts = numbered(5000);
    const PointFile file = PointFile::read(path("in.vdb"));
    EXPECT_THROW(file.writeVdb(path("in.vdb"), {counts.data(), counts.size()}, "nns_", {}), OutputExists);
    file.writeVdb(path("in.vdb"), {counts.data(), counts.size()}, "nns_", kOverwrite);
    const PointFile again = PointFile::read(path("in.vdb"));
    checkView(again.view(), *grid);
    EXPECT_EQ(again.info().attributes.size(), 2u);
    EXPECT_EQ(fileCount(), 1u);

    // An attribute of that name is an error, or replaced.
    EXPECT_THROW(again.writeVdb(path("b.vdb"), {counts.data(), counts.size()}, "nns_", {}), InvalidInput);
    again.writeVdb(path("b.vdb"), {counts.data(), counts.size()}, "nns_", kOverwrite);
    EXPECT_EQ(PointFile::read(path("b.vdb")).info().attributes.size(), 2u);
    EXPECT_THROW(again.writeVdb(path("c.vdb"), {counts.data(), 10}, "x_", {}), InvalidInput);
    EXPECT_EQ(fileCount(), 2u);
}

TEST_F(PointFileTest, leavesNothingBehindWhenWritingFails)
{
    writeFile("in.vdb", {makeGrid<points::NullCodec>(50000)}, 0);
    const std::vector<std::uint32_t> counts = numbered(50000);
    const PointFile file = PointFile::read(path("in.vdb"));
    const std::string before = contents(path("in.vdb"));

    class Stop final : public Progress {
    public:
        void update(const char*, double fraction) override { mFraction = fraction; }
        bool cancelled() const override { return mFraction > 0.01; }

    private:
        double mFraction = 0;
    } stop;
    EXPECT_THROW(file.writeVdb(path("out.vdb"), {counts.data(), counts.size()}, "nns_", {}, &stop),
                 Cancelled);

    rlimit old{};
    ::getrlimit(RLIMIT_FSIZE, &old);
    const auto handler = std::signal(SIGXFSZ, SIG_IGN);
    const rlimit lower{before.size() / 2, old.rlim_max};
    ::setrlimit(RLIMIT_FSIZE, &lower);
    EXPECT_THROW(file.writeVdb(path("in.vdb"), {counts.data(), counts.size()}, "nns_", kOverwrite),
                 OutputError);
    ::setrlimit(RLIMIT_FSIZE, &old);
    std::signal(SIGXFSZ, handler);

    EXPECT_TRUE(contents(path("in.vdb")) == before);
    EXPECT_EQ(fileCount(), 1u);
    file.writeVdb(path("out.vdb"), {counts.data(), counts.size()}, "nns_", {});
    EXPECT_EQ(PointFile::read(path("out.vdb")).info().attributes.size(), 2u);
}

} // namespace
} // namespace vdb_nns
