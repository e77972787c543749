// Points that are written, read back by OpenVDB's own handles (.vdb) and by a few lines that know the format (.ply, .npz).
#include "vdb_nns/error.h"
#include "vdb_nns/openvdb_bridge.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/write_points.h"

#include <gtest/gtest.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointAttribute.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PointGroup.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <random>
#include <sstream>
#include <string>
#include <vector>

namespace vdb_nns {
namespace {

namespace fs = std::filesystem;
namespace points = openvdb::points;
using points::PointDataGrid;

constexpr OutputOptions kOverwrite{true};
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

class WritePointsTest : public ::testing::Test {
protected:
    WritePointsTest()
    {
        openvdb::initialize();
        std::string name = (fs::temp_directory_path() / "vdb_nns_write_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~WritePointsTest() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    static std::string contents(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(stream), {}};
    }

    // Without the UUID that OpenVDB draws.
    static std::string withoutUuid(const std::string& file)
    {
        std::string bytes = contents(file);
        return bytes.erase(21, 36);
    }

    static PointDataGrid::Ptr readGrid(const std::string& file, const std::string& name = "points")
    {
        openvdb::io::File stream(file);
        stream.open(false);
        return openvdb::gridPtrCast<PointDataGrid>(stream.readGrid(name));
    }

    std::size_t fileCount() const
    {
        return static_cast<std::size_t>(std::distance(fs::directory_iterator(mFolder), {}));
    }

    fs::path mFolder;
};

std::vector<double> randomPositions(std::size_t count, double extent)
{
    std::mt19937_64 random(11);
    std::vector<double> positions(3 * count);
    for (double& x : positions) x = (static_cast<double>(random() >> 11) * 0x1p-53 - 0.5) * extent;
    return positions;
}

ParticleView viewOfDoubles(const std::vector<double>& positions)
{
    return ParticleView::fromArray(positions.data(), positions.size() / 3);
}

// Values of every kind, each of which tells the point and the component.
struct EveryValue {
    explicit EveryValue(std::size_t n)
        : floats(n),
          doubles(n),
          ints(n),
          longs(n),
          vectors(3 * n),
          wideVectors(3 * n),
          matrices(9 * n),
          group(n)
    {
        for (std::size_t i = 0; i < n; ++i) {
            floats[i] = static_cast<float>(i) + 0.5f;
            doubles[i] = static_cast<double>(i) + 1.0 / 3;
            ints[i] = static_cast<std::int32_t>(i) - 7;
            longs[i] = (std::int64_t(1) << 52) + static_cast<std::int64_t>(i);
            for (std::size_t k = 0; k < 3; ++k) {
                vectors[3 * i + k] = static_cast<float>(10 * i + k);
                wideVectors[3 * i + k] = static_cast<double>(10 * i + k) / 7;
            }
            for (std::size_t k = 0; k < 9; ++k) matrices[9 * i + k] = static_cast<float>(10 * i + k);
            group[i] = i % 3 == 0 ? 255 : 0;
        }
        const auto add = [&](const char* name, AttributeType type, const void* data) {
            values.attributes.push_back(viewAttribute(name, type, data, n));
        };
        add("f", AttributeType::kFloat, floats.data());
        add("d", AttributeType::kDouble, doubles.data());
        add("i", AttributeType::kInt32, ints.data());
        add("l", AttributeType::kInt64, longs.data());
        add("v", AttributeType::kVec3s, vectors.data());
        add("w", AttributeType::kVec3d, wideVectors.data());
        add("m", AttributeType::kMat3s, matrices.data());
        values.groups.push_back(viewGroup("third", {group.data(), n}));
        none.assign(n, 0);
        values.groups.push_back(viewGroup("none", {none.data(), n}));
    }

