// What a Progress throws leaves every step as it is, whenever it throws; files that are written are not there then.
#include "plan/workload_cases.h"
#include "vdb_nns/planning/executor.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search_job.h"
#include "vdb_nns/write_points.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;

struct Thrown : std::runtime_error {
    using std::runtime_error::runtime_error;
};

// Throws at a given call of update(), or of cancelled().
class ThrowingProgress final : public Progress {
public:
    static constexpr int kNever = -1;

    ThrowingProgress(int atUpdate, int atQuestion) : mAtUpdate(atUpdate), mAtQuestion(atQuestion) {}

    void update(const char*, double) override
    {
        if (mUpdates++ == mAtUpdate) throw Thrown("update");
    }
    bool cancelled() const override
    {
        if (mQuestions++ == mAtQuestion) throw Thrown("cancelled");
        return false;
    }

    int updates() const { return mUpdates; }
    int questions() const { return mQuestions; }

private:
    const int mAtUpdate, mAtQuestion;
    std::atomic<int> mUpdates{0};
    mutable std::atomic<int> mQuestions{0};
};

using Step = std::function<void(Progress*)>;

// The first calls, the last ones, and some between.
std::vector<int> callsToTry(int calls)
{
    std::vector<int> tried;
    for (int call = 0; call < calls; call += call < 4 || call >= calls - 4 ? 1 : calls / 4 + 1)
        tried.push_back(call);
    if (calls > 0) tried.push_back(calls - 1);
    return tried;
}

// `failed()` is asked after each throw. On one thread, so that the calls can be counted.
void expectThrown(
    const char* name, const Step& step, const std::function<void()>& failed = [] {})
{
    SCOPED_TRACE(name);
    runOnThreads(1, [&] {
        ThrowingProgress counting(ThrowingProgress::kNever, ThrowingProgress::kNever);
        step(&counting);
        EXPECT_GT(counting.updates(), 0);
        for (const int call : callsToTry(counting.updates())) {
            ThrowingProgress progress(call, ThrowingProgress::kNever);
            EXPECT_THROW(step(&progress), Thrown) << "update " << call << " of " << counting.updates();
            failed();
        }
        for (const int call : callsToTry(counting.questions())) {
            ThrowingProgress progress(ThrowingProgress::kNever, call);
            EXPECT_THROW(step(&progress), Thrown) << "question " << call << " of " << counting.questions();
            failed();
        }
    });
}

TEST(ThrowingProgress, LeavesTheStepsOfASearch)
{
    SceneOptions scene;
    scene.name = "spray";
    scene.count = 5000;
    const Scene made = makeScene(scene);
    const ParticleView view = ParticleView::fromArray(made.positions.data(), scene.count);
    const double radius = made.suggestedRadius;
    SearchEngine engine;
    const SparseGrid grid = engine.buildGrid(view, radius);
    const EstimatedGrid own(grid);
    const NeighborLists lists = engine.search(grid);
    const auto with = [](Progress* progress) {
        SearchOptions options;
        options.progress = progress;
        return options;
    };
    expectThrown("scene", [&](Progress* progress) { makeScene(scene, progress); });
    expectThrown("grid", [&](Progress* progress) { engine.buildGrid(view, radius, with(progress)); });
    expectThrown("search", [&](Progress* progress) { engine.search(grid, with(progress)); });
    expectThrown("visit", [&](Progress* progress) {
        engine.visit(
            grid, [](auto, auto, auto) {}, with(progress));
    });
    expectThrown("estimate", [&](Progress* progress) {
        EstimateOptions options;
        options.estimator = Estimator::kCounted;
        options.progress = progress;
        estimateWork(grid, options);
    });
    expectThrown("schedule", [&](Progress* progress) {
        const std::vector<DeviceLimits> devices{deviceOf(own.need(Encoding::kMask) / 4)};
        const std::uint64_t bytes = nodeBytesFor(grid, own.estimate, MemoryModel{}, devices);
        const Schedule schedule = makeSchedule(grid, own.tree(Encoding::kMask, bytes), devices);
        RunOptions options;
        options.search = with(progress);
        ScheduleRun report;
        engine.search(grid, schedule, devices, options, report);
    });
    EXPECT_EQ(engine.search(grid).checksum(), lists.checksum()); // the engine still works
}

