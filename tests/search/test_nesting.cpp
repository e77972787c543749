// The library inside parallel work of its caller, and parallel work of the caller inside the library: engines of threads,
// visitors and a Progress with loops of their own, files that tasks share. Threads that wait take whatever task they may, so
// what goes wrong depends on timing: every case is run in many rounds, on arenas of 1 to 8 threads.
#include "agreement/point_views.h"
#include "plan/workload_cases.h"
#include "vdb_nns/planning/executor.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <thread>
#include <vector>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;

constexpr int kRounds = 200;
constexpr int kMostThreads = 8;

// f(round) on arenas of 1 to kMostThreads threads, however many cores there are.
template <typename F>
void repeatOnArenas(F&& f)
{
    const tbb::global_control most(tbb::global_control::max_allowed_parallelism, kMostThreads);
    for (int round = 0; round < kRounds; ++round) {
        tbb::task_arena arena(1 + round % kMostThreads);
        arena.execute([&] { f(round); });
        ASSERT_FALSE(::testing::Test::HasFailure()) << "round " << round;
    }
}

// A loop of the caller's own. Its tasks sleep, so that others come to take some, and who began the loop has to wait for
// them and looks for something else to do.
void callersLoop()
{
    std::atomic<int> ran{0};
    tbb::parallel_for(0, 4, [&](int) {
        std::this_thread::sleep_for(std::chrono::microseconds(20));
        ++ran;
    });
    EXPECT_EQ(ran, 4);
}

std::uint64_t hashOf(Span<const std::uint32_t> row)
{
    std::uint64_t hash = 14695981039346656037u;
    for (const std::uint32_t value : row) hash = (hash ^ value) * 1099511628211u;
    return hash;
}

// Random points with a few neighbors each, in many small leaves.
struct Frame {
    static constexpr double kRadius = 1;

    explicit Frame(std::uint64_t seed, std::size_t count = 1500)
    {
        std::uint64_t state = seed;
        for (std::size_t k = 0; k < 3 * count; ++k) {
            state = state * 6364136223846793005u + 1442695040888963407u;
            xyz.push_back(static_cast<double>(state >> 40) * 0x1p-24 * 20);
        }
        options.cellSize = 1;
        checksum = findNeighbors(view(), kRadius, options).checksum();
    }

    ParticleView view() const { return ParticleView::fromArray(xyz.data(), xyz.size() / 3); }

    std::vector<double> xyz;
    SearchOptions options;
    std::uint64_t checksum;
};

std::vector<Frame> makeFrames()
{
    std::vector<Frame> frames;
    for (std::uint64_t seed = 1; seed <= 8; ++seed) frames.emplace_back(seed);
    return frames;
}

TEST(Nesting, AnEngineOfEachThreadSearchesFramesInALoop)
{
    const std::vector<Frame> frames = makeFrames();
    repeatOnArenas([&](int round) {
        tbb::enumerable_thread_specific<SearchEngine> engines;
        std::vector<std::uint64_t> found(frames.size());
        tbb::parallel_for(std::size_t(0), frames.size(), [&](std::size_t f) {
            SearchEngine& engine = engines.local();
            SearchOptions options = frames[f].options;
            options.encoding = round % 2 ? Encoding::kMask : Encoding::kIndex;
            const SparseGrid grid = engine.buildGrid(frames[f].view(), Frame::kRadius, options);
            found[f] = engine.search(grid, options).checksum();
        });
        for (std::size_t f = 0; f < frames.size(); ++f) EXPECT_EQ(found[f], frames[f].checksum) << f;
    });
}

TEST(Nesting, SchedulesRunInALoop)
{
    struct Plan {
        explicit Plan(const Frame& frame)
            : own(gridOf(frame.view(), Frame::kRadius, 1)),
              devices{deviceOf(own.need(Encoding::kIndex) / 2, 2),
                      deviceOf(own.need(Encoding::kIndex) / 2, 2)},
              schedule(makeSchedule(
                  own.grid,
                  own.tree(Encoding::kIndex,
                           nodeBytesFor(own.grid, own.estimate, MemoryModel{Encoding::kIndex}, devices)),
                  devices))
        {
        }
        EstimatedGrid own;
        std::vector<DeviceLimits> devices;
        Schedule schedule;
    };
    const std::vector<Frame> frames = makeFrames();
    std::vector<Plan> plans;
    for (std::size_t f = 0; f < 4; ++f) plans.emplace_back(frames[f]);
    repeatOnArenas([&](int) {
        tbb::enumerable_thread_specific<SearchEngine> engines;
        std::vector<std::uint64_t> found(plans.size());
        tbb::parallel_for(std::size_t(0), plans.size(), [&](std::size_t f) {
            ScheduleRun report;
            const NeighborLists lists =
                engines.local().search(plans[f].own.grid, plans[f].schedule, plans[f].devices, {}, report);
            found[f] = lists.checksum();
        });
        for (std::size_t f = 0; f < plans.size(); ++f) EXPECT_EQ(found[f], frames[f].checksum) << f;
    });
}

