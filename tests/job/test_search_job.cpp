// One call that does all a search does: devices, budgets, plans, and other encodings where the first does not fit. The same lists
// wherever they are found.
#include "vdb_nns/error.h"
#include "vdb_nns/memory.h"
#include "vdb_nns/scene.h"
#include "vdb_nns/search_job.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

namespace vdb_nns::testing {
namespace {

Scene sceneOf(const char* name, std::uint64_t count)
{
    SceneOptions options;
    options.name = name;
    options.count = count;
    return makeScene(options);
}

ParticleView viewOf(const Scene& scene)
{
    return ParticleView::fromArray(scene.positions.data(), scene.positions.size() / 3);
}

JobOptions jobOn(const std::string& device, std::uint64_t deviceBytes = 0)
{
    JobOptions options;
    options.device = chooseDevices(device, 2);
    for (DeviceLimits& limits : options.device.devices) {
        if (deviceBytes) limits.memoryBytes = deviceBytes;
    }
    return options;
}

// What the process has beside a job is taken from its bound, and a reserve for each thread: so many bytes more, for two threads.
std::uint64_t residentAnd(std::uint64_t bytes)
{
    constexpr std::uint64_t kReserve = std::uint64_t(32) << 20;
    returnFreedMemory();
    return residentMemoryBytes() + kReserve + bytes;
}

// The estimate is for the radius of the search too, both the rough one and that in full.
TEST(SearchJob, FollowsASmallerRadiusThanTheLattices)
{
    const Scene scene = sceneOf("dam_break", 60000);
    const ParticleView view = viewOf(scene);
    const double radius = 0.6 * scene.suggestedRadius;
    const NeighborLists truth = findNeighbors(view, radius);
    for (const std::uint64_t bytes : {std::uint64_t(1) << 30, std::uint64_t(1) << 20}) {
        SCOPED_TRACE(bytes);
        JobOptions options = jobOn("sim", bytes);
        JobReport full, report;
        SearchEngine().findNeighbors(view, scene.suggestedRadius, options, full);
        options.search.radius = radius;
        const NeighborLists lists =
            SearchEngine().findNeighbors(view, scene.suggestedRadius, options, report);
        EXPECT_EQ(lists.radius(), radius);
        EXPECT_EQ(lists.checksum(), truth.checksum());
        EXPECT_LT(report.plan->total.expectedPairs, 0.5 * full.plan->total.expectedPairs);
    }
}

TEST(SearchJob, FindsTheSameListsOnTheCpuAndOnDevices)
{
    for (const char* name : {"dam_break", "spray"}) {
        const Scene scene = sceneOf(name, 60000);
        const ParticleView view = viewOf(scene);
        const std::uint64_t truth = findNeighbors(view, scene.suggestedRadius).checksum();
        for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
            for (const auto& [device, bytes] : {std::pair<const char*, std::uint64_t>("cpu", 0),
                                                {"auto", 0},
                                                {"sim", 0},
                                                {"sim", std::uint64_t(1) << 20},
                                                {"sim:3", std::uint64_t(1) << 20}}) {
                SCOPED_TRACE(std::string(name) + " on " + device);
                JobOptions options = jobOn(device, bytes);
                options.search.encoding = encoding;
                JobReport report;
                const NeighborLists lists = findNeighbors(view, scene.suggestedRadius, options, report);
                EXPECT_EQ(lists.checksum(), truth);
                EXPECT_EQ(lists.encoding(), encoding);
                EXPECT_EQ(report.plan.has_value(), !options.device.devices.empty());
                EXPECT_EQ(report.run.has_value(), report.plan.has_value());
                EXPECT_TRUE(report.notes.empty());
                EXPECT_FALSE(report.streamed);
                if (!report.run) continue;
                ASSERT_EQ(report.run->devices.size(), options.device.devices.size());
                EXPECT_GT(report.plan->schedule.blocks.size(), bytes > 0 ? 1u : 0u);
                for (std::size_t d = 0; d < report.run->devices.size(); ++d) {
                    EXPECT_LE(report.run->devices[d].peakBytes, report.plan->devices[d].memoryBytes);
                }
            }
        }
    }
}

void checkMasks()
{
    const Scene scene = sceneOf("block", 400000);
    const ParticleView view = viewOf(scene);
    const NeighborLists truth = findNeighbors(view, scene.suggestedRadius);
    const std::uint64_t checksum = truth.checksum(), indexBytes = truth.bytes(),
                        gridBytes = truth.grid().bytes();
    JobOptions options = jobOn("cpu");
    options.search.hostMemoryBytes = residentAnd(2 * gridBytes + indexBytes / 4 * 3);
    JobReport report;
    EXPECT_THROW(findNeighbors(view, scene.suggestedRadius, options, report), CapacityError)
        << "another encoding only where that is allowed";
    options.mayUseMasks = true;
    SearchEngine engine;
    const NeighborLists lists = engine.findNeighbors(view, scene.suggestedRadius, options, report);
    EXPECT_EQ(lists.encoding(), Encoding::kMask);
    EXPECT_EQ(lists.checksum(), checksum);
    ASSERT_EQ(report.notes.size(), 1u);
    EXPECT_NE(report.notes[0].find("lists are held as masks instead"), std::string::npos) << report.notes[0];
    // The next one starts where this ended, also in the same report.
    JobReport next = report;
    EXPECT_EQ(engine.findNeighbors(view, scene.suggestedRadius, next.settled, next).encoding(),
              Encoding::kMask);
    EXPECT_TRUE(next.notes.empty());
}

TEST(SearchJob, TakesMasksWhereIndexListsDoNotFit)
{
    tbb::task_arena(2).execute(checkMasks);
}

std::vector<char> bytesOf(const std::string& path)
{
    std::FILE* const file = std::fopen(path.c_str(), "rb");
    std::vector<char> bytes;
    char buffer[65536];
    for (std::size_t n; file && (n = std::fread(buffer, 1, sizeof buffer, file)) > 0;) {
        bytes.insert(bytes.end(), buffer, buffer + n);
    }
    if (file) std::fclose(file);
    return bytes;
}

// The file is written while its rows are found where nothing speaks against it, and the same file by its caller elsewhere.
void checkWriting()
{
    const Scene scene = sceneOf("block", 100000);
    const ParticleView view = viewOf(scene);
    const std::string folder = ::testing::TempDir(), held = folder + "job_lists.npz",
                      written = folder + "job_written.npz";
    const NeighborLists truth = findNeighbors(view, scene.suggestedRadius);
    for (const ListValues values : {ListValues::kConnectivity, ListValues::kDistance}) {
        writeNpz(held, truth, values, {true});
        for (const auto& [device, encoding] : {std::pair<const char*, Encoding>("cpu", Encoding::kIndex),
                                               {"cpu", Encoding::kMask},
                                               {"sim", Encoding::kIndex}}) {
            const bool isWritten = device == std::string("cpu") && encoding == Encoding::kIndex;
            SCOPED_TRACE(std::string(device) + (encoding == Encoding::kMask ? ", mask" : ", index"));
            JobOptions options = jobOn(device);
            options.search.encoding = encoding;
            options.npz = NpzTarget{written, values, {true}, true};
            std::remove(written.c_str());
            JobReport report;
            SearchEngine engine;
            const NeighborLists lists = engine.findNeighbors(view, scene.suggestedRadius, options, report);
            EXPECT_EQ(report.written, isWritten);
            EXPECT_EQ(report.streamed, isWritten);
            EXPECT_EQ(report.checksum.has_value(), isWritten);
            EXPECT_EQ(lists.encoding(), isWritten ? Encoding::kNone : encoding);
            EXPECT_EQ(lists.counts(), truth.counts());
            EXPECT_EQ(report.checksum.value_or(truth.checksum()), truth.checksum());
            if (!isWritten) writeJobNpz(written, engine, lists, report, values, {true});
            EXPECT_TRUE(bytesOf(written) == bytesOf(held));
            // The same options again, and another file of the same lists.
            if (!isWritten) continue;
            engine.findNeighbors(view, scene.suggestedRadius, report.settled, report);
            EXPECT_TRUE(report.written);
            EXPECT_TRUE(bytesOf(written) == bytesOf(held));
            writeJobNpz(written, engine, lists, report, values, {true});
            EXPECT_TRUE(bytesOf(written) == bytesOf(held));
        }
    }
    std::remove(held.c_str());
    std::remove(written.c_str());
}

TEST(SearchJob, WritesAFileWhileItsRowsAreFound)
{
    tbb::task_arena(2).execute(checkWriting);
}

void checkStreaming()
{
    const Scene scene = sceneOf("block", 400000);
    const ParticleView view = viewOf(scene);
    SearchEngine engine;
    const std::string folder = ::testing::TempDir(), held = folder + "job_held.npz",
                      streamed = folder + "job_streamed.npz";
    {
        JobReport report;
        const NeighborLists lists = engine.findNeighbors(view, scene.suggestedRadius, jobOn("cpu"), report);
        writeJobNpz(held, engine, lists, report, ListValues::kConnectivity, {true});
    }
    engine = SearchEngine();
    JobOptions options = jobOn("cpu");
    options.written.npz = options.mayStream = true;
    options.search.hostMemoryBytes = residentAnd(std::uint64_t(20) << 20);
    JobReport report;
    const NeighborLists counts = engine.findNeighbors(view, scene.suggestedRadius, options, report);
    EXPECT_EQ(counts.encoding(), Encoding::kNone);
    EXPECT_TRUE(report.streamed);
    ASSERT_FALSE(report.notes.empty());
    writeJobNpz(streamed, engine, counts, report, ListValues::kConnectivity, {true});
    EXPECT_TRUE(bytesOf(held) == bytesOf(streamed));
    // The next one streams too, at once, and by now the process has more than before.
    report.settled.search.hostMemoryBytes = residentAnd(std::uint64_t(20) << 20);
    const NeighborLists again = engine.findNeighbors(view, scene.suggestedRadius, report.settled, report);
    EXPECT_TRUE(report.streamed);
    EXPECT_TRUE(report.notes.empty());
    writeJobNpz(streamed, engine, again, report, ListValues::kConnectivity, {true});
    EXPECT_TRUE(bytesOf(held) == bytesOf(streamed));
    std::remove(held.c_str());
    std::remove(streamed.c_str());
}

TEST(SearchJob, StreamsRowsWhereNoListsFit)
{
    tbb::task_arena(2).execute(checkStreaming);
}

TEST(SearchJob, SaysWhereTheMemoryWentWhenNothingFits)
{
    const Scene scene = sceneOf("block", 200000);
    const ParticleView view = viewOf(scene);
    JobOptions options = jobOn("cpu");
    options.search.hostMemoryBytes = 1 << 20;
    JobReport report;
    try {
        findNeighbors(view, scene.suggestedRadius, options, report);
        FAIL() << "a megabyte is less than the program has";
    } catch (const CapacityError& error) {
        EXPECT_GT(error.neededBytes(), error.allowedBytes());
        EXPECT_NE(std::string(error.what()).find("the host memory allowed"), std::string::npos)
            << error.what();
    }
}

TEST(SearchJob, PlansWithoutRunning)
{
    const Scene scene = sceneOf("dam_break", 60000);
    const ParticleView view = viewOf(scene);
    SearchEngine engine;
    JobOptions options = jobOn("sim", std::uint64_t(1) << 20);
    options.search.encoding = Encoding::kMask;
    const JobPlan planned = engine.planJob(view, scene.suggestedRadius, options);
    EXPECT_EQ(planned.grid.particleCount(), 60000u);
    JobReport report;
    engine.findNeighbors(view, scene.suggestedRadius, options, report);
    EXPECT_EQ(planned.plan.schedule.blocks.size(), report.plan->schedule.blocks.size());
    EXPECT_EQ(engine.planJob(view, scene.suggestedRadius, jobOn("cpu")).plan.schedule.blocks.size(), 1u);
}

// Of sets with roles and radii: tests and the bytes of masks exactly, pairs from counted queries.
TEST(SearchJob, PlansSets)
{
    const Scene scene = sceneOf("dam_break", 60000);
    const ParticleView view = viewOf(scene);
    std::vector<std::uint8_t> chosen(view.size());
    std::vector<double> radii(view.size());
    for (std::size_t i = 0; i < view.size(); ++i) {
        chosen[i] = i % 3 == 0;
        radii[i] = scene.suggestedRadius * (i % 2 ? 1 : 0.6);
    }
    Radius ofEach;
    ofEach.ofQueries = {radii.data(), radii.size()};
    const ParticleSet queries(view, {chosen.data(), chosen.size()});
    for (const Radius& radius : {Radius(scene.suggestedRadius), ofEach}) {
        JobOptions options = jobOn("cpu");
        options.search.encoding = Encoding::kMask;
        SearchEngine engine;
        const JobPlan planned = engine.planJob(view, queries, radius, options);
        const NeighborLists lists = engine.search(planned.sets, options.search);
        EXPECT_EQ(planned.plan.total.particles, planned.sets.finiteQueries());
        EXPECT_EQ(planned.plan.total.candidateTests, countCandidateTests(planned.sets));
        const double found = static_cast<double>(lists.statistics().pairs);
        EXPECT_NEAR(planned.plan.total.expectedPairs / found, 1, 0.1);
        EXPECT_GT(planned.plan.countedQueries, 0u);
        const std::uint64_t ofRadii = radius.isOne() ? 0 : radii.size() * sizeof(double);
        EXPECT_EQ(planned.plan.everything.up, planned.sets.bytes() + ofRadii);
        EXPECT_EQ(planned.measureBytes, 0u);
        options.device = chooseDevices("sim", 2);
        EXPECT_THROW(engine.planJob(view, queries, radius, options), InvalidInput);
    }
}

// What a plan says that measures take is what a job needs beside the process, grid and counts: a tenth less is refused, a tenth
// more is enough.
void checkMeasureBytes()
{
    const Scene scene = sceneOf("block", 400000);
    const ParticleView view = viewOf(scene);
    const std::uint64_t n = view.size();
    const std::vector<double> masses(n, 0.5);
    const std::vector<float> velocities(3 * n, 0.25f);
    for (const bool isWritten : {false, true}) {
        SCOPED_TRACE(isWritten);
        JobOptions options = jobOn("cpu");
        options.search.encoding = Encoding::kNone;
        options.measures = {"density", "pca", "average:v"};
        options.measure.masses = {masses.data(), masses.size()};
        options.measure.attributes = {viewAttribute("v", AttributeType::kVec3s, velocities.data(), n)};
        options.written.vdb = isWritten;
        std::uint64_t beside = 0, measures = 0;
        {
            const JobPlan planned = SearchEngine().planJob(view, scene.suggestedRadius, options);
            beside = planned.sets.bytes() + 2 * 4 * n + 16 * planned.sets.leafCount();
            measures = planned.measureBytes;
        }
        // Values; positions (doubles) and velocities as they are read; masses and velocities as they are given.
        const std::uint64_t values = 8 + (12 + 36 + 24 + 1) + 12, given = 8 + 12;
        const std::uint64_t copies = isWritten ? (16 << 20) + (values + 4) * n : 0;
        EXPECT_EQ(measures, (values + 32 + 32 + given) * n + copies);
        measures -= given * n; // which the process has already
        JobReport report;
        options.search.hostMemoryBytes = residentAnd(beside + measures / 10 * 9);
        EXPECT_THROW(findNeighbors(view, scene.suggestedRadius, options, report), CapacityError);
        options.search.hostMemoryBytes = residentAnd(beside + measures / 10 * 11);
        findNeighbors(view, scene.suggestedRadius, options, report);
        EXPECT_EQ(report.measured.attributes.size(), 5u);
    }
}

TEST(SearchJob, PlansWhatMeasuresTake)
{
    tbb::task_arena(2).execute(checkMeasureBytes);
}

// Measures are the same whether they are made in the pass that counts or in one of their own, after lists or after devices.
TEST(SearchJob, MakesMeasures)
{
    const Scene scene = sceneOf("dam_break", 30000);
    const ParticleView view = viewOf(scene);
    std::vector<std::string> bytes;
    for (const char* device : {"cpu", "sim"}) {
        for (const Encoding encoding : {Encoding::kNone, Encoding::kIndex, Encoding::kMask}) {
            JobOptions options = jobOn(device);
            options.search.encoding = encoding;
            options.measures = {"density", "cluster", "normal"};
            JobReport report;
            const NeighborLists lists =
                SearchEngine().findNeighbors(view, scene.suggestedRadius, options, report);
            EXPECT_EQ(report.measureSeconds.has_value(), encoding != Encoding::kNone || device[0] == 's');
            ASSERT_EQ(report.measured.attributes.size(), 3u);
            bytes.emplace_back();
            for (const PointAttribute& a : report.measured.attributes)
                bytes.back().append(static_cast<const char*>(a.values.get()),
                                    a.count * attributeBytes(a.type));
            EXPECT_EQ(bytes.back(), bytes.front());
            EXPECT_EQ(lists.counts().size(), view.size());
        }
    }
}

TEST(SearchJob, TellsItsSteps)
{
    class Steps : public Progress {
    public:
        void update(const char* step, double) override
        {
            const std::lock_guard<std::mutex> lock(mutex);
            if (names.empty() || names.back() != step) names.push_back(step);
        }
        std::mutex mutex;
        std::vector<std::string> names;
    } steps;
    const Scene scene = sceneOf("dam_break", 60000);
    const tbb::global_control oneThread(tbb::global_control::max_allowed_parallelism, 1);
    JobOptions options = jobOn("sim", std::uint64_t(1) << 20);
    options.search.progress = &steps;
    JobReport report;
    findNeighbors(viewOf(scene), scene.suggestedRadius, options, report);
    EXPECT_EQ(steps.names, (std::vector<std::string>{"grid", "estimate", "plan", "search"}));
}

TEST(ChooseDevices, ByName)
{
    EXPECT_TRUE(chooseDevices("cpu").devices.empty());
    EXPECT_EQ(chooseDevices("sim").devices.size(), 1u);
    EXPECT_EQ(chooseDevices("sim:16").devices.size(), 16u);
    EXPECT_EQ(chooseDevices("auto").onFailure, DeviceFailure::kUseCpu);
    EXPECT_EQ(chooseDevices("sim").onFailure, DeviceFailure::kStop);
    EXPECT_EQ(chooseDevices("cpu", 8).schedule.cpuTestsPerSecond,
              4 * chooseDevices("cpu", 2).schedule.cpuTestsPerSecond);
    for (const char* name :
         {"", "gpu", "sim:0", "sim:17", "sim:", "sim:2x", "cuda:", "cuda:-1", "cuda:1000", "simulated"}) {
        EXPECT_THROW(chooseDevices(name), InvalidInput) << name;
    }
    EXPECT_EQ(simulatedDevice("gtx780").memoryBytes, std::uint64_t(3) << 30);
    EXPECT_GT(simulatedDevice("h200").rates.testsPerSecond, simulatedDevice("gtx780").rates.testsPerSecond);
    EXPECT_THROW(simulatedDevice("h100"), InvalidInput);
}

} // namespace
} // namespace vdb_nns::testing
