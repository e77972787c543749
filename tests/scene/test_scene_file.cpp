// Scenes written to .vdb files and read back through the public readers.
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/scene.h"

#include "points/particle_source.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>

namespace vdb_nns {

namespace {

class SceneFile : public ::testing::Test {
protected:
    void SetUp() override
    {
        mPath = ::testing::TempDir() + "vdb_nns_scene_" +
                ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".vdb";
        std::filesystem::remove(mPath);
    }
    void TearDown() override { std::filesystem::remove(mPath); }

    PointFile roundTrip(const SceneOptions& options)
    {
        const Scene scene = makeScene(options);
        writeScene(mPath, scene, options, OutputOptions{true});
        return PointFile::read(mPath);
    }

    // The file less the UUID that OpenVDB draws: 36 characters at byte 21.
    std::string bytes() const
    {
        std::ifstream stream(mPath, std::ios::binary);
        std::string all{std::istreambuf_iterator<char>(stream), {}};
        return all.replace(21, 36, "");
    }

    std::string mPath;
};

SceneOptions optionsOf(const std::string& name, std::uint64_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    return options;
}

// Whether both hold the same points but for 1e-6 a coordinate, in any order.
bool samePoints(std::vector<Vec3d> a, std::vector<Vec3d> b)
{
    std::sort(a.begin(), a.end());
    std::sort(b.begin(), b.end());
    std::vector<bool> taken(b.size(), false);
    const auto near = [](double x, double y) { return std::fabs(x - y) < 1e-6; };
    std::size_t first = 0; // of b, by x
    for (const Vec3d& p : a) {
        while (first < b.size() && b[first][0] < p[0] - 1e-6) ++first;
        std::size_t k = first;
        while (k < b.size() && near(b[k][0], p[0]) &&
               (taken[k] || !near(b[k][1], p[1]) || !near(b[k][2], p[2])))
            ++k;
        if (k == b.size() || !near(b[k][0], p[0])) return false;
        taken[k] = true;
    }
    return a.size() == b.size();
}

TEST_F(SceneFile, KeepsThePointsAndSaysTheRadius)
{
    const SceneOptions options = optionsOf("dam_break", 5000);
    const PointFile file = roundTrip(options);
    const Scene scene = makeScene(options);
    EXPECT_EQ(file.info().grid, "points");
    EXPECT_EQ(file.info().points, 5000U);
    EXPECT_EQ(file.info().codec, "null");
    EXPECT_EQ(file.info().suggestedRadius, scene.suggestedRadius);
    ASSERT_TRUE(file.info().voxelSize);
    EXPECT_EQ((*file.info().voxelSize)[0], 0.2);
    std::vector<Vec3d> made, read;
    for (std::size_t i = 0; i < 5000; ++i) {
        made.push_back({scene.positions[3 * i], scene.positions[3 * i + 1], scene.positions[3 * i + 2]});
        read.push_back(file.view().worldPosition(i));
    }
    EXPECT_TRUE(samePoints(made, read));
    read[17][2] += 1e-3;
    EXPECT_FALSE(samePoints(made, read));
}

TEST_F(SceneFile, TheLatticeHasNoOffsets)
{
    const PointFile file = roundTrip(optionsOf("lattice", 8000));
    EXPECT_EQ(file.view().linear()[0][0], 0.1);
    for (std::size_t i = 0; i < 8000; ++i) {
        const StoredPosition stored = file.view().source().stored(i);
        for (int k = 0; k < 3; ++k) ASSERT_EQ(stored.offset[k], 0) << i;
    }
}

TEST_F(SceneFile, ThreadsDoNotMatter)
{
    const SceneOptions options = optionsOf("clusters", 100000);
    const Scene scene = makeScene(options);
    std::string first;
    for (const std::size_t threads : {1, 2, 5}) {
        const tbb::global_control control(tbb::global_control::max_allowed_parallelism, threads);
        writeScene(mPath, scene, options, OutputOptions{true});
        if (first.empty()) first = bytes();
        EXPECT_TRUE(first == bytes()) << threads;
    }
    EXPECT_GT(first.size(), 100000U);
}

TEST_F(SceneFile, EveryCodecIsOffered)
{
    for (const char* codec : {"null", "trnc", "fxpt16", "fxpt8"}) {
        SceneOptions options = optionsOf("block", 500);
        options.codec = codec;
        const PointFile file = roundTrip(options);
        EXPECT_EQ(file.info().codec, codec);
        EXPECT_EQ(file.info().points, 500U);
    }
    SceneOptions options = optionsOf("block", 500);
    options.codec = "zip";
    EXPECT_THROW(roundTrip(options), InvalidInput);
}

TEST_F(SceneFile, FarParticlesFitOrAreRefused)
{
    SceneOptions options = optionsOf("outlier", 100);
    options.distance = 1e9;
    const PointFile file = roundTrip(options);
    EXPECT_EQ(file.info().points, 100U);
    double farthest = 0;
    for (std::size_t i = 0; i < 100; ++i)
        farthest = std::max(farthest, std::fabs(file.view().worldPosition(i)[0]));
    EXPECT_NEAR(farthest / 0.2, 1e9 * 2 / 3, 1);
    options.voxelSize = 1e-3; // the distance is in voxels, the block is not
    EXPECT_NO_THROW(roundTrip(options));
    SceneOptions far = optionsOf("far", 100);
    far.voxelSize = 1e-12;
    far.spacing = 1;
    EXPECT_THROW(roundTrip(far), InvalidInput);
}

TEST_F(SceneFile, AnExistingFileStays)
{
    const SceneOptions options = optionsOf("block", 10);
    const Scene scene = makeScene(options);
    std::ofstream(mPath) << "mine";
    EXPECT_THROW(writeScene(mPath, scene, options), OutputExists);
    EXPECT_EQ(std::filesystem::file_size(mPath), 4U);
    writeScene(mPath, scene, options, OutputOptions{true});
    EXPECT_GT(std::filesystem::file_size(mPath), 4U);
}

} // namespace

} // namespace vdb_nns
