// Output files: whole or not at all, and the bytes of the .npz lists, read back by a ZIP reader written here.
#include "agreement/point_views.h"
#include "io/npz_parts.h"
#include "io/npz_stream.h"
#include "io/npz_writer.h"
#include "io/output_file.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>
#include <zlib.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <numeric>
#include <ostream>

#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

namespace vdb_nns {
namespace {

namespace fs = std::filesystem;

constexpr OutputOptions kOverwrite{true};

// A folder of its own for each test, gone at the end.
class OutputTest : public ::testing::Test {
protected:
    OutputTest()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_output_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~OutputTest() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    static std::string contents(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(stream), {}};
    }

    static void create(const std::string& file, const std::string& text) { std::ofstream(file) << text; }

    std::size_t fileCount() const
    {
        return static_cast<std::size_t>(std::distance(fs::directory_iterator(mFolder), {}));
    }

    fs::path mFolder;
};

// ------------------------------------------------------------------------------------------------ files

TEST_F(OutputTest, appearsAtCommitWithTheUsualPermissions)
{
    {
        OutputFile file(path("a"), {});
        file.writeAt(3, "def", 3);
        file.writeAt(0, "abc", 3);
        EXPECT_FALSE(fs::exists(path("a")));
        EXPECT_EQ(fs::path(file.temporaryPath()).parent_path(), mFolder);
        file.commit();
    }
    EXPECT_EQ(contents(path("a")), "abcdef");
    EXPECT_EQ(fileCount(), 1u);
    const mode_t mask = ::umask(0);
    ::umask(mask);
    EXPECT_EQ(static_cast<unsigned>(fs::status(path("a")).permissions()), 0666u & ~mask);
}

TEST_F(OutputTest, isRemovedWithoutCommit)
{
    try {
        OutputFile file(path("a"), {});
        file.writeAt(0, "abc", 3);
        throw Cancelled("stop");
    } catch (const Cancelled&) {
    }
    EXPECT_EQ(fileCount(), 0u);
}

TEST_F(OutputTest, keepsTheOldFileUntilCommitAndItsPermissionsAfter)
{
    create(path("a"), "old");
    fs::permissions(path("a"), fs::perms(0640));
    EXPECT_THROW(OutputFile(path("a"), {}), OutputExists);
    {
        OutputFile file(path("a"), kOverwrite);
        file.writeAt(0, "new", 3);
        EXPECT_EQ(contents(path("a")), "old");
        file.commit();
    }
    EXPECT_EQ(contents(path("a")), "new");
    EXPECT_EQ(static_cast<unsigned>(fs::status(path("a")).permissions()), 0640u);
}

TEST_F(OutputTest, doesNotReplaceAFileThatCameIntoBeingMeanwhile)
{
    OutputFile file(path("a"), {});
    create(path("a"), "other");
    EXPECT_THROW(file.commit(), OutputExists);
    EXPECT_EQ(contents(path("a")), "other");
}

TEST_F(OutputTest, saysThatItsFolderHasVanished)
{
    fs::create_directory(path("folder"));
    OutputFile file(path("folder/a"), {});
    file.writeAt(0, "new", 3);
    fs::remove_all(path("folder"));
    file.writeAt(3, "er", 2); // the system keeps what is open
    try {
        file.commit();
        ADD_FAILURE() << "committed";
    } catch (const OutputError& error) {
        EXPECT_NE(std::string(error.what()).find("create the folder first"), std::string::npos)
            << error.what();
    }
    EXPECT_EQ(fileCount(), 0u);
}

TEST_F(OutputTest, refusesWhatIsNoRegularFile)
{
    fs::create_directory(path("folder"));
    ASSERT_EQ(::mkfifo(path("fifo").c_str(), 0600), 0);
    fs::create_symlink("/dev/null", path("device"));
    fs::create_symlink("nowhere", path("dangling"));
    for (const std::string& target :
         {path("folder"), path("fifo"), path("device"), path("dangling"), std::string("/dev/null")}) {
        EXPECT_THROW(checkOutput(target, true), OutputExists) << target;
        EXPECT_THROW(OutputFile(target, kOverwrite), OutputExists) << target;
    }
    EXPECT_EQ(fileCount(), 4u);
}

TEST_F(OutputTest, followsALinkToARegularFile)
{
    fs::create_directory(path("elsewhere"));
    create(path("elsewhere/target"), "old");
    fs::create_symlink("elsewhere/target", path("link"));
    EXPECT_THROW(checkOutput(path("link"), false), OutputExists);
    OutputFile file(path("link"), kOverwrite);
    file.writeAt(0, "new", 3);
    file.commit();
    EXPECT_TRUE(fs::is_symlink(path("link")));
    EXPECT_EQ(contents(path("elsewhere/target")), "new");
}

TEST_F(OutputTest, checksTheFolderEarly)
{
    EXPECT_NO_THROW(checkOutput(path("a"), false));
    EXPECT_THROW(checkOutput(path("missing/a"), false), OutputError);
    create(path("file"), "");
    EXPECT_THROW(checkOutput(path("file/a"), false), OutputError);
    EXPECT_THROW(checkOutput("", false), OutputError);
    EXPECT_EQ(fileCount(), 1u);
}

TEST_F(OutputTest, takesTheLongestNames)
{
    const std::string name(255, 'n');
    OutputFile file(path(name), {});
    file.commit();
    EXPECT_TRUE(fs::exists(path(name)));
}

TEST_F(OutputTest, removesWhatKilledProcessesLeftForItsTarget)
{
    // What the names of this host begin with.
    const std::string mark = [&] {
        const std::string name = fs::path(OutputFile(path("a"), {}).temporaryPath()).filename();
        return name.substr(0, name.find('-', name.find('-') + 1) + 1);
    }();
    ASSERT_EQ(mark.rfind("a.vdb_nns-", 0), 0u) << mark;
    const std::string ours = mark + "1f-0.tmp", alsoOurs = mark + "4-0.tmp";
    const std::vector<std::string> others = {
        mark + "1f-0.tmp2",     mark + "1f.tmp",      mark + "-0.tmp", mark + "1f-.tmp", mark + "1f-G.tmp",
        "a.vdb_nns-0-1f-0.tmp", // of another host
        "a.vdb_nns-1f-0.tmp",   "b" + ours.substr(1), "a.tmp",         "x" + ours};
    for (const std::string& name : others) create(path(name), "of somebody else");
    fs::create_directory(path(mark + "2-0.tmp"));
    fs::create_symlink(path("a.tmp"), path(mark + "3-0.tmp"));
    const std::size_t count = fileCount();
    create(path(ours), "half of it");
    create(path(alsoOurs), "half of it");
    fs::permissions(path(alsoOurs), fs::perms(0400));
    OutputFile(path("a"), {}).commit();
    EXPECT_EQ(fileCount(), count + 1); // and the target
    for (const std::string& name : others) EXPECT_TRUE(fs::exists(path(name))) << name;
    EXPECT_FALSE(fs::exists(path(ours)));
}

TEST_F(OutputTest, leavesAloneWhatIsBeingWritten)
{
    OutputFile first(path("a"), kOverwrite), second(path("a"), kOverwrite);
    first.writeAt(0, "1", 1);
    second.writeAt(0, "2", 1);
    first.commit();
    EXPECT_EQ(contents(path("a")), "1");
    second.commit();
    EXPECT_EQ(contents(path("a")), "2");
    EXPECT_EQ(fileCount(), 1u);
}

// Each removes what it takes for left over while others make theirs.
TEST_F(OutputTest, isWrittenByManyAtOnce)
{
    std::vector<pid_t> writers;
    for (char k = '0'; k < '8'; ++k) {
        const pid_t writer = ::fork();
        ASSERT_GE(writer, 0);
        if (writer > 0) {
            writers.push_back(writer);
            continue;
        }
        try {
            for (int round = 0; round < 100; ++round) {
                OutputFile file(path("a"), kOverwrite);
                file.writeAt(0, &k, 1);
                file.commit();
            }
        } catch (const std::exception& error) {
            std::fprintf(stderr, "writer %c: %s\n", k, error.what());
            ::_exit(1);
        }
        ::_exit(0);
    }
    for (const pid_t writer : writers) {
        int status = 0;
        ASSERT_EQ(::waitpid(writer, &status, 0), writer);
        EXPECT_EQ(status, 0);
    }
    EXPECT_EQ(contents(path("a")).size(), 1u);
    EXPECT_EQ(fileCount(), 1u);
}

TEST_F(OutputTest, isRemovedForASignalHandler)
{
    create(path("a"), "old");
    OutputFile file(path("a"), kOverwrite);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        removeTemporaryFiles(); // the file is its parent's
        ::_exit(0);
    }
    ASSERT_EQ(::waitpid(child, nullptr, 0), child);
    EXPECT_TRUE(fs::exists(file.temporaryPath()));
    removeTemporaryFiles();
    EXPECT_FALSE(fs::exists(file.temporaryPath()));
    EXPECT_THROW(file.commit(), OutputError);
    EXPECT_EQ(contents(path("a")), "old");
    OutputFile(path("b"), {}).commit();
    EXPECT_EQ(fileCount(), 2u);
}

