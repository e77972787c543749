// Searching on CUDA devices gives the oracle's lists, and the plain search's in the same order, on every distribution, under any
// budget and whoever runs the boundary. Compiled twice: with the emulated device layer, which runs everywhere, and as it
// is, for a real device: then tests are skipped where there is none, or fail if VDB_NNS_REQUIRE_GPU=1.
#include "plan/workload_cases.h"
#include "support/comparator.h"
#include "vdb_nns/error.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/planning/executor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#if defined(VDB_NNS_EMULATED)
#include <cuda_runtime_api.h>
#endif

namespace vdb_nns::testing {

namespace {

const char* nameOf(Encoding encoding)
{
    return encoding == Encoding::kMask ? "mask" : encoding == Encoding::kIndex ? "index" : "none";
}

constexpr Encoding kEncodings[] = {Encoding::kMask, Encoding::kIndex, Encoding::kNone};

#if defined(VDB_NNS_EMULATED)
constexpr std::uint64_t kDeviceBytes = std::uint64_t(1) << 30;
constexpr std::uint64_t kUsualScale = 1;
#else
constexpr std::uint64_t kUsualScale = 100;
#endif

// Of the scenes: tools that watch every access want smaller ones.
std::uint64_t scale()
{
    const char* const asked = std::getenv("VDB_NNS_GPU_SCALE");
    return asked ? std::max<std::uint64_t>(1, std::strtoull(asked, nullptr, 10)) : kUsualScale;
}

class CudaSearch : public ::testing::TestWithParam<int> {
protected:
    void SetUp() override
    {
#if defined(VDB_NNS_EMULATED)
        simt::resetMachine({kDeviceBytes, kDeviceBytes}, static_cast<std::uint64_t>(GetParam()));
#endif
        try {
            mDevices = cudaDevices();
        } catch (const DeviceError& error) {
            const char* const required = std::getenv("VDB_NNS_REQUIRE_GPU");
            if (required && std::string(required) == "1") FAIL() << error.what();
            GTEST_SKIP() << error.what();
        }
    }

    void TearDown() override
    {
#if defined(VDB_NNS_EMULATED)
        EXPECT_EQ(simt::liveAllocations(), 0u);
#endif
    }

    std::vector<DeviceLimits> devicesOf(std::uint64_t memoryBytes, std::size_t count = 1) const
    {
        std::vector<DeviceLimits> devices;
        for (std::size_t d = 0; d < count; ++d) {
            devices.push_back(mDevices[d % mDevices.size()]);
            devices.back().memoryBytes = memoryBytes;
        }
        return devices;
    }

