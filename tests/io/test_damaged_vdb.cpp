// Damaged .vdb files: whatever byte or bit is wrong, a file is refused with a reason, or read with all the points that it had. Each
// reading is a process of its own, so that a crash is an outcome that is counted, and names the file that led to it.
#include "io/byte_source.h"
#include "io/vdb/archive.h"
#include "io/vdb/grid_header.h"
#include "io/vdb/point_layout.h"
#include "io/vdb/tree_walk.h"
#include "io/vdb_file.h"
#include "support/memory_bytes.h"
#include "support/vdb_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <random>
#include <sstream>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;

const CancelCheck kNoCancel(nullptr, "test");

enum Outcome { kAsBefore, kRefused, kTooLarge, kOtherPoints, kCrashed };

// What a child tells beside its outcome.
struct Told {
    std::uint64_t points;
    char message[1000];
};

Told& told()
{
    static Told* const shared = static_cast<Told*>(
        ::mmap(nullptr, sizeof(Told), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0));
    return *shared;
}

// Does the work in a child, whose exit status is the result. This process itself never uses TBB: a child of one that
// does would wait for threads that it does not have.
int inChild(const std::function<int()>& work)
{
    told() = {};
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

// Any exception but ours ends the child as a crash does.
int outcomeOf(const std::function<std::uint64_t()>& countPoints, std::uint64_t expected)
{
    const auto refused = [](const Error& e, int outcome) {
        std::snprintf(told().message, sizeof told().message, "%s", e.what());
        return outcome;
    };
    try {
        told().points = countPoints();
        return told().points == expected ? kAsBefore : kOtherPoints;
    } catch (const CapacityError& e) {
        return refused(e, kTooLarge);
    } catch (const Error& e) {
        return refused(e, kRefused);
    }
}

std::string contents(const std::string& path)
{
    std::ifstream in(path, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
}

void create(const std::string& path, const std::string& bytes)
{
    std::ofstream(path, std::ios::binary) << bytes;
}

std::uint64_t countOf(const ByteSource& file)
{
    PointFileInfo info;
    return VdbFile(file, "points", {}, std::uint64_t(1) << 30, kNoCancel, info).view().size();
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

class DamagedVdb : public ::testing::Test {
protected:
    void SetUp() override
    {
        mFolder = fs::path(::testing::TempDir()) / ("vdb_nns_damaged_" + std::to_string(::getpid()));
        fs::create_directories(mFolder);
    }
    void TearDown() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    // Makes the file in a child, since OpenVDB uses TBB, and returns its bytes.
    std::string made(const std::function<std::string()>& make)
    {
        EXPECT_EQ(inChild([&] { return create(path("whole.vdb"), make()), 0; }), 0);
        std::string whole = contents(path("whole.vdb"));
        inChild([&] { return readFile(whole); });
        mPoints = told().points;
        EXPECT_GT(mPoints, 0u) << told().message;
        return whole;
    }

    int readFile(const std::string& bytes) const
    {
        create(path("damaged.vdb"), bytes);
        PointFileOptions options;
        options.grid = "points";
        options.hostMemoryBytes = std::uint64_t(1) << 30;
        return outcomeOf([&] { return PointFile::read(path("damaged.vdb"), options).info().points; },
                         mPoints);
    }

    // Reads a file that is so damaged, and counts the outcome.
    void read(const std::string& bytes, const std::string& what)
    {
        note(inChild([&] { return readFile(bytes); }), what);
    }

    void note(int outcome, const std::string& what)
    {
        ++mOutcomes[outcome];
        EXPECT_NE(outcome, kOtherPoints) << what << ": " << told().points << " points instead of " << mPoints;
        EXPECT_NE(outcome, kCrashed) << what;
        if (outcome != kRefused) return;
        const std::string message = told().message;
        if (std::getenv("VDB_NNS_DAMAGED_MESSAGES")) std::cout << message << "\n";
        EXPECT_NE(message.find("damaged.vdb: "), std::string::npos) << what << ": " << message;
        if (message.find(": damaged: ") != std::string::npos) {
            EXPECT_NE(message.find("byte"), std::string::npos) << what << ": " << message;
        }
    }

    fs::path mFolder;
    std::uint64_t mPoints = 0; // of the whole file
    std::map<int, unsigned> mOutcomes;
};

class DamagedKinds : public DamagedVdb, public ::testing::WithParamInterface<const char*> {};

TEST_P(DamagedKinds, areRefusedOrHaveTheirPoints)
{
    const char* const more = std::getenv("VDB_NNS_DAMAGED_FILES"); // of each kind
    const unsigned count = more ? static_cast<unsigned>(std::atoi(more)) : 60;
    const std::string whole = made([] { return makeVdbCase(GetParam()); });
    for (unsigned seed = 0; seed < count; ++seed) read(damaged(whole, seed), "seed " + std::to_string(seed));
    if (more) {
        std::cout << GetParam() << ": of " << count << " files " << mOutcomes[kRefused] << " are refused, "
                  << mOutcomes[kTooLarge] << " as too large, " << mOutcomes[kAsBefore]
                  << " are read with all points, " << mOutcomes[kOtherPoints] << " with others, and "
                  << mOutcomes[kCrashed] << " crash\n";
    }
    // A fifth at least: the longer attributes of some kinds are, the more of the bytes are values.
    EXPECT_GT(mOutcomes[kRefused], count / 5);
}

// Every prefix, and the whole with more behind it.
TEST_P(DamagedKinds, areRefusedWhereTheyAreCutOrLonger)
{
    const std::string whole = made([] { return makeVdbCase(GetParam()); });
    const auto refuseAll = [&] {
        for (std::size_t kept = 0; kept < whole.size(); ++kept) {
            const MemoryBytes cut(whole.data(), kept);
            told().points = kept;
            if (outcomeOf([&] { return countOf(cut); }, mPoints) != kRefused) return 1;
        }
        return 0;
    };
    EXPECT_EQ(inChild(refuseAll), 0) << "of " << whole.size() << " bytes " << told().points << " are kept";
    for (const std::size_t surplus : {1, 100, 5000}) {
        read(whole + std::string(surplus, '\0'), "surplus");
        EXPECT_NE(std::string(told().message).find("but " + std::to_string(surplus) + " bytes follow"),
                  std::string::npos)
            << told().message;
    }
    EXPECT_EQ(mOutcomes[kRefused], 3u);
}

INSTANTIATE_TEST_SUITE_P(Kinds, DamagedKinds,
                         ::testing::Values("p_vec3s_mask", "p_vec3s_fxpt16_zip_mask",
                                           "p_vec3s_fxpt8_blosc_mask", "attributes_blosc_mask", "instances",
                                           "instances_stream", "volume_float_half_zip", "unequal_blosc_mask",
                                           "texts_zip_mask"),
                         [](const auto& info) { return std::string(info.param); });

// Sizes of arrays that are not paged, which together are 0 in 64 bits.
TEST_F(DamagedVdb, isRefusedWhereItsSizesWrap)
{
    std::string bytes = made([] { return makeVdbCase("p_vec3s_mask"); });
    unsigned changed = 0;
    for (std::size_t at = 0; at + 14 <= bytes.size() && changed < 2; ++at) {
        std::uint64_t size;
        std::uint32_t points;
        std::memcpy(&size, &bytes[at], sizeof size);
        std::memcpy(&points, &bytes[at + 10], sizeof points);
        if (points == 0 || points > mPoints || size != 6 + 12 * std::uint64_t(points) || bytes[at + 9] != 0)
            continue;
        size = 0x8000000000000005u; // and one more byte, which says that it is not compressed
        std::memcpy(&bytes[at], &size, sizeof size);
        ++changed;
        at += 13;
    }
    ASSERT_EQ(changed, 2u);
    read(bytes, "sizes that wrap");
    EXPECT_EQ(mOutcomes[kRefused], 1u);
}

// In a larger file a bit of the topology moves, adds or takes away leaves, whose points are elsewhere.
TEST_F(DamagedVdb, isRefusedOrHasItsPointsWhereABitOfItsTopologyIsWrong)
{
    const std::string whole = made([] { return makeScatteredVdb(100000); });
    EXPECT_NEAR(double(mPoints), 100000, 10000);
    const MemoryBytes file(whole.data(), whole.size());
    const VdbEntry entry = readVdbDirectory(file).entries.at(0);
    VdbCursor cursor(file, entry.gridBegin, entry.gridEnd);
    const std::uint32_t compression = readGridHeader(cursor).compression;
    const std::uint64_t begin = cursor.position();
    readTopology(cursor, {4, 4, false}, compression);
    std::mt19937_64 random(1);
    for (int k = 0; k < 200; ++k) {
        std::string bytes = whole;
        const std::uint64_t at = begin + random() % (cursor.position() - begin), bit = random() % 8;
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << bit));
        const MemoryBytes damagedFile(bytes.data(), bytes.size(), "damaged.vdb");
        note(inChild([&] { return outcomeOf([&] { return countOf(damagedFile); }, mPoints); }),
             "bit " + std::to_string(bit) + " of byte " + std::to_string(at));
    }
}

TEST_F(DamagedVdb, isRefusedAtOnceWhereItClaimsBillionsOfPoints)
{
    const auto start = std::chrono::steady_clock::now();
    for (const auto& [leaves, points] : {std::pair(1u, 4000000000u), std::pair(3u, 3000000000u)}) {
        const std::uint32_t leafCount = leaves, pointCount = points;
        ASSERT_EQ(
            inChild([&] { return create(path("whole.vdb"), makeUniformVdb(leafCount, pointCount)), 0; }), 0);
        const std::string whole = contents(path("whole.vdb"));
        ASSERT_LT(whole.size(), 20000u);
        EXPECT_EQ(inChild([&] { return readFile(whole); }), kTooLarge) << told().message;
    }
    EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(10));
}