TEST_F(OutputTest, isWrittenBesideMoreThanAreNotedForSignalHandlers)
{
    std::vector<std::unique_ptr<OutputFile>> files;
    for (int k = 0; k < 70; ++k)
        files.push_back(std::make_unique<OutputFile>(path(std::to_string(k)), OutputOptions{}));
    for (const std::unique_ptr<OutputFile>& file : files) file->commit();
    files.clear();
    EXPECT_EQ(fileCount(), 70u);
}

TEST_F(OutputTest, writesAndFlushesWholeFiles)
{
    writeFile(path("a"), "abc", 3);
    EXPECT_THROW(writeFile(path("a"), "def", 3), OutputExists);
    OutputOptions options;
    options.overwrite = options.sync = true;
    writeFile(path("a"), "", 0, options);
    EXPECT_EQ(contents(path("a")), "");
    writeFile(path("a"), "defg", 4, options);
    EXPECT_EQ(contents(path("a")), "defg");
    EXPECT_EQ(fileCount(), 1u);
}

// Lowers the limit on the size of a file, as `ulimit -f` does, and restores it.
class FileSizeLimit {
public:
    explicit FileSizeLimit(rlim_t bytes)
    {
        ::getrlimit(RLIMIT_FSIZE, &mOld);
        mHandler = std::signal(SIGXFSZ, SIG_IGN);
        const rlimit lower{bytes, mOld.rlim_max};
        ::setrlimit(RLIMIT_FSIZE, &lower);
    }
    ~FileSizeLimit()
    {
        ::setrlimit(RLIMIT_FSIZE, &mOld);
        std::signal(SIGXFSZ, mHandler);
    }

private:
    rlimit mOld{};
    void (*mHandler)(int);
};