    std::vector<float> floats;
    std::vector<double> doubles;
    std::vector<std::int32_t> ints;
    std::vector<std::int64_t> longs;
    std::vector<float> vectors;
    std::vector<double> wideVectors;
    std::vector<float> matrices;
    std::vector<std::uint8_t> group, none;
    PointValues values;
};

// What OpenVDB reads of a grid whose points have these values; numberOf(leaf, index) is a point's number among them.
template <typename NumberOf>
void expectValues(const PointDataGrid& grid, const EveryValue& expected, const NumberOf& numberOf)
{
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const points::AttributeHandle<float> f(leaf->constAttributeArray("f"));
        const points::AttributeHandle<double> d(leaf->constAttributeArray("d"));
        const points::AttributeHandle<std::int32_t> i(leaf->constAttributeArray("i"));
        const points::AttributeHandle<std::int64_t> l(leaf->constAttributeArray("l"));
        const points::AttributeHandle<openvdb::Vec3f> v(leaf->constAttributeArray("v"));
        const points::AttributeHandle<openvdb::Vec3d> w(leaf->constAttributeArray("w"));
        const points::AttributeHandle<openvdb::Mat3s> m(leaf->constAttributeArray("m"));
        const points::GroupHandle third = leaf->groupHandle("third"), none = leaf->groupHandle("none");
        for (auto index = leaf->beginIndexAll(); index; ++index) {
            const std::size_t n = numberOf(*leaf, *index);
            ASSERT_EQ(f.get(*index), expected.floats[n]);
            ASSERT_EQ(d.get(*index), expected.doubles[n]);
            ASSERT_EQ(i.get(*index), expected.ints[n]);
            ASSERT_EQ(l.get(*index), expected.longs[n]);
            for (int k = 0; k < 3; ++k) {
                const std::size_t place = 3 * n + static_cast<std::size_t>(k);
                ASSERT_EQ(v.get(*index)[k], expected.vectors[place]);
                ASSERT_EQ(w.get(*index)[k], expected.wideVectors[place]);
                for (int c = 0; c < 3; ++c) { // rows of the matrix
                    ASSERT_EQ(m.get(*index)(k, c),
                              expected.matrices[9 * n + static_cast<std::size_t>(3 * k + c)]);
                }
            }
            ASSERT_EQ(third.get(*index), expected.group[n] != 0);
            ASSERT_FALSE(none.get(*index));
        }
    }
}

// The farthest that a point of the grid is from the one that its id names; every finite one is there once, and P is in its
// voxel.
double farthest(const PointDataGrid& grid, const std::vector<double>& positions)
{
    std::vector<int> seen(positions.size() / 3);
    double largest = 0;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const points::AttributeHandle<openvdb::Vec3f> p(leaf->constAttributeArray("P"));
        const points::AttributeHandle<std::int32_t> id(leaf->constAttributeArray("id"));
        std::int32_t before = -1;
        openvdb::Coord voxel;
        for (auto index = leaf->beginIndexOn(); index; ++index) {
            const auto n = static_cast<std::size_t>(id.get(*index));
            ++seen[n];
            if (index.getCoord() == voxel) { // the input's order
                EXPECT_GT(id.get(*index), before);
            }
            before = id.get(*index);
            voxel = index.getCoord();
            long double sum = 0;
            for (int k = 0; k < 3; ++k) {
                const float offset = p.get(*index)[k];
                EXPECT_LE(std::fabs(offset), 0.5f);
                const long double place = (static_cast<long double>(index.getCoord()[k]) + offset) *
                                          static_cast<long double>(grid.voxelSize()[0]);
                const long double error = place - positions[3 * n + static_cast<std::size_t>(k)];
                sum += error * error;
            }
            largest = std::max(largest, static_cast<double>(std::sqrt(sum)));
        }
    }
    for (std::size_t n = 0; n < seen.size(); ++n) {
        const bool isFinite = std::isfinite(positions[3 * n]) && std::isfinite(positions[3 * n + 1]) &&
                              std::isfinite(positions[3 * n + 2]);
        EXPECT_EQ(seen[n], isFinite) << n;
    }
    return largest;
}

// ------------------------------------------------------------------------------------------------ new .vdb

TEST_F(WritePointsTest, aNewGridHasEveryPointWhereItWas)
{
    const std::size_t count = 5000;
    std::vector<double> positions = randomPositions(count, 20);
    positions[7] = kNan;
    positions[3 * 4999 + 2] = HUGE_VAL;
    const EveryValue expected(count);
    NewGridOptions options;
    options.voxelSize = 0.3;
    options.suggestedRadius = 0.25;
    const WrittenPoints written =
        writeNewVdb(path("x.vdb"), viewOfDoubles(positions), expected.values, options);
    EXPECT_EQ(written.points, count - 2);
    EXPECT_EQ(written.skipped, 2u);
    EXPECT_EQ(written.voxelSize, 0.3);
    EXPECT_GT(written.largestRounding, 0);
    EXPECT_LE(written.largestRounding, 0.3 * 0x1p-25);

    const PointDataGrid::Ptr grid = readGrid(path("x.vdb"));
    ASSERT_TRUE(grid);
    EXPECT_EQ(grid->voxelSize(), openvdb::Vec3d(0.3));
    EXPECT_TRUE(grid->transform().isLinear());
    EXPECT_EQ(grid->metaValue<double>("suggested_radius"), 0.25);
    EXPECT_NEAR(farthest(*grid, positions), written.largestRounding, 1e-3 * written.largestRounding);
    expectValues(*grid, expected, [](const auto& leaf, openvdb::Index index) {
        return static_cast<std::size_t>(
            points::AttributeHandle<std::int32_t>(leaf.constAttributeArray("id")).get(index));
    });
}

TEST_F(WritePointsTest, floatsAreExactInVoxelsOfAPowerOfTwo)
{
    std::vector<double> positions = randomPositions(3000, 1e4);
    for (double& x : positions) x = static_cast<float>(x);
    NewGridOptions options;
    options.voxelSize = 0.125;
    EXPECT_EQ(writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, options).largestRounding, 0);
    EXPECT_EQ(farthest(*readGrid(path("x.vdb")), positions), 0);
    options.voxelSize = 0.1;
    EXPECT_GT(writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, options, kOverwrite).largestRounding,
              0);
}

