// Damaged .vdb files: whatever byte or bit is wrong, a file that is read has the points that it had. Each reading is a
// process of its own, as OpenVDB itself can crash on such files; that is allowed here, and the README says so.
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>

#include <gtest/gtest.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <random>
#include <sstream>

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;
using openvdb::points::PointDataGrid;

enum Outcome { kAsBefore, kRefused, kOtherPoints, kCrashed };

// Does the work in a child, whose exit status is the result. This process itself never uses TBB: a child of one that
// does would wait for threads that it does not have.
int inChild(const std::function<int()>& work)
{
    const pid_t child = ::fork();
    if (child == 0) {
        const rlimit noCore{0, 0}, memory{std::uint64_t(2) << 30, std::uint64_t(2) << 30};
        ::setrlimit(RLIMIT_CORE, &noCore);
        ::setrlimit(RLIMIT_AS, &memory);
        ::alarm(60);
        ::dup2(::open("/dev/null", O_WRONLY), 2); // what the C library says of a crash
        ::_exit(work());
    }
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : kCrashed;
}

template <typename Codec>
PointDataGrid::Ptr makeGrid(std::size_t count, const std::string& name)
{
    std::mt19937 random(7);
    std::uniform_real_distribution<float> place(-9, 9);
    std::vector<openvdb::Vec3R> positions(count);
    for (auto& p : positions) p = openvdb::Vec3R(place(random), place(random), place(random));
    const openvdb::points::PointAttributeVector<openvdb::Vec3R> wrapper(positions);
    const auto transform = openvdb::math::Transform::createLinearTransform(2);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(wrapper, *transform);
    const auto grid = openvdb::points::createPointDataGrid<Codec, PointDataGrid>(*index, wrapper, *transform);
    grid->setName(name);
    return grid;
}

void writeFile(const std::string& path, const openvdb::GridCPtrVec& grids, std::uint32_t compression)
{
    openvdb::io::File file(path);
    file.setCompression(compression);
    file.write(grids);
}

class DamagedVdb : public ::testing::TestWithParam<const char*> {
protected:
    void SetUp() override
    {
        mFolder = fs::path(::testing::TempDir()) / ("vdb_nns_damaged_" + std::to_string(::getpid()));
        fs::create_directories(mFolder);
    }
    void TearDown() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    // The file of that kind, made with 400 points in the grid `points`.
    static void make(const std::string& kind, const std::string& path)
    {
        openvdb::initialize();
        using namespace openvdb::points;
        const std::uint32_t plain = openvdb::io::COMPRESS_NONE, active = openvdb::io::COMPRESS_ACTIVE_MASK;
        const auto grid = makeGrid<NullCodec>(400, "points");
        const auto fixed = makeGrid<FixedPointCodec<false, PositionRange>>(400, "points");
        const auto volume = openvdb::FloatGrid::create(1);
        volume->fill(openvdb::CoordBBox(openvdb::Coord(0), openvdb::Coord(9)), 2.0f);
        if (kind == "plain") writeFile(path, {grid}, plain);
        if (kind == "zip") writeFile(path, {fixed}, openvdb::io::COMPRESS_ZIP | active);
        if (kind == "blosc") writeFile(path, {fixed}, openvdb::io::COMPRESS_BLOSC | active);
        if (kind == "grids") writeFile(path, {volume, grid, volume}, active);
        if (kind == "stream") {
            std::ofstream out(path, std::ios::binary);
            openvdb::io::Stream stream(out);
            stream.setCompression(active);
            stream.write(openvdb::GridCPtrVec{grid});
        }
    }

    static int read(const std::string& path)
    {
        try {
            return PointFile::read(path).info().points == 400 ? kAsBefore : kOtherPoints;
        } catch (const Error&) {
            return kRefused;
        }
    }

    fs::path mFolder;
};

std::string contents(const std::string& path)
{
    std::ifstream in(path, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
}

// One bit, one byte, or a few bytes are wrong; half of the places are among the first 3000 bytes, where the directory and
// the upper nodes of the tree are.
std::string damaged(std::string bytes, unsigned seed)
{
    std::mt19937 random(seed);
    const auto below = [&](std::size_t n) { return static_cast<std::size_t>(random()) % n; };
    const std::size_t range = seed % 2 ? bytes.size() : std::min<std::size_t>(bytes.size(), 3000);
    const std::size_t changes = seed % 3 == 2 ? 4 : 1;
    for (std::size_t k = 0; k < changes; ++k) {
        char& byte = bytes[below(range)];
        byte = seed % 3 == 0 ? static_cast<char>(byte ^ (1 << below(8))) : static_cast<char>(below(256));
    }
    return bytes;
}

TEST_P(DamagedVdb, isRefusedOrHasItsPoints)
{
    const char* const more = std::getenv("VDB_NNS_DAMAGED_FILES"); // of each kind
    const unsigned count = more ? static_cast<unsigned>(std::atoi(more)) : 60;
    ASSERT_EQ(inChild([&] { return make(GetParam(), path("whole.vdb")), 0; }), 0);
    ASSERT_EQ(inChild([&] { return read(path("whole.vdb")); }), kAsBefore);
    const std::string whole = contents(path("whole.vdb"));
    std::map<int, unsigned> outcomes;
    for (unsigned seed = 0; seed < count; ++seed) {
        std::ofstream(path("damaged.vdb"), std::ios::binary) << damaged(whole, seed);
        const int outcome = inChild([&] { return read(path("damaged.vdb")); });
        EXPECT_NE(outcome, kOtherPoints) << "seed " << seed;
        ++outcomes[outcome];
    }
    if (more) {
        std::cout << GetParam() << ": of " << count << " files " << outcomes[kRefused] << " are refused, "
                  << outcomes[kAsBefore] << " are read with all points, " << outcomes[kOtherPoints]
                  << " with others, and OpenVDB crashes on " << outcomes[kCrashed] << "\n";
    }
    EXPECT_GT(outcomes[kRefused], count / 4);
}

INSTANTIATE_TEST_SUITE_P(Kinds, DamagedVdb, ::testing::Values("plain", "zip", "blosc", "grids", "stream"),
                         [](const auto& info) { return std::string(info.param); });

} // namespace

} // namespace vdb_nns::testing