TEST_F(OutputTest, reportsTheSizeLimitAndLeavesNothing)
{
    const FileSizeLimit limit(1000);
    try {
        OutputFile file(path("a"), {});
        file.writeAt(0, std::string(2000, 'x').data(), 2000);
        ADD_FAILURE() << "no error";
    } catch (const OutputError& error) {
        EXPECT_NE(std::string(error.what()).find(path("a")), std::string::npos);
        EXPECT_NE(std::string(error.what()).find(std::strerror(EFBIG)), std::string::npos) << error.what();
    }
    EXPECT_EQ(fileCount(), 0u);
}

TEST_F(OutputTest, givesBackWhatWasReservedAndNotWritten)
{
    OutputFile file(path("a"), {});
    const auto allocated = [&](const std::string& name) {
        struct stat status {};
        EXPECT_EQ(::stat(name.c_str(), &status), 0);
        return status.st_blocks * 512;
    };
    file.reserve(0, std::uint64_t(7) << 60); // no disk has that
    EXPECT_EQ(allocated(file.temporaryPath()), 0);
    file.reserve(0, 4 << 20);
    file.writeAt(0, "abc", 3);
    file.reserve(4 << 20, std::uint64_t(7) << 60);
    file.commit();
    EXPECT_EQ(contents(path("a")), "abc");
    EXPECT_LE(allocated(path("a")), 1 << 20);
}

TEST_F(OutputTest, asksForRoomBeforeItIsTaken)
{
    OutputFile file(path("a"), {});
    EXPECT_NO_THROW(file.requireRoom(1));
    const std::uint64_t exbibytes = std::uint64_t(7) << 60;
    try {
        file.requireRoom(exbibytes);
        ADD_FAILURE() << "no error";
    } catch (const OutputError& error) {
        const std::string text = error.what();
        for (const std::string& word : {path("a"), std::to_string(exbibytes), std::string("bytes free")})
            EXPECT_NE(text.find(word), std::string::npos) << text;
    }
}