TEST_F(WritePointsTest, tinyAndHugeVoxels)
{
    for (const double scale : {1e-30, 1e-9, 1e-5, 1e9, 1e30}) {
        std::vector<double> positions = randomPositions(1000, 2);
        for (double& x : positions) x *= scale;
        const WrittenPoints written =
            writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, {}, kOverwrite);
        EXPECT_NEAR(written.voxelSize, 0.4 * scale, 0.1 * scale);
        const PointDataGrid::Ptr grid = readGrid(path("x.vdb"));
        EXPECT_EQ(grid->voxelSize()[0], written.voxelSize);
        EXPECT_NEAR(farthest(*grid, positions), written.largestRounding, 1e-3 * written.largestRounding);
        EXPECT_EQ(PointFile::read(path("x.vdb")).info().voxelSize->at(1), written.voxelSize);
    }
}

TEST_F(WritePointsTest, bothSignsAndEveryNodeKeepTheirOrder)
{
    std::vector<double> positions;
    for (const double x : {-4097.0, -4096.0, -129.0, -1.0, -0.5, 0.0, 0.5, 7.0, 8.0, 127.5, 4095.5, 4096.0}) {
        for (const double y : {-9000.0, 0.25, 9000.0}) positions.insert(positions.end(), {x, y, -x});
    }
    NewGridOptions options;
    options.voxelSize = 1;
    const EveryValue expected(positions.size() / 3);
    EXPECT_EQ(writeNewVdb(path("x.vdb"), viewOfDoubles(positions), expected.values, options).largestRounding,
              0);
    const PointDataGrid::Ptr grid = readGrid(path("x.vdb"));
    EXPECT_EQ(farthest(*grid, positions), 0);
    expectValues(*grid, expected, [](const auto& leaf, openvdb::Index index) {
        return static_cast<std::size_t>(
            points::AttributeHandle<std::int32_t>(leaf.constAttributeArray("id")).get(index));
    });
}

TEST_F(WritePointsTest, aVoxelSizeIsFoundForEveryCloud)
{
    const auto meanOf = [&](const std::vector<double>& positions) {
        const WrittenPoints written =
            writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, {}, kOverwrite);
        EXPECT_GT(written.voxelSize, 0);
        const PointDataGrid::Ptr grid = readGrid(path("x.vdb"));
        return static_cast<double>(written.points) / static_cast<double>(grid->activeVoxelCount());
    };
    EXPECT_NEAR(meanOf(randomPositions(40000, 3)), 8, 0.4);
    std::vector<double> sheet = randomPositions(40000, 3);
    for (std::size_t i = 2; i < sheet.size(); i += 3) sheet[i] = 0;
    EXPECT_NEAR(meanOf(sheet), 8, 0.4);
    sheet[0] = 1e7; // an outlier
    EXPECT_NEAR(meanOf(sheet), 8, 0.4);
    std::vector<double> many = randomPositions(700000, 3); // voxels are sampled
    EXPECT_NEAR(meanOf(many), 8, 0.4);

    // Nothing to go by.
    meanOf({});
    meanOf({1e300, -1e300, 5});
    meanOf({3, 4, 5});
    meanOf(std::vector<double>(3000, -7.25));
    std::vector<double> repeated; // sixteen at each place
    for (int k = 0; k < 16; ++k) {
        const std::vector<double> places = randomPositions(500, 3);
        repeated.insert(repeated.end(), places.begin(), places.end());
    }
    EXPECT_NEAR(meanOf(repeated), 16, 1);
    const double least =
        2 * writeNewVdb(path("x.vdb"), viewOfDoubles({1e18, 0, 0, 0, 0, 1e-9}), {}, {}, kOverwrite).voxelSize;
    EXPECT_GT(least, 1e18 / 0x1p31);
}

