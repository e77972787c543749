// Values of points as search writes them, read by number of the query: whole files, arrays of their own, grids made of arrays.
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/write_points.h"
#include "verify/result_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

namespace vdb_nns::testing {
namespace {

using cli::ResultFile;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

class ResultFiles : public ::testing::Test {
protected:
    void SetUp() override
    {
        mFolder = std::filesystem::temp_directory_path() /
                  (std::string("vdb_nns_results_") +
                   ::testing::UnitTest::GetInstance()->current_test_info()->name());
        std::filesystem::remove_all(mFolder);
        std::filesystem::create_directories(mFolder);
        for (int k = 0; k < 40; ++k) {
            for (int c = 0; c < 3; ++c) xyz.push_back(std::sin(7.0 * k + 2.0 * c));
        }
        xyz[3 * 5] = kNaN;
        for (int k = 0; k < 40; ++k) {
            counts.push_back(k);
            large.push_back(std::int64_t(k) << 33);
            densities.push_back(0.5f * static_cast<float>(k));
            isolated.push_back(k % 3 == 0);
            for (int c = 0; c < 3; ++c) {
                normals.push_back(static_cast<float>(100 * k + c));
                places.push_back(100.0 * k + c + 0.1);
            }
            for (int c = 0; c < 9; ++c) matrices.push_back(static_cast<float>(100 * k + c));
        }
        values.attributes = {viewAttribute("nns_count", AttributeType::kInt32, counts.data(), 40),
                             viewAttribute("nns_density", AttributeType::kFloat, densities.data(), 40),
                             viewAttribute("nns_normal", AttributeType::kVec3s, normals.data(), 40),
                             viewAttribute("nns_average:v", AttributeType::kVec3s, normals.data(), 40),
                             viewAttribute("nns_average:large", AttributeType::kInt64, large.data(), 40),
                             viewAttribute("pws", AttributeType::kVec3d, places.data(), 40),
                             viewAttribute("xform", AttributeType::kMat3s, matrices.data(), 40)};
        values.groups = {viewGroup("nns_isolated", {isolated.data(), isolated.size()})};
        for (const PointAttribute& attribute : values.attributes)
            names.attributes.push_back({attribute.name, attribute.type});
        names.groups = {"nns_isolated"};
    }
    void TearDown() override { std::filesystem::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }
    ParticleView view() const { return ParticleView::fromArray(xyz.data(), 40); }
    PointFile input() const
    {
        writePointsNpy(path("in.npy"), view(), {true});
        return PointFile::read(path("in.npy"));
    }

    // Those of point 7 are those that were written; of a point that is not there, zeros.
    void expectValues(const PointValues& read, std::size_t missing = 40) const
    {
        ASSERT_EQ(read.attributes.size(), values.attributes.size());
        for (std::size_t a = 0; a < read.attributes.size(); ++a) {
            const PointAttribute &one = read.attributes[a], &other = values.attributes[a];
            SCOPED_TRACE(other.name);
            EXPECT_EQ(one.name, other.name);
            ASSERT_EQ(one.type, other.type);
            ASSERT_EQ(one.count, 40u);
            const std::size_t bytes = attributeBytes(one.type);
            const auto* const mine = static_cast<const char*>(one.values.get());
            const auto* const theirs = static_cast<const char*>(other.values.get());
            for (std::size_t i = 0; i < 40; ++i) {
                const bool isSame = std::equal(mine + i * bytes, mine + (i + 1) * bytes, theirs + i * bytes);
                EXPECT_TRUE(isSame || i == missing) << i;
            }
        }
        ASSERT_EQ(read.groups.size(), 1u);
        for (std::size_t i = 0; i < 40; ++i) {
            if (i != missing) {
                EXPECT_EQ(read.groups[0].members.get()[i] != 0, isolated[i] != 0) << i;
            }
        }
    }