TEST_F(OutputTest, streamSeeksAndThrowsTheFilesErrors)
{
    {
        OutputFile file(path("a"), {});
        std::uint64_t told = 0;
        OutputStreamBuffer buffer(file, [&](std::uint64_t bytes) { told = bytes; });
        std::ostream stream(&buffer);
        stream.exceptions(std::ios::badbit | std::ios::failbit);
        const std::string large(std::size_t(9) << 20, 'z');
        stream << "0123" << large;
        EXPECT_EQ(static_cast<std::size_t>(stream.tellp()), 4 + large.size());
        stream.seekp(1);
        stream << "ab";
        stream.seekp(0, std::ios::end);
        stream << "!";
        stream.flush();
        file.commit();
        EXPECT_EQ(told, 5 + large.size());
        EXPECT_EQ(contents(path("a")), "0ab3" + large + "!");
    }
    const FileSizeLimit limit(1000);
    OutputFile file(path("b"), {});
    OutputStreamBuffer buffer(file, [](std::uint64_t) {});
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit | std::ios::failbit);
    stream << std::string(2000, 'x');
    EXPECT_THROW(stream.flush(), OutputError);
}

// ------------------------------------------------------------------------------------------------ .npz

// The parts of a ZIP that np.load uses, with every size and place checked against the file.
struct ZipMember {
    std::string name;
    std::uint64_t start = 0, bytes = 0; // of the member's contents
    std::uint32_t crc = 0;
};

class ZipReader {
public:
    explicit ZipReader(const std::string& file) : mStream(file, std::ios::binary), mBytes(fs::file_size(file))
    {
        const std::uint64_t end = mBytes - 22; // our files have no comment
        EXPECT_EQ(number(end, 4), 0x06054b50u);
        std::uint64_t count = number(end + 10, 2), bytes = number(end + 12, 4), place = number(end + 16, 4);
        std::uint64_t directoryEnd = end;
        if (place == 0xFFFFFFFFu) {
            EXPECT_EQ(number(end - 20, 4), 0x07064b50u);
            directoryEnd = number(end - 20 + 8, 8);
            EXPECT_EQ(number(directoryEnd, 4), 0x06064b50u);
            EXPECT_EQ(directoryEnd + 12 + number(directoryEnd + 4, 8), end - 20);
            count = number(directoryEnd + 32, 8);
            bytes = number(directoryEnd + 40, 8);
            place = number(directoryEnd + 48, 8);
        }
        EXPECT_EQ(place + bytes, directoryEnd);
        for (; count > 0; --count) readEntry(place);
        EXPECT_EQ(place, directoryEnd);
    }

    const std::vector<ZipMember>& members() const { return mMembers; }

    std::string bytes(std::uint64_t place, std::size_t count)
    {
        std::string out(count, '\0');
        mStream.seekg(static_cast<std::streamoff>(place));
        mStream.read(out.data(), static_cast<std::streamsize>(count));
        EXPECT_TRUE(mStream.good());
        return out;
    }

private:
    std::uint64_t number(std::uint64_t place, int count)
    {
        const std::string raw = bytes(place, static_cast<std::size_t>(count));
        std::uint64_t value = 0;
        for (int i = count; i-- > 0;)
            value = value << 8 | static_cast<unsigned char>(raw[static_cast<std::size_t>(i)]);
        return value;
    }

    // Finds the ZIP64 values of an extra field; returns the place of the first one.
    std::uint64_t zip64(std::uint64_t place, std::uint64_t count)
    {
        const std::uint64_t end = place + count;
        std::uint64_t found = 0;
        while (place < end) {
            if (number(place, 2) == 1) found = place + 4;
            place += 4 + number(place + 2, 2);
        }
        EXPECT_EQ(place, end);
        EXPECT_NE(found, 0u);
        return found;
    }

    void readEntry(std::uint64_t& place)
    {
        EXPECT_EQ(number(place, 4), 0x02014b50u);
        EXPECT_EQ(number(place + 10, 2), 0u);        // stored
        EXPECT_EQ(number(place + 12, 4), 0x210000u); // 1980-01-01 00:00:00
        const std::uint64_t nameBytes = number(place + 28, 2), extraBytes = number(place + 30, 2);
        ZipMember member;
        member.crc = static_cast<std::uint32_t>(number(place + 16, 4));
        member.bytes = number(place + 24, 4);
        member.name = bytes(place + 46, nameBytes);
        std::uint64_t local = number(place + 42, 4);
        std::uint64_t large = place + 46 + nameBytes;
        if (member.bytes == 0xFFFFFFFFu || local == 0xFFFFFFFFu) {
            large = zip64(large, extraBytes);
            if (member.bytes == 0xFFFFFFFFu) {
                member.bytes = number(large, 8);
                EXPECT_EQ(member.bytes, number(large + 8, 8));
                large += 16;
            }
            if (local == 0xFFFFFFFFu) local = number(large, 8);
        }
        place += 46 + nameBytes + extraBytes;

        EXPECT_EQ(number(local, 4), 0x04034b50u);
        EXPECT_EQ(number(local + 14, 4), member.crc);
        EXPECT_EQ(bytes(local + 30, nameBytes), member.name);
        const std::uint64_t localExtra = number(local + 28, 2);
        std::uint64_t localBytes = number(local + 22, 4);
        if (localBytes == 0xFFFFFFFFu) localBytes = number(zip64(local + 30 + nameBytes, localExtra), 8);
        EXPECT_EQ(localBytes, member.bytes);
        member.start = local + 30 + nameBytes + localExtra;
        EXPECT_EQ(member.start % 64, 0u);
        mMembers.push_back(member);
    }