TEST_F(WritePointsTest, anExtentThatTheVoxelsCannotHoldIsRefused)
{
    const std::vector<double> positions{0, 0, 0, 1e10, 0, 0};
    NewGridOptions options;
    options.voxelSize = 1;
    try {
        writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, options);
        FAIL();
    } catch (const InputError& error) {
        const std::string text = error.what();
        for (const char* part : {"1e+10", "2147479552", "--voxel-size of at least 4.6566"})
            EXPECT_NE(text.find(part), std::string::npos) << text;
    }
    options.voxelSize = 4.66;
    writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, options);
    EXPECT_LE(farthest(*readGrid(path("x.vdb")), positions), 4.66 * 0x1p-24);
    for (const double wrong : {-1.0, kNan, HUGE_VAL}) {
        options.voxelSize = wrong;
        EXPECT_THROW(writeNewVdb(path("y.vdb"), viewOfDoubles(positions), {}, options), InvalidInput);
    }
    EXPECT_EQ(fileCount(), 1u);
}

TEST_F(WritePointsTest, theSameBytesForAnyThreads)
{
    const std::vector<double> positions = randomPositions(30000, 5);
    const EveryValue expected(30000);
    std::map<std::string, std::string> first;
    for (const std::size_t threads : {1, 2, 5}) {
        const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        writeNewVdb(path("x.vdb"), viewOfDoubles(positions), expected.values, {}, kOverwrite);
        writePly(path("x.ply"), viewOfDoubles(positions), expected.values, kOverwrite);
        writePointsNpz(path("x.npz"), viewOfDoubles(positions), expected.values, kOverwrite);
        writePointsNpy(path("x.npy"), viewOfDoubles(positions), kOverwrite);
        for (const std::string name : {"x.vdb", "x.ply", "x.npz", "x.npy"}) {
            const std::string bytes = name == "x.vdb" ? withoutUuid(path(name)) : contents(path(name));
            if (first.count(name) == 0) first[name] = bytes;
            EXPECT_TRUE(first[name] == bytes) << name << " with " << threads << " threads";
        }
    }
}

// ------------------------------------------------------------------------------------------------ added values

TEST_F(WritePointsTest, valuesAreAddedToACopy)
{
    const std::size_t count = 4000;
    const std::vector<double> positions = randomPositions(count, 9);
    writeNewVdb(path("in.vdb"), viewOfDoubles(positions), {});
    const PointFile file = PointFile::read(path("in.vdb"));
    const EveryValue expected(count);
    file.writeVdb(path("out.vdb"), expected.values);
    const PointDataGrid::Ptr grid = readGrid(path("out.vdb"));
    const auto checkAll = [&](const PointDataGrid& checked, const EveryValue& values) {
        std::map<const void*, std::size_t> firsts;
        std::size_t next = 0;
        for (auto leaf = checked.tree().cbeginLeaf(); leaf; ++leaf) {
            firsts[&*leaf] = next;
            next += leaf->pointCount();
        }
        expectValues(checked, values,
                     [&](const auto& leaf, openvdb::Index index) { return firsts.at(&leaf) + index; });
    };
    checkAll(*grid, expected);
    // All that was there is as it was.
    const PointDataGrid::Ptr before = readGrid(path("in.vdb"));
    auto a = before->tree().cbeginLeaf(), b = grid->tree().cbeginLeaf();
    for (; a; ++a, ++b) {
        ASSERT_EQ(a->origin(), b->origin());
        const points::AttributeHandle<openvdb::Vec3f> was(a->constAttributeArray("P")),
            is(b->constAttributeArray("P"));
        const points::AttributeHandle<std::int32_t> wasId(a->constAttributeArray("id")),
            isId(b->constAttributeArray("id"));
        for (auto index = a->beginIndexAll(); index; ++index) {
            ASSERT_EQ(was.get(*index), is.get(*index));
            ASSERT_EQ(wasId.get(*index), isId.get(*index));
        }
    }

    // What exists is refused, or replaced, also by another type.
    const PointFile again = PointFile::read(path("out.vdb"));
    EXPECT_THROW(again.writeVdb(path("no.vdb"), expected.values), InvalidInput);
    PointValues group;
    group.groups = {expected.values.groups[0]};
    EXPECT_THROW(again.writeVdb(path("no.vdb"), group), InvalidInput);
    EXPECT_FALSE(fs::exists(path("no.vdb")));
    EveryValue changed(count);
    std::reverse(changed.group.begin(), changed.group.end());
    for (float& value : changed.floats) value = -value;
    again.writeVdb(path("out.vdb"), changed.values, kOverwrite);
    checkAll(*readGrid(path("out.vdb")), changed);
    PointValues other;
    other.attributes = {viewAttribute("f", AttributeType::kVec3d, expected.wideVectors.data(), count)};
    again.writeVdb(path("out.vdb"), other, kOverwrite);
    EXPECT_EQ(readGrid(path("out.vdb"))->tree().cbeginLeaf()->attributeSet().get("f")->type().first, "vec3d");
}