    std::filesystem::path mFolder;
    std::vector<double> xyz, places;
    std::vector<std::int32_t> counts;
    std::vector<std::int64_t> large;
    std::vector<float> densities, normals, matrices;
    std::vector<std::uint8_t> isolated;
    PointValues values;
    MeasuredNames names;
};

TEST_F(ResultFiles, ArraysOfAnNpz)
{
    writeArraysNpz(path("out.npz"), values);
    EXPECT_TRUE(ResultFile::holdsValues(path("out.npz")));
    const ResultFile result(path("out.npz"), "", nullptr);
    EXPECT_TRUE(result.placesOf(input(), nullptr).empty());
    expectValues(result.read(names, nullptr));
}

TEST_F(ResultFiles, PropertiesOfAPly)
{
    writePly(path("out.ply"), view(), values);
    EXPECT_TRUE(ResultFile::holdsValues(path("out.ply")));
    const ResultFile result(path("out.ply"), "", nullptr);
    EXPECT_TRUE(result.placesOf(input(), nullptr).empty());
    expectValues(result.read(names, nullptr));
    EXPECT_EQ(result.namesBehind("nns_average:", {}), (std::vector<std::string>{"v", "large"}));
    EXPECT_EQ(result.namesBehind("nns_average:", {"v_x", "v_y", "v_z"}),
              (std::vector<std::string>{"v_x", "v_y", "v_z", "large"}));
}

TEST_F(ResultFiles, AGridMadeOfAnArray)
{
    NewGridOptions options;
    options.voxelSize = 0.1;
    writeNewVdb(path("out.vdb"), view(), values, options);
    const ResultFile result(path("out.vdb"), "", nullptr);
    const std::vector<std::uint32_t> places = result.placesOf(input(), nullptr);
    ASSERT_EQ(places.size(), 40u);
    EXPECT_EQ(places[5], ~std::uint32_t(0)); // not finite
    expectValues(cli::placedValues(result.read(names, nullptr), places), 5);
    EXPECT_EQ(result.namesBehind("nns_average:", {}), (std::vector<std::string>{"v", "large"}));
    EXPECT_TRUE(result.hasAny({{{"nns_density", AttributeType::kFloat}}, {}, {}}));
    EXPECT_TRUE(result.hasAny({{}, {"nns_isolated"}, {}}));
    EXPECT_FALSE(result.hasAny({{{"nns_isolated", AttributeType::kInt32}}, {"nns_density"}, {}}));
}

TEST_F(ResultFiles, AttributesAddedToAGrid)
{
    writeNewVdb(path("in.vdb"), view(), {});
    const PointFile in = PointFile::read(path("in.vdb"));
    std::vector<std::int32_t> numbers(in.view().size());
    for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = static_cast<std::int32_t>(i);
    PointValues added;
    added.attributes = {viewAttribute("nns_count", AttributeType::kInt32, numbers.data(), numbers.size())};
    in.writeVdb(path("out.vdb"), added);
    const ResultFile result(path("out.vdb"), "points", nullptr);
    EXPECT_TRUE(result.placesOf(in, nullptr).empty()); // though it has an `id`
    const PointValues read = result.read(names, nullptr);
    ASSERT_EQ(read.attributes.size(), 1u); // what is there
    EXPECT_EQ(static_cast<const std::int32_t*>(read.attributes[0].values.get())[7], 7);
}

TEST_F(ResultFiles, OtherPointsAreRefused)
{
    const PointFile in = input();
    writePly(path("right.ply"), view(), values);
    NewGridOptions options;
    options.voxelSize = 0.1;
    writeNewVdb(path("right.vdb"), view(), {}, options);
    xyz[3 * 7 + 1] += 1e-4;
    writePly(path("moved.ply"), view(), values);
    writeNewVdb(path("moved.vdb"), view(), {}, options);
    options.id = "";
    writeNewVdb(path("nameless.vdb"), view(), {}, options);
    writePly(path("fewer.ply"), ParticleView::fromArray(xyz.data(), 39), {});
    for (const char* name : {"moved.ply", "moved.vdb", "nameless.vdb", "fewer.ply"}) {
        SCOPED_TRACE(name);
        EXPECT_THROW(ResultFile(path(name), "", nullptr).placesOf(in, nullptr), InputError);
    }
    const PointFile right = PointFile::read(path("right.vdb"));
    EXPECT_NO_THROW(ResultFile(path("right.vdb"), "", nullptr).placesOf(right, nullptr));
    EXPECT_THROW(ResultFile(path("moved.vdb"), "", nullptr).placesOf(right, nullptr), InputError);
    EXPECT_NO_THROW(ResultFile(path("right.ply"), "", nullptr).placesOf(in, nullptr));
}

TEST_F(ResultFiles, ListsAndDamageAreNoValues)
{
    PointValues lists;
    lists.attributes = {viewAttribute("indptr", AttributeType::kInt32, counts.data(), 40),
                        viewAttribute("data", AttributeType::kFloat, densities.data(), 40)};
    writeArraysNpz(path("lists.npz"), lists);
    EXPECT_FALSE(ResultFile::holdsValues(path("lists.npz")));
    std::ofstream(path("damaged.npz")) << "no ZIP at all";
    EXPECT_FALSE(ResultFile::holdsValues(path("damaged.npz")));
    EXPECT_FALSE(ResultFile::holdsValues(path("missing.npz")));
    EXPECT_FALSE(ResultFile::holdsValues(path("points.xyz")));
}

TEST_F(ResultFiles, AnArrayOfAnotherShape)
{
    PointValues odd;
    odd.attributes = {viewAttribute("nns_density", AttributeType::kVec3d, places.data(), 40)};
    writeArraysNpz(path("out.npz"), odd);
    const PointValues read = ResultFile(path("out.npz"), "", nullptr).read(names, nullptr);
    ASSERT_EQ(read.attributes.size(), 1u);
    EXPECT_EQ(read.attributes[0].type, AttributeType::kVec3d); // whoever compares refuses it
    writePly(path("out.ply"), view(), odd);
    EXPECT_TRUE(ResultFile(path("out.ply"), "", nullptr).read(names, nullptr).attributes.empty());
}

} // namespace
} // namespace vdb_nns::testing