    std::ifstream mStream;
    std::uint64_t mBytes;
    std::vector<ZipMember> mMembers;
};

// Rows from a function of the row: count, and numbers in an order that needs sorting.
class TestRows final : public NpzRows {
public:
    TestRows(std::size_t size, std::uint32_t countModulus, std::size_t countStep = 7)
        : mSize(size), mModulus(countModulus), mStep(countStep)
    {
    }

    std::size_t size() const override { return mSize; }
    std::uint64_t pairCount() const override
    {
        std::uint64_t sum = 0;
        for (std::size_t i = 0; i < mSize; ++i) sum += count(i);
        return sum;
    }
    std::uint32_t count(std::size_t row) const override
    {
        return static_cast<std::uint32_t>(row * mStep % mModulus);
    }
    void copyRow(std::size_t row, std::uint32_t* out) const override
    {
        // An odd multiplier permutes the numbers.
        for (std::uint32_t k = 0; k < count(row); ++k)
            out[k] = (k * 77u + static_cast<std::uint32_t>(row)) % 65536u;
    }
    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return static_cast<double>(row) + 0.1 * static_cast<double>(neighbor);
    }

    std::vector<std::uint32_t> sortedRow(std::size_t row) const
    {
        std::vector<std::uint32_t> numbers(count(row));
        copyRow(row, numbers.data());
        std::sort(numbers.begin(), numbers.end());
        return numbers;
    }

private:
    std::size_t mSize;
    std::uint32_t mModulus;
    std::size_t mStep;
};

template <typename T>
std::vector<T> valuesOf(ZipReader& zip, const ZipMember& member, const std::string& header)
{
    const std::string all = zip.bytes(member.start, member.bytes);
    EXPECT_EQ(::crc32_z(0, reinterpret_cast<const Bytef*>(all.data()), all.size()), member.crc)
        << member.name;
    EXPECT_EQ(all.substr(0, 8), std::string("\x93NUMPY\x01\x00", 8));
    const std::size_t headerBytes =
        10 + static_cast<unsigned char>(all[8]) + 256u * static_cast<unsigned char>(all[9]);
    EXPECT_EQ(headerBytes % 64, 0u);
    EXPECT_NE(all.substr(0, headerBytes).find(header), std::string::npos) << all.substr(10, headerBytes - 10);
    EXPECT_EQ(all[headerBytes - 1], '\n');
    std::vector<T> values((all.size() - headerBytes) / sizeof(T));
    if (!values.empty()) std::memcpy(values.data(), all.data() + headerBytes, values.size() * sizeof(T));
    return values;
}