TEST_F(WritePointsTest, manyGroupsBesideThoseThatAreThere)
{
    const std::size_t count = 300;
    const std::vector<double> positions = randomPositions(count, 9);
    std::vector<std::vector<std::uint8_t>> members(20, std::vector<std::uint8_t>(count));
    PointValues first, second;
    for (std::size_t g = 0; g < members.size(); ++g) {
        for (std::size_t i = 0; i < count; ++i) members[g][i] = (i >> (g % 7) & 1) != 0;
        (g < 5 ? first : second)
            .groups.push_back(viewGroup("g" + std::to_string(g), {members[g].data(), count}));
    }
    NewGridOptions options;
    options.id.clear();
    options.voxelSize = 100; // one voxel keeps the order
    writeNewVdb(path("x.vdb"), viewOfDoubles(positions), first, options);
    PointFile::read(path("x.vdb")).writeVdb(path("y.vdb"), second);
    const PointDataGrid::Ptr grid = readGrid(path("y.vdb"));
    std::size_t number = 0;
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        for (auto index = leaf->beginIndexAll(); index; ++index, ++number) {
            for (std::size_t g = 0; g < members.size(); ++g)
                ASSERT_EQ(leaf->groupHandle("g" + std::to_string(g)).get(*index), members[g][number] != 0);
        }
    }
    EXPECT_EQ(number, count);
    const PointFile file = PointFile::read(path("y.vdb"));
    EXPECT_EQ(file.readValues(file.listValues()).groups.size(), 20u);
}

TEST_F(WritePointsTest, valuesThatDoNotFitAreRefused)
{
    const std::vector<double> positions = randomPositions(10, 9);
    writeNewVdb(path("in.vdb"), viewOfDoubles(positions), {});
    const PointFile file = PointFile::read(path("in.vdb"));
    const std::vector<float> floats(30);
    const auto one = [&](const std::string& name, std::uint64_t count, const void* data) {
        PointValues values;
        values.attributes = {viewAttribute(name, AttributeType::kFloat, data, count)};
        return values;
    };
    const ParticleView view = viewOfDoubles(positions);
    const auto refuseAll = [&](const PointValues& values) {
        EXPECT_THROW(file.writeVdb(path("x.vdb"), values), InvalidInput);
        EXPECT_THROW(writeNewVdb(path("x.vdb"), view, values), InvalidInput);
        EXPECT_THROW(writePly(path("x.ply"), view, values), InvalidInput);
        EXPECT_THROW(writePointsNpz(path("x.npz"), view, values), InvalidInput);
    };
    refuseAll(one("a", 9, floats.data()));
    refuseAll(one("a", 11, floats.data()));
    refuseAll(one("a", 10, nullptr));
    refuseAll(one("", 10, floats.data()));
    PointValues twice = one("a", 10, floats.data());
    twice.attributes.push_back(twice.attributes[0]);
    refuseAll(twice);
    for (const char* name : {"P", "id", "a b", "a-b"}) {
        EXPECT_THROW(writeNewVdb(path("x.vdb"), view, one(name, 10, floats.data())), InvalidInput) << name;
        EXPECT_THROW(file.writeVdb(path("x.vdb"), one(name, 10, floats.data())), InvalidInput) << name;
    }
    EXPECT_THROW(file.writeVdb(path("x.vdb"), one("P", 10, floats.data()), kOverwrite), InvalidInput);
    for (const char* name : {"x", "y", "z", "a b", "a\n"})
        EXPECT_THROW(writePly(path("x.ply"), view, one(name, 10, floats.data())), InvalidInput) << name;
    for (const char* name : {"positions", "a/b", "a\n"})
        EXPECT_THROW(writePointsNpz(path("x.npz"), view, one(name, 10, floats.data())), InvalidInput) << name;
    PointValues clash = one("normal", 10, floats.data());
    clash.attributes[0].type = AttributeType::kVec3s;
    clash.attributes.push_back(viewAttribute("ny", AttributeType::kFloat, floats.data(), 10));
    EXPECT_THROW(writePly(path("x.ply"), view, clash), InvalidInput);
    EXPECT_EQ(fileCount(), 1u);
}