// A file that is cut at the n-th time that it is read from.
class ShrinkingFile final : public ByteSource {
public:
    ShrinkingFile(const std::string& path, int readsBefore) : mFile(path), mReadsLeft(readsBefore)
    {
        mName = mFile.name();
        mSize = mFile.size();
    }

    void readAt(std::uint64_t offset, void* out, std::size_t bytes) const override
    {
        if (mReadsLeft-- == 0) fs::resize_file(mName, offset + bytes / 2);
        mFile.readAt(offset, out, bytes);
    }

    bool isCut() const { return mReadsLeft < 0; }

private:
    InputFile mFile;
    mutable std::atomic<int> mReadsLeft;
};

TEST_F(DamagedVdb, isRefusedWhereItShrinksWhileItIsRead)
{
    const std::string whole = made([] { return makeVdbCase("attributes_blosc_mask"); });
    int reads = 0;
    for (bool isCut = true; isCut && !HasFailure(); ++reads) {
        create(path("damaged.vdb"), whole);
        const int outcome = inChild([&] {
            const ShrinkingFile file(path("damaged.vdb"), reads);
            const int result = outcomeOf([&] { return countOf(file); }, mPoints);
            told().points = file.isCut();
            return result;
        });
        isCut = told().points;
        EXPECT_EQ(outcome, isCut ? kRefused : kAsBefore) << reads << ": " << told().message;
        if (isCut) {
            EXPECT_NE(std::string(told().message).find("became shorter while it was read"),
                      std::string::npos);
        }
    }
    EXPECT_GT(reads, 4);
}

} // namespace

} // namespace vdb_nns::testing
