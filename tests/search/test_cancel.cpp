// How soon a step ends that is asked to stop, where its pieces are as large as they come: many particles at one point. And
// how often the readers of files ask.
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/executor.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search_job.h"
#include "verify/lists_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;

// Promised of each thread that has a processor to itself. Time is the processors', so that other work does not count.
constexpr int kThreads = 2;
constexpr double kMostSeconds = 0.3 * kThreads;

// Of all threads of this process together.
double processorSeconds()
{
    timespec time{};
    ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

// Asks to stop after some time.
class StopAfter final : public Progress {
public:
    explicit StopAfter(double seconds) : mStop(processorSeconds() + seconds) {}
    void update(const char*, double) override {}
    bool cancelled() const override { return processorSeconds() >= mStop; }

    double secondsSince() const { return processorSeconds() - mStop; }

private:
    const double mStop;
};

// Asks to stop when it is asked so many times.
class StopAtQuestion final : public Progress {
public:
    explicit StopAtQuestion(int number) : mNumber(number) {}
    void update(const char*, double) override {}
    bool cancelled() const override { return ++mQuestions >= mNumber; }

private:
    const int mNumber;
    mutable std::atomic<int> mQuestions{0};
};

// Measures how long nobody asks.
class LongestSilence final : public Progress {
public:
    void update(const char*, double) override {}
    bool cancelled() const override
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        const double now = processorSeconds();
        mLongest = std::max(mLongest, now - mLast);
        mLast = now;
        return false;
    }

    double longest() const { return mLongest; }
    double total() const { return mLast - mBegin; }

private:
    const double mBegin = processorSeconds();
    mutable std::mutex mMutex;
    mutable double mLast = mBegin, mLongest = 0;
};

// A part of the step's own time, so that the speed of the machine does not count.
void expectAsksThroughout(const std::string& name, const std::function<void(Progress*)>& step)
{
    runOnThreads(kThreads, [&] {
        LongestSilence progress;
        step(&progress);
        EXPECT_LT(progress.longest(), progress.total() / 5) << name << ": " << progress.total() << " s";
        std::printf("%s: %.4f s of %.3f s\n", name.c_str(), progress.longest(), progress.total());
    });
}

// The step takes several times as long as it is given.
void expectStops(const std::string& name, double afterSeconds, const std::function<void(Progress*)>& step)
{
    runOnThreads(kThreads, [&] {
        StopAfter progress(afterSeconds);
        EXPECT_THROW(step(&progress), Cancelled) << name;
        const double seconds = progress.secondsSince();
        EXPECT_LT(seconds, kMostSeconds) << name;
        std::printf("%s: %.3f s\n", name.c_str(), seconds);
    });
}

SearchOptions optionsOf(Encoding encoding, Progress* progress)
{
    SearchOptions options;
    options.encoding = encoding;
    options.progress = progress;
    return options;
}

TEST(Cancel, StopsSearchesOfOnePoint)
{
    constexpr std::size_t kParticles = 4'000'000;
    const std::vector<float> xyz(3 * kParticles, 0.25f);
    const ParticleView view = ParticleView::fromArray(xyz.data(), kParticles);
    SearchEngine engine;
    const SparseGrid grid = engine.buildGrid(view, 1);
    expectStops("grid", 0.002,
                [&](Progress* progress) { engine.buildGrid(view, 1, optionsOf(Encoding::kNone, progress)); });
    expectStops("counts", 0.1,
                [&](Progress* progress) { engine.search(grid, optionsOf(Encoding::kNone, progress)); });
    expectStops("whether lists fit", 0.1,
                [&](Progress* progress) { engine.search(grid, optionsOf(Encoding::kIndex, progress)); });
    expectStops("visit", 0.1, [&](Progress* progress) {
        engine.visit(
            grid, [](auto, auto, auto) {}, optionsOf(Encoding::kNone, progress));
    });
    expectStops("visitRows", 0.1, [&](Progress* progress) {
        engine.visitRows(
            grid, [](auto, auto) {}, optionsOf(Encoding::kNone, progress));
    });
    expectStops("estimate", 0.02, [&](Progress* progress) {
        EstimateOptions options;
        options.estimator = Estimator::kSampled;
        options.progress = progress;
        estimateWork(grid, options);
    });
    expectStops("random samples", 0.05, [&](Progress* progress) {
        EstimateOptions options;
        options.estimator = Estimator::kMonteCarlo;
        options.monteCarloSamples = 1'000'000'000;
        options.progress = progress;
        estimateWork(grid, options);
    });
    const std::vector<DeviceLimits> devices{deviceOf(std::uint64_t(1) << 30)};
    const Schedule schedule =
        makeSchedule(grid, treeOf(grid, fixedEstimate(grid), ~std::uint64_t(0), Encoding::kNone), devices);
    expectStops("simulated device", 0.1, [&](Progress* progress) {
        RunOptions options;
        options.search = optionsOf(Encoding::kNone, progress);
        ScheduleRun report;
        engine.search(grid, schedule, devices, options, report);
    });
}