// What a visitor is told, and whether it was called again on a thread that was still inside it.
class VisitRecord {
public:
    explicit VisitRecord(std::size_t particles) : mVisits(particles) {}

    void visit(std::uint32_t query, Span<const std::uint32_t> neighbors)
    {
        thread_local int depth = 0;
        mNested += depth++ > 0;
        ++mVisits[query];
        const std::uint64_t before = hashOf(neighbors);
        if (query % 128 == 0) callersLoop();
        mChanged += hashOf(neighbors) != before;
        std::uint64_t sum = 0;
        for (const std::uint32_t neighbor : neighbors) sum += neighbor + std::uint64_t(query) * query;
        mSum += sum;
        --depth;
    }

    void expectAll(std::uint64_t sum) const
    {
        EXPECT_EQ(mNested, 0);
        EXPECT_EQ(mChanged, 0);
        EXPECT_EQ(mSum, sum);
        EXPECT_TRUE(std::all_of(mVisits.begin(), mVisits.end(), [](int visits) { return visits == 1; }));
    }

    std::uint64_t sum() const { return mSum; }

private:
    std::vector<std::atomic<int>> mVisits;
    std::atomic<int> mNested{0}, mChanged{0};
    std::atomic<std::uint64_t> mSum{0};
};

TEST(Nesting, AVisitorRunsALoopOfItsOwn)
{
    const Frame frame(99);
    SearchEngine engine;
    SearchOptions options = frame.options;
    options.cellSize = 0.33; // smaller leaves, more tasks
    const SparseGrid grid = engine.buildGrid(frame.view(), Frame::kRadius, options);
    options.encoding = Encoding::kMask;
    const NeighborLists lists = engine.search(grid, options);
    const std::size_t particles = grid.particleCount();
    VisitRecord expected(particles);
    tbb::task_arena(1).execute([&] {
        lists.visitRows(
            [&](std::uint32_t query, Span<const std::uint32_t> row) { expected.visit(query, row); });
    });
    repeatOnArenas([&](int) {
        VisitRecord pairs(particles), rows(particles), listed(particles);
        engine.visit(grid,
                     [&](std::uint32_t query, Span<const std::uint32_t> row, Span<const double> distances) {
                         EXPECT_EQ(distances.size(), row.size());
                         pairs.visit(query, row);
                     });
        engine.visitRows(grid,
                         [&](std::uint32_t query, Span<const std::uint32_t> row) { rows.visit(query, row); });
        lists.visitRows(
            [&](std::uint32_t query, Span<const std::uint32_t> row) { listed.visit(query, row); });
        for (const VisitRecord* record : {&pairs, &rows, &listed}) record->expectAll(expected.sum());
    });
}

// A visitor may search, with an engine of its own.
TEST(Nesting, AVisitorSearches)
{
    const Frame frame(5), inner(6, 300);
    SearchEngine engine;
    const SparseGrid grid = engine.buildGrid(frame.view(), Frame::kRadius, frame.options);
    repeatOnArenas([&](int) {
        tbb::enumerable_thread_specific<SearchEngine> engines;
        std::vector<std::atomic<int>> visits(grid.particleCount());
        engine.visitRows(grid, [&](std::uint32_t query, Span<const std::uint32_t>) {
            ++visits[query];
            if (query % 64) return;
            const NeighborLists lists =
                engines.local().findNeighbors(inner.view(), Frame::kRadius, inner.options);
            EXPECT_EQ(lists.checksum(), inner.checksum);
        });
        for (const auto& count : visits) EXPECT_EQ(count, 1);
    });
}

TEST(Nesting, AProgressRunsALoopOfItsOwn)
{
    class BusyProgress final : public Progress {
    public:
        void update(const char*, double) override {}
        bool cancelled() const override
        {
            if (mAsked++ % 8 == 0) callersLoop();
            return false;
        }

    private:
        mutable std::atomic<int> mAsked{0};
    };
    const std::vector<Frame> frames = makeFrames();
    repeatOnArenas([&](int round) {
        const Frame& frame = frames[static_cast<std::size_t>(round) % frames.size()];
        BusyProgress progress;
        SearchOptions options = frame.options;
        options.progress = &progress;
        SearchEngine engine;
        EXPECT_EQ(engine.findNeighbors(frame.view(), Frame::kRadius, options).checksum(), frame.checksum);
    });
}

class NestingFiles : public ::testing::Test {
protected:
    NestingFiles()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_nesting_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~NestingFiles() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    // In small leaves.
    std::string makeFile(std::uint64_t points) const
    {
        SceneOptions options;
        options.name = "block";
        options.count = points;
        options.spacing = 0.1;
        options.voxelSize = 0.04;
        const std::string file = path("in.vdb");
        writeScene(file, makeScene(options), options, {true});
        return file;
    }