void checkNpz(const std::string& file, const TestRows& rows, ListValues values)
{
    ZipReader zip(file);
    ASSERT_EQ(zip.members().size(), 5u);
    const char* const names[] = {"indptr.npy", "indices.npy", "data.npy", "shape.npy", "format.npy"};
    for (int i = 0; i < 5; ++i) EXPECT_EQ(zip.members()[static_cast<std::size_t>(i)].name, names[i]);
    const std::string pairs = "(" + std::to_string(rows.pairCount()) + ",)";
    const auto indptr = valuesOf<std::int64_t>(zip, zip.members()[0],
                                               "{'descr': '<i8', 'fortran_order': False, 'shape': (" +
                                                   std::to_string(rows.size() + 1) + ",), }");
    const auto indices = valuesOf<std::int32_t>(zip, zip.members()[1],
                                                "'descr': '<i4', 'fortran_order': False, 'shape': " + pairs);
    ASSERT_EQ(indptr.size(), rows.size() + 1);
    ASSERT_EQ(indices.size(), rows.pairCount());
    std::vector<float> distances;
    if (values == ListValues::kDistance) {
        distances = valuesOf<float>(zip, zip.members()[2], "'descr': '<f4'");
        ASSERT_EQ(distances.size(), indices.size());
    } else {
        EXPECT_EQ(valuesOf<std::int8_t>(zip, zip.members()[2], "'descr': '|i1'"),
                  std::vector<std::int8_t>(indices.size(), 1));
    }
    const std::int64_t n = static_cast<std::int64_t>(rows.size());
    EXPECT_EQ(valuesOf<std::int64_t>(zip, zip.members()[3], "'<i8'"), (std::vector<std::int64_t>{n, n}));
    EXPECT_EQ(valuesOf<char>(zip, zip.members()[4], "'descr': '|S3', 'fortran_order': False, 'shape': ()"),
              (std::vector<char>{'c', 's', 'r'}));
    for (std::size_t row = 0; row < rows.size(); ++row) {
        const std::vector<std::uint32_t> expected = rows.sortedRow(row);
        const std::size_t first = static_cast<std::size_t>(indptr[row]);
        ASSERT_EQ(indptr[row + 1] - indptr[row], static_cast<std::int64_t>(expected.size())) << row;
        for (std::size_t k = 0; k < expected.size(); ++k) {
            ASSERT_EQ(static_cast<std::uint32_t>(indices[first + k]), expected[k]) << row;
            if (!distances.empty()) {
                ASSERT_EQ(distances[first + k], static_cast<float>(rows.distance(row, expected[k]))) << row;
            }
        }
    }
}

TEST_F(OutputTest, npzHoldsTheSortedRows)
{
    // None, one without and with pairs, rows of all lengths around the sort's limits, and several blocks.
    for (const auto& [size, modulus] :
         {std::pair<std::size_t, std::uint32_t>{0, 1}, {1, 1}, {2, 8}, {3000, 100}, {200000, 61}}) {
        const TestRows rows(size, modulus);
        for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
            writeNpzRows(path("a.npz"), rows, values, kOverwrite, nullptr);
            checkNpz(path("a.npz"), rows, values);
        }
    }
    EXPECT_EQ(fileCount(), 1u);
}

TEST_F(OutputTest, npzHasTheSameBytesEveryTime)
{
    const TestRows rows(50000, 61);
    writeNpzRows(path("a.npz"), rows, ListValues::kDistance, {}, nullptr);
    writeNpzRows(path("b.npz"), rows, ListValues::kDistance, {}, nullptr);
    EXPECT_EQ(contents(path("a.npz")), contents(path("b.npz")));
}

TEST_F(OutputTest, npzStopsWhenAskedAndLeavesNothing)
{
    class StopLater final : public Progress {
    public:
        void update(const char* step, double fraction) override
        {
            EXPECT_STREQ(step, "write");
            EXPECT_GE(fraction, mLast);
            mLast = fraction;
        }
        bool cancelled() const override { return mLast > 0.2; }

    private:
        double mLast = 0;
    } progress;
    EXPECT_THROW(writeNpzRows(path("a.npz"), TestRows(400000, 61), ListValues::kConnectivity, {}, &progress),
                 Cancelled);
    EXPECT_EQ(fileCount(), 0u);
}

TEST_F(OutputTest, npzWithoutRoomIsAnErrorAndLeavesNothing)
{
    const FileSizeLimit limit(100000);
    EXPECT_THROW(writeNpzRows(path("a.npz"), TestRows(50000, 61), ListValues::kConnectivity, {}, nullptr),
                 OutputError);
    EXPECT_EQ(fileCount(), 0u);
}

