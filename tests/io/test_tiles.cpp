// Tiles: cuts that hold every particle once, parts that are merged into the bytes of one search, and parts of which a byte is wrong.
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search.h"
#include "vdb_nns/tiles.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numeric>
#include <random>

namespace vdb_nns::testing {
namespace {

namespace fs = std::filesystem;

class Tiles : public ::testing::Test {
protected:
    Tiles()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_tiles_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~Tiles() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    static std::string contents(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(stream), {}};
    }

    static void put(const std::string& file, const std::string& bytes)
    {
        std::ofstream(file, std::ios::binary) << bytes;
    }

    // A scene as a .vdb has it.
    ParticleView sceneView(const char* name, std::uint64_t count) const
    {
        SceneOptions options;
        options.name = name;
        options.count = count;
        writeScene(path("scene.vdb"), makeScene(options), options, {true, false});
        return PointFile::read(path("scene.vdb")).view();
    }

    // Writes a part of each tile; returns their names.
    std::vector<std::string> writeParts(const ParticleView& view, double radius, std::uint32_t tiles,
                                        const ListForm& form)
    {
        SearchEngine engine;
        const TileCut cut(view, radius, tiles);
        std::vector<std::string> parts;
        for (std::uint32_t t = 0; t < tiles; ++t) {
            const std::vector<std::uint32_t> rows = cut.particles(t);
            std::vector<std::uint8_t> chosen(view.size());
            for (const std::uint32_t row : rows) chosen[row] = 1;
            const ParticleSet queries{view, {chosen.data(), chosen.size()}};
            const NeighborLists lists = engine.search(view, queries, Radius(radius));
            parts.push_back(path("part" + std::to_string(t)));
            writeNpzPart(parts.back(), lists, rows, {t + 1, tiles, view.size(), 17, 4}, form, {true, false});
        }
        return parts;
    }

    fs::path mFolder;
};

std::vector<double> cloud(std::size_t count, unsigned seed)
{
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> coordinate(-1, 1);
    std::vector<double> xyz(3 * count);
    for (double& value : xyz) value = coordinate(random);
    return xyz;
}

TEST_F(Tiles, HoldEveryParticleOnce)
{
    std::vector<double> xyz = cloud(3000, 1);
    xyz[5] = NAN;
    xyz[100] = INFINITY;
    xyz[200] = -1e300;
    const ParticleView array = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const ParticleView grid = sceneView("spray", 3000);
    for (const ParticleView& view : {array, grid}) {
        for (const double radius : {1e-6, 0.01, 0.3, 100.0, 1e30, 0.0}) {
            for (const std::uint32_t tiles : {1u, 2u, 7u, 100u}) {
                const TileCut cut(view, radius, tiles);
                ASSERT_EQ(cut.tiles().size(), tiles);
                std::vector<int> seen(view.size());
                std::uint64_t leaf = 0;
                for (std::uint32_t t = 0; t < tiles; ++t) {
                    const Tile& tile = cut.tiles()[t];
                    EXPECT_EQ(tile.firstLeaf, leaf);
                    leaf = tile.endLeaf;
                    const std::vector<std::uint32_t> particles = cut.particles(t);
                    EXPECT_EQ(particles.size(), tile.particles);
                    EXPECT_TRUE(std::is_sorted(particles.begin(), particles.end()));
                    for (const std::uint32_t particle : particles) ++seen[particle];
                    EXPECT_LE(tile.haloParticles, view.size() - tile.particles);
                }
                EXPECT_EQ(std::count(seen.begin(), seen.end(), 1), static_cast<std::ptrdiff_t>(view.size()));
            }
        }
    }
    EXPECT_THROW(TileCut(array, 0.1, 0), InvalidInput);
    EXPECT_THROW(TileCut(array, -1, 2), InvalidInput);
    EXPECT_THROW(TileCut(array, NAN, 2), InvalidInput);
}

// Their shares of the work differ by no more than the work of a leaf.
TEST_F(Tiles, AreAboutEqual)
{
    const ParticleView view = sceneView("spray", 200000);
    const TileCut cut(view, 0.2, 10);
    const auto work = [](const Tile& tile) { return tile.particles + tile.expectedPairs; };
    std::uint64_t total = 0;
    for (const Tile& tile : cut.tiles()) total += work(tile);
    for (const Tile& tile : cut.tiles()) {
        EXPECT_NEAR(static_cast<double>(work(tile)), static_cast<double>(total) / 10,
                    0.02 * static_cast<double>(total));
    }
}

TEST_F(Tiles, AreMergedIntoTheBytesOfOneSearch)
{
    const std::vector<double> xyz = cloud(2000, 2);
    const ParticleView array = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const ParticleView grid = sceneView("clusters", 2000);
    for (const ParticleView& view : {array, grid}) {
        const double radius = 0.2;
        const NeighborLists whole = findNeighbors(view, radius);
        for (const ListForm& form : {ListForm(ListValues::kConnectivity), ListForm(ListValues::kDistance),
                                     ListForm(ListValues::kDistance, RowOrder::kDistance)}) {
            writeNpz(path("one"), whole, form, {true, false});
            for (const std::uint32_t tiles : {1u, 5u, 40u}) {
                std::vector<std::string> parts = writeParts(view, radius, tiles, form);
                std::reverse(parts.begin(), parts.end());
                const MergedParts merged = mergeNpzParts(parts, path("all"), {true, false});
                EXPECT_EQ(merged.rows, view.size());
                EXPECT_EQ(merged.pairs, whole.pairCount());
                EXPECT_EQ(contents(path("all")), contents(path("one")));
            }
        }
    }
}

// Whatever is wrong, nothing is written.
TEST_F(Tiles, RefuseEveryWrongByte)
{
    const std::vector<double> xyz = cloud(60, 3);
    const ParticleView view = ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const std::vector<std::string> parts = writeParts(view, 0.4, 2, ListForm(ListValues::kDistance));
    const std::string whole = contents(parts[1]);
    std::mt19937 random(4);
    const auto refused = [&](const std::string& bytes) {
        put(parts[1], bytes);
        EXPECT_THROW(mergeNpzParts(parts, path("all")), InputError);
        EXPECT_FALSE(fs::exists(path("all")));
    };
    for (std::size_t i = 0; i < whole.size(); ++i) {
        std::string bytes = whole;
        bytes[i] = static_cast<char>(bytes[i] ^ (1 << random() % 8));
        refused(bytes);
        if (i % 16 == 0) refused(whole.substr(0, i));
    }
    refused(whole + '\0');
    refused({});
    put(parts[1], whole);
    EXPECT_NO_THROW(mergeNpzParts(parts, path("all")));
    EXPECT_THROW(mergeNpzParts({}, path("none")), InvalidInput);
}

TEST_F(Tiles, HashesOfFilesDiffer)
{
    put(path("a"), "abc");
    put(path("b"), std::string("abc\0", 4));
    put(path("c"), "abd");
    put(path("d"), "abc");
    EXPECT_EQ(hashFile(path("a")), hashFile(path("d")));
    EXPECT_NE(hashFile(path("a")), hashFile(path("b")));
    EXPECT_NE(hashFile(path("a")), hashFile(path("c")));
    EXPECT_THROW(hashFile(path("e")), InputError);
}

} // namespace
} // namespace vdb_nns::testing