TEST_F(WritePointsTest, aGridOfAHostProgramGetsValues)
{
    const std::vector<double> positions = randomPositions(1000, 9);
    writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {});
    const PointDataGrid::Ptr grid = readGrid(path("x.vdb"));
    const EveryValue expected(1000);
    addPointValues(*grid, expected.values);
    std::map<const void*, std::size_t> firsts;
    std::size_t next = 0;
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        firsts[&*leaf] = next;
        next += leaf->pointCount();
    }
    expectValues(*grid, expected,
                 [&](const auto& leaf, openvdb::Index index) { return firsts.at(&leaf) + index; });
    EXPECT_THROW(addPointValues(*grid, expected.values), InvalidInput);
    addPointValues(*grid, expected.values, /*overwrite=*/true);
    EXPECT_THROW(addPointValues(*grid, EveryValue(999).values, /*overwrite=*/true), InvalidInput);
}

// ------------------------------------------------------------------------------------------------ reading values

TEST_F(WritePointsTest, whatWasWrittenIsReadBack)
{
    const std::size_t count = 3000;
    const std::vector<double> positions = randomPositions(count, 9);
    const EveryValue expected(count);
    NewGridOptions options;
    options.id.clear(); // so that the order is all there is; points of one voxel each keep it
    writeNewVdb(path("x.vdb"), viewOfDoubles(positions), {}, options);
    PointFile::read(path("x.vdb")).writeVdb(path("y.vdb"), expected.values);
    writePointsNpz(path("y.npz"), viewOfDoubles(positions), expected.values);
    for (const char* name : {"y.vdb", "y.npz"}) {
        PointFileOptions reading;
        if (std::string(name) == "y.npz") reading.array = "positions";
        const PointFile file = PointFile::read(path(name), reading);
        const std::vector<StoredValue> list = file.listValues();
        ASSERT_EQ(list.size(), 9u) << name;
        for (const StoredValue& value : list) EXPECT_EQ(value.problem, "") << name << " " << value.name;
        const PointValues values = file.readValues(list);
        ASSERT_EQ(values.attributes.size(), 7u);
        ASSERT_EQ(values.groups.size(), 2u);
        for (std::size_t k = 0; k < 7; ++k) {
            const PointAttribute &is = values.attributes[k], &was = expected.values.attributes[k];
            EXPECT_EQ(is.name, was.name);
            ASSERT_EQ(is.type, was.type) << is.name;
            ASSERT_EQ(is.count, count);
            EXPECT_EQ(std::memcmp(is.values.get(), was.values.get(), count * attributeBytes(is.type)), 0)
                << is.name;
        }
        for (const PointGroup& group : values.groups) {
            ASSERT_EQ(group.count, count);
            const std::vector<std::uint8_t>& was = group.name == "third" ? expected.group : expected.none;
            for (std::size_t i = 0; i < count; ++i) ASSERT_EQ(group.members.get()[i] != 0, was[i] != 0);
        }
    }
}