// Members and places past 4 GiB, in a file whose arrays are holes: its headers alone are written.
TEST_F(OutputTest, npzPast4GiBUsesZip64)
{
    struct Case {
        std::uint64_t rows, pairs;
        ListValues values;
    };
    // indices just below and at 4 GiB less one with its header; data past 4 GiB; 64-bit indices.
    const std::uint64_t kLimitPairs = (0xFFFFFFFFu - 128) / 4;
    for (const Case& c :
         {Case{10, kLimitPairs, ListValues::kConnectivity},
          Case{10, kLimitPairs + 1, ListValues::kConnectivity},
          Case{1u << 20, std::uint64_t(3) << 30, ListValues::kDistance},
          Case{(std::uint64_t(1) << 31) + 5, std::uint64_t(5) << 30, ListValues::kConnectivity}}) {
        NpzLayout layout = layoutNpz({c.rows, c.rows}, c.pairs, c.values);
        EXPECT_EQ(layout.indexBytes, c.rows > 0x7FFFFFFF ? 8u : 4u);
        OutputFile file(path("sparse.npz"), kOverwrite);
        for (std::size_t i = 0; i < layout.count; ++i) {
            NpzMember& member = layout.members[i];
            member.crc = 0x12345678;
            const std::string header = localHeader(member);
            EXPECT_EQ(member.localOffset + header.size(), member.valueOffset);
            file.writeAt(member.localOffset, header.data(), header.size());
        }
        const std::string directory = centralDirectory(layout);
        file.writeAt(layout.directoryOffset, directory.data(), directory.size());
        file.commit();

        ZipReader zip(path("sparse.npz"));
        ASSERT_EQ(zip.members().size(), 5u);
        const std::uint64_t indexBytes = layout.indexBytes;
        EXPECT_EQ(zip.members()[0].bytes, 128 + 8 * (c.rows + 1));
        EXPECT_EQ(zip.members()[1].bytes, 128 + indexBytes * c.pairs);
        EXPECT_EQ(zip.members()[2].bytes, 128 + (c.values == ListValues::kDistance ? 4 : 1) * c.pairs);
        for (const ZipMember& member : zip.members()) {
            EXPECT_EQ(member.crc, 0x12345678u);
            EXPECT_EQ(zip.bytes(member.start, 6), "\x93NUMPY");
        }
    }
}

// ------------------------------------------------------------------------------- .npz without lists in memory

TEST(NpzParts, ACrcIsTheXorOfItsPiecesInAnyOrder)
{
    std::string bytes(1000, '\0');
    for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * i + 3);
    const std::size_t cuts[] = {0, 1, 64, 65, 700, 1000};
    std::uint32_t joined = 0;
    for (const int piece : {3, 0, 4, 2, 1}) {
        const std::size_t begin = cuts[piece], end = cuts[piece + 1];
        joined ^= crcShare(crcOf(0, bytes.data() + begin, end - begin), bytes.size() - end);
    }
    EXPECT_EQ(joined, crcOf(0, bytes.data(), bytes.size()));
}

// The rows of a TestRows from several threads, in an order that joins some of them and not others.
class TestRowSource final : public NpzRowSource {
public:
    explicit TestRowSource(const TestRows& rows) : mRows(rows) {}

    std::uint64_t columnCount() const override { return mRows.size(); }
    std::vector<std::uint32_t> counts() const override
    {
        std::vector<std::uint32_t> counts(mRows.size());
        for (std::size_t i = 0; i < counts.size(); ++i) counts[i] = mRows.count(i);
        return counts;
    }
    std::uint64_t pairCount() const override { return mRows.pairCount(); }
    void visitRows(const NeighborLists::RowVisitor& visit, Progress* progress) const override
    {
        constexpr std::size_t kGroup = 5;
        const std::size_t groups = (mRows.size() + kGroup - 1) / kGroup;
        tbb::parallel_for(std::size_t(0), groups, [&](std::size_t g) {
            if (progress && progress->cancelled()) throw Cancelled("stop");
            const std::size_t group = g % 2 ? groups - 1 - (groups % 2 ? g : g - 1) : g;
            for (std::size_t row = group * kGroup; row < std::min(mRows.size(), (group + 1) * kGroup);
                 ++row) {
                if (row == mLost) continue;
                std::vector<std::uint32_t> numbers(mRows.count(row));
                mRows.copyRow(row, numbers.data());
                if (row == mCut) numbers.pop_back();
                visit(static_cast<std::uint32_t>(row), {numbers.data(), numbers.size()});
            }
            if (progress) progress->update("rows", static_cast<double>(g) / static_cast<double>(groups));
        });
    }
    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return mRows.distance(row, neighbor);
    }

    void lose(std::size_t row) { mLost = row; }
    void cut(std::size_t row) { mCut = row; }

private:
    const TestRows& mRows;
    std::size_t mLost = ~std::size_t(0), mCut = ~std::size_t(0);
};

TEST_F(OutputTest, npzWithoutListsHasTheSameBytes)
{
    // The last ones have rows that are longer than any buffer here, and than what is written at once.
    for (const TestRows& rows : {TestRows(0, 1), TestRows(1, 1), TestRows(2, 8), TestRows(3000, 100),
                                 TestRows(200000, 61), TestRows(12, 140001, 30011)}) {
        for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
            writeNpzRows(path("lists.npz"), rows, values, kOverwrite, nullptr);
            const std::string expected = contents(path("lists.npz"));
            for (const std::size_t threadBytes : {0u, 100u, 4000u, 1u << 20, 64u << 20}) {
                if (rows.size() > 10000 && threadBytes < 1u << 20) continue; // a write a row takes its time
                streamNpzRows(path("direct.npz"), TestRowSource(rows), values, kOverwrite, threadBytes,
                              nullptr);
                EXPECT_TRUE(contents(path("direct.npz")) == expected)
                    << rows.size() << " rows, buffers of " << threadBytes;
            }
        }
    }
    EXPECT_EQ(fileCount(), 2u);
}