class ThrowingProgressFiles : public ::testing::Test {
protected:
    ThrowingProgressFiles()
    {
        std::string name = (fs::temp_directory_path() / "vdb_nns_progress_XXXXXX").string();
        mFolder = ::mkdtemp(name.data());
        mScene.name = "block";
        mScene.count = 3000;
        mMade = makeScene(mScene);
    }
    ~ThrowingProgressFiles() override { fs::remove_all(mFolder); }

    std::string path(const std::string& name) const { return (mFolder / name).string(); }

    SceneOptions mScene;
    Scene mMade;

private:
    fs::path mFolder;
};

TEST_F(ThrowingProgressFiles, LeavesReading)
{
    writeScene(path("in.vdb"), mMade, mScene, {});
    std::ofstream(path("in.xyz")) << "0 0 0\n1 1 1\n";
    std::ofstream(path("in.ply")) << "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
                                     "property float y\nproperty float z\nend_header\n0 0 0\n";
    for (const char* name : {"in.vdb", "in.xyz", "in.ply"})
        expectThrown(name, [&](Progress* progress) { PointFile::read(path(name), {{}, 0, progress}); });
}

TEST_F(ThrowingProgressFiles, LeavesWritersWithoutAFile)
{
    const std::string out = path("out");
    const auto expectNoFile = [&](const char* name, const Step& write) {
        const auto files = [&] { return std::distance(fs::directory_iterator(path("")), {}); };
        fs::remove(out);
        const auto before = files();
        expectThrown(
            name,
            [&](Progress* progress) {
                fs::remove(out);
                write(progress);
                EXPECT_TRUE(fs::exists(out));
            },
            [&] { EXPECT_EQ(files(), before); });
    };
    expectNoFile("scene", [&](Progress* progress) { writeScene(out, mMade, mScene, {}, progress); });
    writeScene(path("in.vdb"), mMade, mScene, {});
    const PointFile file = PointFile::read(path("in.vdb"));
    SearchEngine engine;
    const NeighborLists lists = engine.findNeighbors(file.view(), mMade.suggestedRadius);
    const std::vector<std::uint32_t> counts = lists.counts();
    expectNoFile("vdb", [&](Progress* progress) {
        file.writeVdb(out, {counts.data(), counts.size()}, "nns_", {}, progress);
    });
    expectNoFile("npz",
                 [&](Progress* progress) { writeNpz(out, lists, ListValues::kDistance, {}, progress); });
    expectNoFile("npz without lists", [&](Progress* progress) {
        SearchOptions options;
        options.progress = progress;
        streamNpz(out, engine, lists, ListValues::kConnectivity, {}, 0, options);
    });
    std::vector<std::uint8_t> members(mScene.count, 1);
    PointValues values;
    values.attributes = {
        viewAttribute("position", AttributeType::kVec3d, mMade.positions.data(), mScene.count)};
    values.groups = {viewGroup("all", {members.data(), members.size()})};
    expectNoFile("values into a vdb", [&](Progress* progress) { file.writeVdb(out, values, {}, progress); });
    expectNoFile("new vdb",
                 [&](Progress* progress) { writeNewVdb(out, file.view(), values, {}, {}, progress); });
    expectNoFile("ply", [&](Progress* progress) { writePly(out, file.view(), values, {}, progress); });
    expectNoFile("arrays",
                 [&](Progress* progress) { writePointsNpz(out, file.view(), values, {}, progress); });
    expectNoFile("positions", [&](Progress* progress) { writePointsNpy(out, file.view(), {}, progress); });
    for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
        expectNoFile("npz while searching", [&](Progress* progress) {
            JobOptions options;
            options.search.progress = progress;
            options.npz = NpzTarget{out, values, {}};
            JobReport report;
            engine.findNeighbors(file.view(), mMade.suggestedRadius, options, report);
            EXPECT_TRUE(report.written);
        });
    }
}

} // namespace

} // namespace vdb_nns::testing