TEST_F(WritePointsTest, kindsThatCannotBeReadSayWhy)
{
    const std::vector<openvdb::Vec3R> positions{{0, 0, 0}, {1, 2, 3}, {40, 5, 6}};
    const auto transform = openvdb::math::Transform::createLinearTransform(0.5);
    const PointDataGrid::Ptr grid =
        points::createPointDataGrid<points::NullCodec, PointDataGrid>(positions, *transform);
    grid->setName("points");
    points::PointDataTree& tree = grid->tree();
    points::appendAttribute<bool>(tree, "flag", true);
    points::appendAttribute<std::int16_t>(tree, "small", std::int16_t(-300));
    points::appendAttribute<openvdb::Vec3i>(tree, "cell");
    points::appendAttribute<openvdb::math::Quats>(tree, "orient");
    points::appendAttribute<float, points::TruncateCodec>(tree, "half", 0.5f);
    points::appendAttribute<std::string>(tree, "name");
    points::appendAttribute<float>(tree, "several", 0.0f, /*stride=*/4);
    openvdb::io::File(path("x.vdb")).write(openvdb::GridCPtrVec{grid});

    const PointFile file = PointFile::read(path("x.vdb"));
    std::map<std::string, StoredValue> list;
    for (const StoredValue& value : file.listValues()) list[value.name] = value;
    ASSERT_EQ(list.size(), 7u);
    EXPECT_EQ(list["flag"].readAs, AttributeType::kInt32);
    EXPECT_EQ(list["small"].readAs, AttributeType::kInt32);
    EXPECT_EQ(list["half"].readAs, AttributeType::kFloat);
    for (const char* name : {"cell", "orient", "name", "several"}) {
        EXPECT_FALSE(list[name].readAs) << name;
        EXPECT_NE(list[name].problem, "") << name;
        EXPECT_THROW(file.readValues({list[name]}), InvalidInput) << name;
    }
    const PointValues values = file.readValues({list["flag"], list["small"], list["half"]});
    for (int i = 0; i < 3; ++i) {
        EXPECT_EQ(static_cast<const std::int32_t*>(values.attributes[0].values.get())[i], 1);
        EXPECT_EQ(static_cast<const std::int32_t*>(values.attributes[1].values.get())[i], -300);
        EXPECT_EQ(static_cast<const float*>(values.attributes[2].values.get())[i], 0.5f);
    }
}

// ------------------------------------------------------------------------------------------------ .ply

// The header's lines and the bytes behind it.
std::pair<std::vector<std::string>, std::string> splitPly(const std::string& bytes)
{
    const std::string end = "end_header\n";
    const std::size_t at = bytes.find(end) + end.size();
    std::istringstream header(bytes.substr(0, at));
    std::vector<std::string> lines;
    for (std::string line; std::getline(header, line);) lines.push_back(line);
    return {lines, bytes.substr(at)};
}

TEST_F(WritePointsTest, plyHasTheRowsThatItsHeaderDeclares)
{
    const std::vector<double> positions{0.1, 0.25, -1, kNan, 2, 3};
    EveryValue expected(2);
    expected.values.attributes[4].name = "normal";
    const WrittenPoints written = writePly(path("x.ply"), viewOfDoubles(positions), expected.values);
    EXPECT_TRUE(written.isDouble);
    EXPECT_EQ(written.points, 2u);
    EXPECT_EQ(written.largestRounding, 0);
    const auto [lines, rowsOfFile] = splitPly(contents(path("x.ply")));
    const std::string& rows = rowsOfFile; // which a lambda may capture
    const std::vector<std::string> expectedLines{"ply",
                                                 "format binary_little_endian 1.0",
                                                 "element vertex 2",
                                                 "property double x",
                                                 "property double y",
                                                 "property double z",
                                                 "property float f",
                                                 "property double d",
                                                 "property int i",
                                                 "property double l",
                                                 "property float nx",
                                                 "property float ny",
                                                 "property float nz",
                                                 "property double w_x",
                                                 "property double w_y",
                                                 "property double w_z",
                                                 "property float m_xx",
                                                 "property float m_xy",
                                                 "property float m_xz",
                                                 "property float m_yx",
                                                 "property float m_yy",
                                                 "property float m_yz",
                                                 "property float m_zx",
                                                 "property float m_zy",
                                                 "property float m_zz",
                                                 "property uchar third",
                                                 "property uchar none",
                                                 "end_header"};
    EXPECT_EQ(lines, expectedLines);
    const std::size_t rowBytes = 24 + 4 + 8 + 4 + 8 + 12 + 24 + 36 + 2;
    ASSERT_EQ(rows.size(), 2 * rowBytes);
    for (std::size_t i = 0; i < 2; ++i) {
        const char* next = rows.data() + i * rowBytes;
        const auto expectNumber = [&](auto value) {
            EXPECT_EQ(std::memcmp(next, &value, sizeof value), 0) << i << " at " << next - rows.data();
            next += sizeof value;
        };
        for (std::size_t k = 0; k < 3; ++k) expectNumber(positions[3 * i + k]);
        expectNumber(expected.floats[i]);
        expectNumber(expected.doubles[i]);
        expectNumber(expected.ints[i]);
        expectNumber(static_cast<double>(expected.longs[i]));
        for (std::size_t k = 0; k < 3; ++k) expectNumber(expected.vectors[3 * i + k]);
        for (std::size_t k = 0; k < 3; ++k) expectNumber(expected.wideVectors[3 * i + k]);
        for (std::size_t k = 0; k < 9; ++k) expectNumber(expected.matrices[9 * i + k]);
        expectNumber(std::uint8_t(expected.group[i] != 0));
        expectNumber(std::uint8_t(0));
    }
}