TEST_F(OutputTest, npzOfASearchWithoutListsHasTheSameBytes)
{
    using namespace testing;
    for (const PointSet& set : arraySets(Precision::kFloat)) {
        const SetView input(set, Form::kFloats);
        SearchEngine engine;
        const NeighborLists lists = engine.findNeighbors(input.view(), set.radius);
        SearchOptions counting;
        counting.encoding = Encoding::kNone;
        const NeighborLists counts = engine.search(lists.grid(), counting);
        for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
            writeNpz(path("lists.npz"), lists, values, kOverwrite);
            for (const int threads : {1, 3}) {
                for (const std::uint64_t bufferBytes : {0u, 600u, 100000u}) {
                    tbb::task_arena arena(threads);
                    arena.execute([&] {
                        streamNpz(path("direct.npz"), engine, counts, values, kOverwrite, bufferBytes);
                    });
                    EXPECT_TRUE(contents(path("direct.npz")) == contents(path("lists.npz")))
                        << set.name << ", " << threads << " threads, buffers of " << bufferBytes;
                }
            }
        }
    }
}

// Rows are made with the radius that the neighbors were counted with, whatever the options say.
TEST_F(OutputTest, npzOfASearchWithASmallerRadiusHasTheSameBytes)
{
    using namespace testing;
    const PointSet set = roundedToFloats(arraySets(Precision::kFloat).at(5));
    const SetView input(set, Form::kFloats);
    SearchEngine engine;
    const NeighborLists lists = engine.findNeighbors(input.view(), set.radius);
    SearchOptions counting;
    counting.encoding = Encoding::kNone;
    counting.radius = set.radius;
    const NeighborLists counts = engine.search(engine.buildGrid(input.view(), 2 * set.radius), counting);
    EXPECT_GT(counts.pairCount(), 0u);
    writeNpz(path("lists.npz"), lists, ListValues::kDistance, kOverwrite);
    streamNpz(path("direct.npz"), engine, counts, ListValues::kDistance, kOverwrite, 0);
    EXPECT_TRUE(contents(path("direct.npz")) == contents(path("lists.npz")));
}

TEST_F(OutputTest, npzWithoutListsStopsWhenAskedAndLeavesNothing)
{
    class StopLater final : public Progress {
    public:
        void update(const char* step, double fraction) override
        {
            EXPECT_STREQ(step, "write");
            if (fraction > 0.2) mStop = true;
        }
        bool cancelled() const override { return mStop; }

    private:
        std::atomic<bool> mStop{false};
    } progress;
    const TestRows rows(400000, 61);
    EXPECT_THROW(
        streamNpzRows(path("a.npz"), TestRowSource(rows), ListValues::kConnectivity, {}, 100000, &progress),
        Cancelled);
    EXPECT_EQ(fileCount(), 0u);
}

TEST_F(OutputTest, npzWithoutListsAndWithoutRoomLeavesNothing)
{
    const TestRows rows(50000, 61);
    // Within the counts, the rows, the ones.
    for (const rlim_t bytes : {100000, 2000000, 7000000}) {
        const FileSizeLimit limit(bytes);
        EXPECT_THROW(
            streamNpzRows(path("a.npz"), TestRowSource(rows), ListValues::kConnectivity, {}, 100000, nullptr),
            OutputError);
        EXPECT_EQ(fileCount(), 0u);
    }
}

TEST_F(OutputTest, npzWithoutListsNoticesRowsThatDoNotMatchTheCounts)
{
    const TestRows rows(5000, 61);
    TestRowSource lost(rows), cut(rows);
    lost.lose(1234);
    cut.cut(4321);
    for (const TestRowSource* source : {&lost, &cut}) {
        EXPECT_THROW(streamNpzRows(path("a.npz"), *source, ListValues::kConnectivity, {}, 10000, nullptr),
                     OutputError);
    }
    EXPECT_EQ(fileCount(), 0u);
}

} // namespace
} // namespace vdb_nns