TEST(Cancel, StopsSearchesOfFewPoints)
{
    // Every other pair is at the radius, where the filter cannot decide.
    constexpr std::size_t kParticles = 40'000;
    std::vector<double> xyz(3 * kParticles, 0.0);
    for (std::size_t i = 0; i < kParticles; ++i) xyz[3 * i] = i % 2 ? 1.0 : 0.0;
    const ParticleView view = ParticleView::fromArray(xyz.data(), kParticles);
    SearchEngine engine;
    for (const Encoding encoding : {Encoding::kMask, Encoding::kNone}) {
        expectStops("ties", 0.2, [&](Progress* progress) {
            engine.findNeighbors(view, 1, optionsOf(encoding, progress));
        });
    }
}

class CancelWithFiles : public ::testing::Test {
protected:
    CancelWithFiles()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_cancel_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
    }
    ~CancelWithFiles() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    // Reading asks in each MB of the file, which takes some milliseconds.
    void expectAsks(const std::string& name, const std::function<void(Progress*)>& read) const
    {
        const auto megabytes = static_cast<int>(fs::file_size(path(name)) >> 20);
        ASSERT_GE(megabytes, 4);
        // An array file's bytes come by 8 MB.
        StopAtQuestion progress(3 + megabytes + megabytes / 8);
        EXPECT_THROW(read(&progress), Cancelled) << name;
    }

    void expectAsks(const std::string& name) const
    {
        expectAsks(name, [&](Progress* progress) { PointFile::read(path(name), {"", 0, progress}); });
    }

    fs::path mFolder;
};

TEST_F(CancelWithFiles, StopsReadingTexts)
{
    constexpr std::size_t kParticles = 250'000;
    std::string lines;
    for (std::size_t i = 0; i < kParticles; ++i) lines += "0.1234567 0.2345678 0.3456789\n";
    std::ofstream(path("text.xyz")) << lines;
    expectAsks("text.xyz");
    std::ofstream(path("text.ply")) << "ply\nformat ascii 1.0\nelement vertex " << kParticles
                                    << "\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
                                    << lines;
    expectAsks("text.ply");
}

TEST_F(CancelWithFiles, StopsReadingVdb)
{
    SceneOptions options;
    options.name = "block";
    options.count = 500'000;
    writeScene(path("block.vdb"), makeScene(options), options);
    expectAsks("block.vdb");
}

// Many leaves with few particles each, as OpenVDB takes its time by the leaf.
TEST_F(CancelWithFiles, StopsWritingVdb)
{
    SceneOptions options;
    options.name = "spray";
    options.count = 1'000'000;
    const Scene scene = makeScene(options);
    const std::string input = path("in.vdb"), output = path("out.vdb");
    writeScene(input, scene, options); // the first run starts threads and fills memory
    const PointFile file = PointFile::read(input);
    const std::vector<std::uint32_t> counts(options.count, 1);
    const auto write = [&](Progress* progress) {
        file.writeVdb(output, {counts.data(), counts.size()}, "nns_", {true}, progress);
    };
    const auto writeAsScene = [&](Progress* progress) {
        writeScene(output, scene, options, {true}, progress);
    };
    expectAsksThroughout("scene", writeAsScene);
    expectAsksThroughout("vdb", write);
    fs::remove(output);
    for (const double afterSeconds : {0.01, 0.1, 0.2}) {
        expectStops("scene", afterSeconds, writeAsScene);
        expectStops("vdb", afterSeconds, write);
    }
    EXPECT_FALSE(fs::exists(output));
}

TEST_F(CancelWithFiles, StopsWhatIsMadeOfLists)
{
    const std::string output = path("lists.npz");
    constexpr std::size_t kParticles = 8'000; // 64 M pairs
    const std::vector<float> xyz(3 * kParticles, 0.25f);
    SearchEngine engine;
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        const NeighborLists lists = engine.findNeighbors(ParticleView::fromArray(xyz.data(), kParticles), 1,
                                                         optionsOf(encoding, nullptr));
        expectStops("npz", 0.01, [&](Progress* progress) {
            writeNpz(output, lists, ListValues::kDistance, {true}, progress);
        });
        expectStops("npz without lists", 0.01, [&](Progress* progress) {
            streamNpz(output, engine, lists, ListValues::kDistance, {true}, 0, optionsOf(encoding, progress));
        });
        expectStops("csr", 0.01, [&](Progress* progress) { lists.toCsr(progress); });
        expectStops("checksum", 0.002, [&](Progress* progress) { lists.checksum(progress); });
    }
    for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
        expectStops("npz while searching", 0.01, [&](Progress* progress) {
            JobOptions options;
            options.search = optionsOf(Encoding::kIndex, progress);
            options.npz = NpzTarget{output, values, {true}};
            JobReport report;
            engine.findNeighbors(ParticleView::fromArray(xyz.data(), kParticles), 1, options, report);
        });
    }
    EXPECT_TRUE(fs::is_empty(mFolder));
}

TEST_F(CancelWithFiles, StopsReadingLists)
{
    constexpr std::size_t kParticles = 1'500; // 2 M pairs
    const std::vector<float> xyz(3 * kParticles, 0.25f);
    const NeighborLists lists = SearchEngine().findNeighbors(ParticleView::fromArray(xyz.data(), kParticles),
                                                             1, optionsOf(Encoding::kMask, nullptr));
    writeNpz(path("lists.npz"), lists, ListValues::kConnectivity);
    expectAsks("lists.npz", [&](Progress* progress) { cli::ListsFile::open(path("lists.npz"), progress); });
}

} // namespace

} // namespace vdb_nns::testing