TEST_F(WritePointsTest, plyOfFloatsHasFloats)
{
    const std::vector<double> positions{0.5, 0.25, -1, 1e30f, kNan, 3};
    EXPECT_FALSE(writePly(path("x.ply"), viewOfDoubles(positions), {}).isDouble);
    const auto [lines, rows] = splitPly(contents(path("x.ply")));
    EXPECT_EQ(lines[3], "property float x");
    EXPECT_EQ(rows.size(), 24u);
    EXPECT_FALSE(writePly(path("empty.ply"), viewOfDoubles({}), {}).isDouble);
    EXPECT_EQ(PointFile::read(path("empty.ply")).view().size(), 0u);
}

TEST_F(WritePointsTest, plyRefusesIntegersThatNoDoubleHolds)
{
    const std::vector<double> positions{1, 2, 3};
    std::int64_t value = (std::int64_t(1) << 53) + 1;
    PointValues values;
    values.attributes = {viewAttribute("big", AttributeType::kInt64, &value, 1)};
    EXPECT_THROW(writePly(path("x.ply"), viewOfDoubles(positions), values), InputError);
    EXPECT_EQ(fileCount(), 0u);
    --value;
    writePly(path("x.ply"), viewOfDoubles(positions), values);
    const PointFile file = PointFile::read(path("x.ply"));
    EXPECT_EQ(file.readScalars("big")[0], 0x1p53);
}

// ------------------------------------------------------------------------------------------------ conversion

TEST_F(WritePointsTest, aGridInWorldSpace)
{
    // A general transform: the world positions of the .npy are those of OpenVDB but for the rounding.
    const openvdb::math::Mat4d matrix(0.9, 0.2, -0.1, 0.0, -0.3, 1.1, 0.25, 0.0, 0.05, -0.4, -0.8, 0.0, 10.0,
                                      -20.0, 5.0, 1.0);
    const auto transform = openvdb::math::Transform::createLinearTransform(matrix);
    std::vector<openvdb::Vec3R> world;
    const std::vector<double> random = randomPositions(500, 30);
    for (std::size_t i = 0; i < 500; ++i)
        world.emplace_back(random[3 * i], random[3 * i + 1], random[3 * i + 2]);
    const PointDataGrid::Ptr grid =
        points::createPointDataGrid<points::NullCodec, PointDataGrid>(world, *transform);
    grid->setName("points");
    openvdb::io::File(path("x.vdb")).write(openvdb::GridCPtrVec{grid});
    const PointFile file = PointFile::read(path("x.vdb"));
    const Conversion done = convertPoints(file, path("x.npy"));
    EXPECT_TRUE(done.written.isDouble);
    EXPECT_GT(done.written.largestRounding, 0);
    EXPECT_LT(done.written.largestRounding, 1e-14);
    const PointFile array = PointFile::read(path("x.npy"));
    std::size_t n = 0;
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        const points::AttributeHandle<openvdb::Vec3f> p(leaf->constAttributeArray("P"));
        for (auto index = leaf->beginIndexAll(); index; ++index, ++n) {
            const openvdb::Vec3d expected =
                grid->indexToWorld(index.getCoord().asVec3d() + openvdb::Vec3d(p.get(*index)));
            const Vec3d is = array.view().worldPosition(n);
            for (int k = 0; k < 3; ++k) ASSERT_NEAR(is[static_cast<std::size_t>(k)], expected[k], 1e-13);
        }
    }
    EXPECT_EQ(n, array.view().size());

    EXPECT_THROW(convertPoints(file, path("y.txt")), InvalidInput);
    ConvertOptions options;
    options.voxelSize = 1;
    EXPECT_THROW(convertPoints(file, path("y.ply"), options), InvalidInput);
    EXPECT_EQ(fileCount(), 2u);
}

} // namespace
} // namespace vdb_nns