    std::vector<DeviceLimits> mDevices;
};

Schedule scheduleOf(const EstimatedGrid& problem, Encoding encoding, const std::vector<DeviceLimits>& devices,
                    const ScheduleOptions& options)
{
    const WorkloadTree one = problem.tree(encoding, ~0ull);
    const std::uint64_t bytes =
        nodeBytesFor(problem.grid, problem.estimate, one.options.model, devices, options);
    return makeSchedule(problem.grid, problem.tree(encoding, bytes, options.blockLog2Cells), devices,
                        options);
}

NeighborLists searchOn(const EstimatedGrid& problem, Encoding encoding,
                       const std::vector<DeviceLimits>& devices, const RunOptions& run, ScheduleRun& report)
{
    const Schedule schedule = scheduleOf(problem, encoding, devices, run.schedule);
    const NeighborLists lists = SearchEngine().search(problem.grid, schedule, devices, run, report);
    for (std::size_t d = 0; d < devices.size(); ++d) {
        EXPECT_EQ(report.devices[d].failure, "");
        EXPECT_LE(report.devices[d].peakBytes, devices[d].memoryBytes);
    }
    return lists;
}

NeighborLists plainLists(const SparseGrid& grid, Encoding encoding)
{
    SearchOptions options;
    options.encoding = encoding;
    return SearchEngine().search(grid, options);
}

TEST_P(CudaSearch, EveryDistributionGivesTheOraclesLists)
{
    for (const PointSet& set : arraySets(Precision::kDouble, 6)) {
        const SetView input(set, Form::kDoubles);
        const Lists oracle = oracleLists(set);
        for (int reach = 1; reach <= 3; ++reach) {
            const EstimatedGrid problem(gridOf(input.view(), set.radius, reach));
            if (problem.grid.empty()) continue;
            for (const Encoding encoding : kEncodings) {
                for (const double share : {1.0, 0.25}) {
                    SCOPED_TRACE(set.name + ", reach " + std::to_string(reach) + ", " + nameOf(encoding) +
                                 ", " + std::to_string(share));
                    const auto need = static_cast<double>(problem.need(encoding));
                    RunOptions run;
                    run.schedule.useCpu = false;
                    run.schedule.boundary = reach == 2 ? BoundaryMode::kCpu : BoundaryMode::kHalo;
                    ScheduleRun report;
                    const NeighborLists lists =
                        searchOn(problem, encoding,
                                 devicesOf(static_cast<std::uint64_t>(share * need) + 8000), run, report);
                    ASSERT_TRUE(sameCounts(lists.counts(), oracle));
                    if (encoding != Encoding::kNone) {
                        ASSERT_TRUE(sameLists(lists, oracle, set));
                    }
                    expectSameLists(lists, plainLists(problem.grid, encoding));
                    if (share == 1) {
                        EXPECT_GT(report.devices[0].particles, 0u);
                    }
                }
            }
        }
    }
}

TEST_P(CudaSearch, AnyBudgetBoundaryAndBlockSizeGiveTheSameLists)
{
    for (const char* name : {"block", "clusters", "spray", "sheet"}) {
        const SceneGrid scene(name, 3000 * scale());
        const EstimatedGrid problem(scene.grid);
        for (const Encoding encoding : kEncodings) {
            const NeighborLists truth = plainLists(problem.grid, encoding);
            for (const BoundaryMode boundary :
                 {BoundaryMode::kCpu, BoundaryMode::kHalo, BoundaryMode::kAuto}) {
                for (const std::uint64_t divisor : {1u, 4u, 30u}) {
                    for (const int log2 : {0, 4}) {
                        SCOPED_TRACE(std::string(name) + " " + nameOf(encoding) + " " +
                                     boundaryModeName(boundary) + " /" + std::to_string(divisor) + " 2^" +
                                     std::to_string(log2));
                        RunOptions run;
                        run.schedule.boundary = boundary;
                        run.schedule.blockLog2Cells = log2;
                        ScheduleRun report;
                        const auto devices =
                            devicesOf(problem.need(encoding) / divisor, divisor == 4 ? 2 : 1);
                        expectSameLists(searchOn(problem, encoding, devices, run, report), truth);
                    }
                }
            }
        }
    }
}

// Measures of rows that devices found, summed up on the host.
TEST_P(CudaSearch, MeasuresOfItsListsAreThoseOfASearch)
{
    const std::vector<std::string> names = {"count", "density", "nearest", "normal", "pca", "cluster"};
    const auto bytesOf = [](const Measured& measured) {
        std::string bytes;
        for (const PointAttribute& a : measured.values.attributes)
            bytes.append(static_cast<const char*>(a.values.get()), a.count * attributeBytes(a.type));
        return bytes;
    };
    const SceneGrid scene("dam_break", 5000 * scale());
    const EstimatedGrid problem(scene.grid);
    const std::string expected = bytesOf(SearchEngine().measure(scene.grid, names, {}));
    for (const Encoding encoding : {Encoding::kMask, Encoding::kIndex}) {
        for (const std::uint64_t divisor : {1u, 6u}) {
            RunOptions run;
            run.schedule.useCpu = false;
            ScheduleRun report;
            const NeighborLists lists =
                searchOn(problem, encoding, devicesOf(problem.need(encoding) / divisor), run, report);
            EXPECT_GT(report.devices[0].particles, 0u);
            EXPECT_TRUE(bytesOf(SearchEngine().measure(lists, names, {})) == expected)
                << nameOf(encoding) << " /" << divisor;
        }
    }
}

// Everything fits, and goes in blocks that are sent and searched side by side.
TEST_P(CudaSearch, InCoreInSeveralBlocksGivesTheSameLists)
{
    const SceneGrid scene("block", 12000 * scale());
    const EstimatedGrid problem(scene.grid);
    for (const Encoding encoding : kEncodings) {
        SCOPED_TRACE(nameOf(encoding));
        std::vector<DeviceLimits> devices = devicesOf(3 * problem.need(encoding));
        devices[0].rates.latencySeconds = 0;
        ScheduleRun report;
        const NeighborLists lists = searchOn(problem, encoding, devices, {}, report);
        expectSameLists(lists, plainLists(problem.grid, encoding));
        EXPECT_GT(report.devices[0].blocks, 1u);
        EXPECT_EQ(report.devices[0].particles, problem.grid.particleCount());
        EXPECT_EQ(report.halvings, 0u);
    }
}

// All pairs of a lattice at its radius are in the error band: the list of undecided pairs overflows, and blocks are redone.
TEST_P(CudaSearch, ALatticeIsDecidedByTheHost)
{
    SceneOptions options;
    options.name = "lattice";
    options.count = 4096 * scale();
    const Scene scene = makeScene(options);
    const EstimatedGrid problem(
        gridOf(ParticleView::fromArray(scene.positions.data(), options.count), scene.suggestedRadius, 1));
    for (const Encoding encoding : kEncodings) {
        for (const std::uint64_t divisor : {1u, 6u}) {
            SCOPED_TRACE(std::string(nameOf(encoding)) + " /" + std::to_string(divisor));
            RunOptions run;
            run.schedule.useCpu = false;
            run.schedule.boundary = BoundaryMode::kHalo;
            ScheduleRun report;
            expectSameLists(
                searchOn(problem, encoding, devicesOf(problem.need(encoding) / divisor), run, report),
                plainLists(problem.grid, encoding));
            if (divisor == 1) {
                EXPECT_GT(report.overflows, 0u);
            }
        }
    }
}

TEST_P(CudaSearch, RowsThatFindNoRoomAreRedone)
{
    const SceneGrid scene("clusters", 3000 * scale());
    EstimatedGrid problem(scene.grid);
    for (Work& leaf : problem.estimate.leaves) leaf.expectedPairs *= 0.3;
    problem.estimate.total.expectedPairs *= 0.3;
    RunOptions run;
    run.schedule.useCpu = false;
    run.schedule.boundary = BoundaryMode::kHalo;
    ScheduleRun report;
    expectSameLists(
        searchOn(problem, Encoding::kIndex, devicesOf(problem.need(Encoding::kIndex) / 3), run, report),
        plainLists(problem.grid, Encoding::kIndex));
    EXPECT_GT(report.overflows, 0u);
}

TEST_P(CudaSearch, MappedMemoryGivesTheSameLists)
{
    const SceneGrid scene("spray", 3000 * scale());
    const EstimatedGrid problem(scene.grid);
    for (const Encoding encoding : kEncodings) {
        std::vector<DeviceLimits> devices = devicesOf(problem.need(encoding));
        devices[0].mapped = true;
        ScheduleRun report;
        expectSameLists(searchOn(problem, encoding, devices, {}, report), plainLists(problem.grid, encoding));
    }
}

TEST_P(CudaSearch, ASmallerRadiusThanTheLatticesGivesItsLists)
{
    const SceneGrid scene("clusters", 3000 * scale());
    const EstimatedGrid problem(scene.grid);
    for (const double share : {0.7, 0.1}) {
        RunOptions run;
        run.search.radius = share * scene.grid.radius();
        run.schedule.useCpu = false;
        for (const Encoding encoding : kEncodings) {
            SCOPED_TRACE(nameOf(encoding));
            run.search.encoding = encoding;
            ScheduleRun report;
            const NeighborLists lists =
                searchOn(problem, encoding, devicesOf(problem.need(encoding) / 2), run, report);
            expectSameLists(lists, SearchEngine().search(problem.grid, run.search));
            EXPECT_EQ(lists.radius(), run.search.radius);
            EXPECT_GT(report.devices[0].particles, 0u);
        }
    }
}

#if defined(VDB_NNS_EMULATED)
#if defined(SIMT_ASAN) // four times as slow
INSTANTIATE_TEST_SUITE_P(Seeds, CudaSearch, ::testing::Values(3));
#else
INSTANTIATE_TEST_SUITE_P(Seeds, CudaSearch, ::testing::Values(1, 2));
#endif
#else
INSTANTIATE_TEST_SUITE_P(Device, CudaSearch, ::testing::Values(0));
#endif

} // namespace

} // namespace vdb_nns::testing