    static void writeNpy(const std::string& file, const std::vector<double>& xyz)
    {
        std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': (" +
                             std::to_string(xyz.size() / 3) + ", 3), }";
        header.resize(117, ' ');
        header += '\n';
        std::ofstream stream(file, std::ios::binary);
        stream.write("\x93NUMPY\x01\x00\x76\x00", 10);
        stream << header;
        stream.write(reinterpret_cast<const char*>(xyz.data()),
                     static_cast<std::streamsize>(xyz.size() * sizeof(double)));
    }

    // All but the identifier that OpenVDB draws at random.
    static std::string contentsOf(const std::string& file)
    {
        std::ifstream stream(file, std::ios::binary);
        std::string bytes{std::istreambuf_iterator<char>(stream), {}};
        constexpr std::size_t kUuid = 21, kUuidBytes = 36;
        return bytes.size() < kUuid + kUuidBytes ? bytes : bytes.erase(kUuid, kUuidBytes);
    }

private:
    fs::path mFolder;
};

TEST_F(NestingFiles, TasksAskAFileWhatIsInIt)
{
    const std::string file = path("in.npy");
    writeNpy(file, Frame(3, 200000).xyz);
    const PointFileInfo expected = PointFile::read(file).info();
    repeatOnArenas([&](int) {
        const PointFile points = PointFile::read(file);
        tbb::parallel_for(0, 16, [&](int task) {
            if (task > 0) callersLoop(); // one comes first
            const PointFileInfo& info = points.info();
            EXPECT_EQ(info.points, expected.points);
            EXPECT_EQ(info.bbox, expected.bbox);
            EXPECT_EQ(info.codec, expected.codec);
            EXPECT_EQ(&info, &points.info());
        });
    });
}

TEST_F(NestingFiles, TasksReadAndSearchFiles)
{
    const std::string file = makeFile(3000);
    const double radius = PointFile::read(file).info().suggestedRadius.value();
    const std::uint64_t expected = findNeighbors(PointFile::read(file).view(), radius).checksum();
    repeatOnArenas([&](int) {
        tbb::enumerable_thread_specific<SearchEngine> engines;
        tbb::parallel_for(0, 6, [&](int) {
            const PointFile points = PointFile::read(file);
            EXPECT_EQ(engines.local().findNeighbors(points.view(), radius).checksum(), expected);
        });
    });
}

TEST_F(NestingFiles, TasksWriteAFile)
{
    const PointFile points = PointFile::read(makeFile(2000));
    std::vector<std::uint32_t> counts(points.view().size());
    for (std::size_t i = 0; i < counts.size(); ++i) counts[i] = static_cast<std::uint32_t>(7 * i % 1000);
    points.writeVdb(path("expected.vdb"), {counts.data(), counts.size()}, "nns_", {});
    const std::string expected = contentsOf(path("expected.vdb"));
    repeatOnArenas([&](int) {
        tbb::parallel_for(0, 4, [&](int task) {
            if (task > 0) callersLoop(); // one comes first
            points.writeVdb(path(std::to_string(task) + ".vdb"), {counts.data(), counts.size()}, "nns_",
                            {true});
        });
        for (int task = 0; task < 4; ++task)
            EXPECT_EQ(contentsOf(path(std::to_string(task) + ".vdb")) == expected, true) << task;
    });
}

TEST_F(NestingFiles, TasksWriteLists)
{
    const std::vector<Frame> frames = makeFrames();
    const auto writeBoth = [&](SearchEngine& engine, const Frame& frame, const std::string& name) {
        SearchOptions options = frame.options;
        options.encoding = Encoding::kMask;
        const NeighborLists lists = engine.findNeighbors(frame.view(), Frame::kRadius, options);
        writeNpz(path(name + "_a.npz"), lists, ListValues::kDistance, {true});
        streamNpz(path(name + "_b.npz"), engine, lists, ListValues::kDistance, {true}, 0, frame.options);
        return contentsOf(path(name + "_a.npz"));
    };
    std::vector<std::string> expected;
    for (std::size_t f = 0; f < 3; ++f) {
        SearchEngine engine;
        expected.push_back(writeBoth(engine, frames[f], "expected"));
    }
    repeatOnArenas([&](int) {
        tbb::enumerable_thread_specific<SearchEngine> engines;
        tbb::parallel_for(std::size_t(0), expected.size(), [&](std::size_t f) {
            const std::string name = std::to_string(f);
            EXPECT_TRUE(writeBoth(engines.local(), frames[f], name) == expected[f]) << f;
            EXPECT_TRUE(contentsOf(path(name + "_b.npz")) == expected[f]) << f;
        });
    });
}

} // namespace

} // namespace vdb_nns::testing
