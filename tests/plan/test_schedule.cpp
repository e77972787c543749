// The schedule: every one holds each query once, in blocks that fit, whatever the budget, the devices and the estimate.
#include "plan/block_halo.h"
#include "plan/device_clock.h"
#include "plan/workload_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

// A scene with its grid and estimate.
struct Problem : EstimatedGrid {
    Problem(const char* name, std::uint64_t count) : Problem(std::make_shared<const SceneGrid>(name, count))
    {
    }
    explicit Problem(std::shared_ptr<const SceneGrid> own) : EstimatedGrid(own->grid), scene(std::move(own))
    {
    }

    Schedule schedule(Encoding encoding, const std::vector<DeviceLimits>& devices,
                      const ScheduleOptions& options) const
    {
        std::uint64_t budget = ~0ull;
        for (const DeviceLimits& device : devices) budget = std::min(budget, blockBudget(device));
        return makeSchedule(grid, tree(encoding, budget, options.blockLog2Cells), devices, options);
    }

    std::shared_ptr<const SceneGrid> scene; // the grid's positions
};

const Problem& problemOf(const char* scene)
{
    const std::string name(scene);
    static const Problem kBlock("block", 8000), kClusters("clusters", 6000), kSpray("spray", 4000);
    return name == "block" ? kBlock : name == "clusters" ? kClusters : kSpray;
}

constexpr const char* kScenes[] = {"block", "clusters", "spray"};
constexpr Encoding kEncodings[] = {Encoding::kMask, Encoding::kIndex, Encoding::kNone};
constexpr BoundaryMode kBoundaries[] = {BoundaryMode::kCpu, BoundaryMode::kHalo, BoundaryMode::kAuto};

// Every query once, in the order of the grid; blocks are the leaves they say, or a part of one, with the work of those.
void expectEachQueryOnce(const Schedule& schedule, const Problem& problem)
{
    const SparseGrid& grid = problem.grid;
    std::uint64_t slot = 0;
    Work sum;
    for (const Block& block : schedule.blocks) {
        ASSERT_EQ(block.firstSlot, slot);
        ASSERT_LT(block.firstSlot, block.endSlot);
        slot = block.endSlot;
        ASSERT_LT(block.firstLeaf, block.endLeaf);
        ASSERT_LE(block.endLeaf, grid.leafCount());
        const SparseGrid::Leaf first = grid.leaf(block.firstLeaf), last = grid.leaf(block.endLeaf - 1);
        const std::uint64_t end = last.firstSlot + last.particleCount;
        if (block.firstSlot != first.firstSlot || block.endSlot != end) {
            EXPECT_EQ(block.endLeaf - block.firstLeaf, 1u);
            EXPECT_GE(block.firstSlot, first.firstSlot);
            EXPECT_LE(block.endSlot, end);
        }
        EXPECT_EQ(block.work.particles, block.endSlot - block.firstSlot);
        sum += block.work;
    }
    EXPECT_EQ(slot, grid.particleCount());
    EXPECT_EQ(sum.candidateTests, problem.estimate.total.candidateTests);
    EXPECT_EQ(sum.maskBytes, problem.estimate.total.maskBytes);
    EXPECT_NEAR(sum.expectedPairs, problem.estimate.total.expectedPairs,
                1e-9 * problem.estimate.total.expectedPairs);
}

// Of a block on a device: all of its memory where there is no other.
std::uint64_t budgetOf(const Schedule& schedule, const DeviceLimits& device)
{
    return schedule.inCore && schedule.blocks.size() == 1 ? device.memoryBytes : blockBudget(device);
}

// Blocks of devices fit; what was cut finer than a leaf has a multiple of a warp of queries, and fits if 32 of them do.
void expectBlocksFit(const Schedule& schedule, const Problem& problem,
                     const std::vector<DeviceLimits>& devices)
{
    std::uint64_t least = ~0ull, most = 0, tooLarge = 0;
    for (const DeviceLimits& device : devices) {
        const std::uint64_t budget = budgetOf(schedule, device);
        least = std::min(least, budget);
        most = std::max(most, budget);
    }
    for (const Block& block : schedule.blocks) {
        const SparseGrid::Leaf leaf = problem.grid.leaf(block.firstLeaf);
        const std::uint64_t queries = block.endSlot - block.firstSlot;
        if (block.preferred != Block::kOnCpu) {
            const DeviceLimits& device = devices.at(static_cast<std::size_t>(block.preferred));
            EXPECT_LE(block.bytes.total(), budgetOf(schedule, device));
        }
        if (devices.empty()) continue;
        if (block.bytes.total() > least) {
            EXPECT_TRUE(queries <= 32 || block.bytes.up > least) << "a smaller part would fit";
        }
        if (block.bytes.total() > most) {
            EXPECT_EQ(block.preferred, Block::kOnCpu);
            tooLarge += queries;
        }
        if (block.endLeaf - block.firstLeaf == 1 && block.endSlot != leaf.firstSlot + leaf.particleCount) {
            EXPECT_EQ(queries % 32, 0u);
        }
    }
    EXPECT_EQ(schedule.tooLargeQueries, tooLarge);
}

// A block says what is around it, and its upload holds that wherever a device runs the block alone.
void expectHalos(const Schedule& schedule, const SparseGrid& grid)
{
    using M = MemoryModel;
    for (const Block& block : schedule.blocks) {
        const HaloSize halo = haloOf(grid.data(), block.firstLeaf, block.endLeaf, block.log2Cells).size;
        EXPECT_EQ(block.halo.particles, halo.particles);
        EXPECT_EQ(block.halo.cells, halo.cells);
        EXPECT_EQ(block.halo.leaves, halo.leaves);
        const SparseGrid::Leaf first = grid.leaf(block.firstLeaf), last = grid.leaf(block.endLeaf - 1);
        const std::uint64_t particles = last.firstSlot + last.particleCount - first.firstSlot;
        std::uint64_t cells = 0;
        for (std::uint32_t l = block.firstLeaf; l < block.endLeaf; ++l) {
            for (const std::uint64_t word : grid.leaf(l).occupancy)
                cells += static_cast<std::uint64_t>(__builtin_popcountll(word));
        }
        const std::uint64_t own = particles * M::kParticleBytes + cells * M::kCellBytes +
                                  (block.endLeaf - block.firstLeaf) * M::kLeafBytes + M::kBlockBytes;
        const std::uint64_t around = block.withHalo
                                         ? halo.particles * M::kParticleBytes + halo.cells * M::kCellBytes +
                                               halo.leaves * M::kHaloLeafBytes
                                         : halo.boundaryLeaves * M::kBoundaryLeafBytes;
        EXPECT_EQ(block.bytes.up, (own + around + 15) / 16 * 16);
        if (block.endSlot - block.firstSlot == particles) {
            EXPECT_EQ(block.halo.boundaryQueries, halo.boundaryQueries);
            EXPECT_EQ(block.halo.boundaryLeaves, halo.boundaryLeaves);
        }
    }
}

std::uint64_t boundaryOf(const Block& block)
{
    return block.withHalo ? 0 : block.halo.boundaryQueries;
}

void expectSumsOfPlans(const Schedule& schedule, const Problem& problem,
                       const std::vector<DeviceLimits>& devices)
{
    const std::uint64_t all = problem.grid.particleCount();
    EXPECT_LE(schedule.deviceParticles, all);
    EXPECT_LE(schedule.cpuParticles, all);
    EXPECT_EQ(schedule.deviceParticles + schedule.cpuParticles, all);
    EXPECT_LE(schedule.boundaryLeaves, problem.grid.leafCount());
    ASSERT_EQ(schedule.devices.size(), devices.size());
    std::vector<std::uint64_t> blocks(devices.size()), particles(devices.size());
    int largest = 0;
    for (const Block& block : schedule.blocks) {
        EXPECT_LE(boundaryOf(block), block.work.particles) << "more boundary queries than queries";
        largest = std::max(largest, block.log2Cells);
        if (block.preferred == Block::kOnCpu) continue;
        const auto d = static_cast<std::size_t>(block.preferred);
        blocks.at(d) += 1;
        particles.at(d) += block.work.particles - boundaryOf(block);
    }
    EXPECT_EQ(schedule.largestLog2Cells, largest);
    for (std::size_t d = 0; d < devices.size(); ++d) {
        EXPECT_EQ(schedule.devices[d].blocks, blocks[d]);
        EXPECT_EQ(schedule.devices[d].particles, particles[d]);
        EXPECT_LE(schedule.devices[d].peakBytes, devices[d].memoryBytes);
    }
}

void expectTimes(const Schedule& schedule)
{
    double end = 0;
    for (const Block& block : schedule.blocks) {
        EXPECT_LE(block.startSeconds, block.endSeconds);
        EXPECT_GE(block.startSeconds, 0);
        end = std::max(end, block.endSeconds);
    }
    EXPECT_GE(schedule.predictedSeconds, end);
    EXPECT_GE(schedule.predictedSeconds, schedule.cpuBusySeconds);
    EXPECT_GE(schedule.lowerBoundSeconds, 0);
    EXPECT_GE(schedule.predictedSeconds, schedule.lowerBoundSeconds * (1 - 1e-9));
    // All work one after the other, with room for every block's latency and transfers, is not far from a second.
    EXPECT_LT(schedule.predictedSeconds, 1);
}

void expectSound(const Schedule& schedule, const Problem& problem, const std::vector<DeviceLimits>& devices)
{
    expectEachQueryOnce(schedule, problem);
    if (::testing::Test::HasFatalFailure()) return;
    expectBlocksFit(schedule, problem, devices);
    expectHalos(schedule, problem.grid);
    expectSumsOfPlans(schedule, problem, devices);
    expectTimes(schedule);
    if (!schedule.inCore) return;
    EXPECT_LE(devices.size(), 1u);
    if (!devices.empty() && schedule.boundary == BoundaryMode::kHalo) {
        EXPECT_EQ(schedule.cpuParticles, 0u);
    }
}

std::string nameOf(const char* scene, Encoding encoding, const ScheduleOptions& options)
{
    return std::string(scene) + ", encoding " + std::to_string(static_cast<int>(encoding)) + ", boundary " +
           boundaryModeName(options.boundary) + (options.useCpu ? "" : ", no CPU");
}

// check(name, encoding, options) for scenes, encodings, and who runs the boundary with and without a CPU.
template <typename Check>
void forEachCase(const Check& check)
{
    for (const char* scene : kScenes) {
        for (const Encoding encoding : kEncodings) {
            for (const BoundaryMode boundary : kBoundaries) {
                for (const bool useCpu : {true, false}) {
                    ScheduleOptions options;
                    options.boundary = boundary;
                    options.useCpu = useCpu;
                    SCOPED_TRACE(nameOf(scene, encoding, options));
                    check(problemOf(scene), encoding, options);
                }
            }
        }
    }
}

TEST(Schedule, EveryBudgetTakesEachQueryOnce)
{
    forEachCase([](const Problem& problem, Encoding encoding, const ScheduleOptions& options) {
        const std::uint64_t need = problem.need(encoding);
        for (const double share : {1.0, 0.999, 0.5, 0.1, 0.01}) {
            SCOPED_TRACE(share);
            const std::vector<DeviceLimits> devices{
                deviceOf(static_cast<std::uint64_t>(std::ceil(share * static_cast<double>(need))))};
            const Schedule schedule = problem.schedule(encoding, devices, options);
            EXPECT_EQ(schedule.inCore, share == 1.0);
            EXPECT_NE(schedule.boundary, BoundaryMode::kAuto);
            expectSound(schedule, problem, devices);
        }
    });
}

// The largest leaf as a block of its own.
std::uint64_t largestLeafBytes(const Problem& problem, Encoding encoding)
{
    std::uint64_t most = 0;
    const WorkloadTree tree = problem.tree(encoding, 0);
    for (const WorkloadNode& node : tree.nodes) {
        if (node.log2Cells == 3) most = std::max(most, blockBytes(node, tree.options.model).total());
    }
    return most;
}

TEST(Schedule, LeavesThatDoNotFitAreCut)
{
    for (const char* scene : {"block", "clusters"}) {
        for (const BoundaryMode boundary : kBoundaries) {
            const Problem& problem = problemOf(scene);
            ScheduleOptions options;
            options.boundary = boundary;
            SCOPED_TRACE(nameOf(scene, Encoding::kMask, options));
            const std::uint64_t leaf = largestLeafBytes(problem, Encoding::kMask);
            std::size_t cut = 0;
            for (const double share : {0.9, 0.7, 0.55, 0.4, 0.3, 0.25}) {
                const auto budget = static_cast<std::uint64_t>(share * static_cast<double>(leaf));
                for (const int buffers : {1, 3}) {
                    const std::vector<DeviceLimits> devices{
                        deviceOf(budget * static_cast<std::uint64_t>(buffers), buffers)};
                    const Schedule schedule = problem.schedule(Encoding::kMask, devices, options);
                    expectSound(schedule, problem, devices);
                    for (const Block& block : schedule.blocks) {
                        const std::uint64_t particles = problem.grid.leaf(block.firstLeaf).particleCount;
                        cut += block.endSlot - block.firstSlot < particles;
                    }
                }
            }
            EXPECT_GT(cut, 0u);
        }
    }
}

TEST(Schedule, WhatFitsNoDeviceGoesToTheCpu)
{
    forEachCase([](const Problem& problem, Encoding encoding, const ScheduleOptions& options) {
        for (const std::uint64_t memory : {1, 2, 300, 3000}) {
            const std::vector<DeviceLimits> devices{deviceOf(memory)};
            const Schedule schedule = problem.schedule(encoding, devices, options);
            expectSound(schedule, problem, devices);
            if (memory > 300) continue;
            EXPECT_EQ(schedule.tooLargeQueries, problem.grid.particleCount());
            EXPECT_EQ(schedule.cpuParticles, problem.grid.particleCount());
        }
    });
}

TEST(Schedule, BlocksOfAFixedSizeAreNoLarger)
{
    forEachCase([](const Problem& problem, Encoding encoding, ScheduleOptions options) {
        const std::uint64_t need = problem.need(encoding);
        for (const int log2Cells : {3, 4, 5, 6}) {
            options.blockLog2Cells = log2Cells;
            const std::vector<DeviceLimits> devices{deviceOf(3 * need)};
            const Schedule schedule = problem.schedule(encoding, devices, options);
            expectSound(schedule, problem, devices);
            EXPECT_EQ(schedule.largestLog2Cells, log2Cells);
            EXPECT_EQ(schedule.tooLargeQueries, 0u);
        }
    });
}

TEST(Schedule, TwoDevicesEachFit)
{
    forEachCase([](const Problem& problem, Encoding encoding, const ScheduleOptions& options) {
        const std::uint64_t need = problem.need(encoding);
        for (const std::uint64_t part : {2, 20, 400}) {
            std::vector<DeviceLimits> devices{deviceOf(need / part), deviceOf(need, 2)};
            devices[1].rates.testsPerSecond = 1e9;
            const Schedule schedule = problem.schedule(encoding, devices, options);
            expectSound(schedule, problem, devices);
            std::swap(devices[0], devices[1]);
            expectSound(problem.schedule(encoding, devices, options), problem, devices);
        }
    });
}

TEST(Schedule, SlowAndFastDevicesAndCpus)
{
    forEachCase([](const Problem& problem, Encoding encoding, ScheduleOptions options) {
        const std::uint64_t need = problem.need(encoding);
        for (const double cpu : {1e8, 1e12}) {
            options.cpuTestsPerSecond = cpu;
            for (const double tests : {1e8, 1e12}) {
                for (const double link : {1e8, 1e12}) {
                    SCOPED_TRACE("cpu " + std::to_string(cpu) + " device " + std::to_string(tests) +
                                 " link " + std::to_string(link));
                    std::vector<DeviceLimits> devices{deviceOf(need / 4)};
                    devices[0].rates = {0, tests, link, link};
                    expectSound(problem.schedule(encoding, devices, options), problem, devices);
                }
            }
        }
    });
}

TEST(Schedule, AutoIsWhicheverEndsFirst)
{
    forEachCase([](const Problem& problem, Encoding encoding, ScheduleOptions options) {
        if (options.boundary != BoundaryMode::kAuto) return;
        const std::uint64_t need = problem.need(encoding);
        for (const double uploads : {1e7, 1e12}) {
            for (const double cpu : {1e7, 1e12}) {
                std::vector<DeviceLimits> devices{deviceOf(need / 3)};
                devices[0].rates.uploadBytesPerSecond = uploads;
                options.cpuTestsPerSecond = cpu;
                options.boundary = BoundaryMode::kCpu;
                const double byCpu = problem.schedule(encoding, devices, options).predictedSeconds;
                options.boundary = BoundaryMode::kHalo;
                const double byDevice = problem.schedule(encoding, devices, options).predictedSeconds;
                options.boundary = BoundaryMode::kAuto;
                const Schedule decided = problem.schedule(encoding, devices, options);
                EXPECT_EQ(decided.predictedSeconds, std::min(byCpu, byDevice));
                EXPECT_EQ(decided.boundary, byCpu < byDevice ? BoundaryMode::kCpu : BoundaryMode::kHalo);
            }
        }
    });
}

TEST(Schedule, WithoutADeviceEverythingIsOneBlockOfTheCpu)
{
    forEachCase([](const Problem& problem, Encoding encoding, const ScheduleOptions& options) {
        const Schedule schedule = problem.schedule(encoding, {}, options);
        expectSound(schedule, problem, {});
        ASSERT_EQ(schedule.blocks.size(), 1u);
        EXPECT_EQ(schedule.blocks[0].preferred, Block::kOnCpu);
        EXPECT_TRUE(schedule.inCore);
        EXPECT_EQ(schedule.cpuParticles, problem.grid.particleCount());
        EXPECT_DOUBLE_EQ(schedule.predictedSeconds,
                         static_cast<double>(problem.estimate.total.candidateTests) / 4e9);
    });
}

// What fits is sent in blocks all the same where a device so has all three of its stages at work at once.
TEST(Schedule, InCoreIsInAsManyBlocksAsEndSooner)
{
    const Problem problem("block", 100000); // 27 leaves
    for (const Encoding encoding : kEncodings) {
        std::vector<DeviceLimits> devices{deviceOf(1 << 30, 4)};
        DeviceLimits& device = devices[0];
        // A second for each stage.
        const WorkloadTree one = problem.tree(encoding, ~0ull);
        const BlockBytes bytes = blockBytes(one.nodes[0], one.options.model);
        device.rates = {1e-6, static_cast<double>(problem.estimate.total.candidateTests),
                        static_cast<double>(bytes.up), static_cast<double>(bytes.down)};
        const auto scheduled = [&](bool oneBlock) {
            ScheduleOptions options;
            options.oneBlock = oneBlock;
            const std::uint64_t nodes =
                nodeBytesFor(problem.grid, problem.estimate, one.options.model, devices);
            const Schedule schedule =
                makeSchedule(problem.grid, problem.tree(encoding, nodes), devices, options);
            expectEachQueryOnce(schedule, problem);
            expectBlocksFit(schedule, problem, devices);
            expectHalos(schedule, problem.grid);
            expectSumsOfPlans(schedule, problem, devices);
            EXPECT_TRUE(schedule.inCore);
            EXPECT_EQ(schedule.cpuParticles, 0u);
            return schedule;
        };
        EXPECT_EQ(scheduled(true).blocks.size(), 1u);
        EXPECT_NEAR(scheduled(true).predictedSeconds, 3, 1e-5);
        EXPECT_GE(scheduled(false).blocks.size(), 16u) << "four for each slot";
        EXPECT_LT(scheduled(false).predictedSeconds, 2.5);
        device.rates.latencySeconds = 0.1;
        EXPECT_EQ(scheduled(false).blocks.size(), 1u) << "more would take longer";
        device.rates.latencySeconds = 1;
        EXPECT_EQ(nodeBytesFor(problem.grid, problem.estimate, one.options.model, devices),
                  device.memoryBytes)
            << "no tree needs to be divided to know that";
        device.rates.latencySeconds = 1e-6;
        device.buffers = 1;
        EXPECT_EQ(scheduled(false).blocks.size(), 1u) << "nothing could overlap";
    }
}

TEST(Schedule, WithoutTheCpuOnlyTheBoundaryAndWhatFitsNowhereIsLeftToIt)
{
    for (const char* scene : kScenes) {
        const Problem& problem = problemOf(scene);
        ScheduleOptions options;
        options.useCpu = false;
        options.boundary = BoundaryMode::kHalo;
        options.cpuTestsPerSecond = 1e15;
        const std::vector<DeviceLimits> devices{deviceOf(problem.need(Encoding::kMask) / 3)};
        const Schedule schedule = problem.schedule(Encoding::kMask, devices, options);
        expectSound(schedule, problem, devices);
        EXPECT_EQ(schedule.cpuParticles, schedule.tooLargeQueries);
        options.useCpu = true;
        EXPECT_GT(problem.schedule(Encoding::kMask, devices, options).cpuParticles, schedule.cpuParticles);
    }
}

bool isSame(const Block& a, const Block& b)
{
    return a.firstSlot == b.firstSlot && a.endSlot == b.endSlot && a.firstLeaf == b.firstLeaf &&
           a.endLeaf == b.endLeaf && a.origin == b.origin && a.log2Cells == b.log2Cells &&
           a.bytes.up == b.bytes.up && a.bytes.down == b.bytes.down && a.preferred == b.preferred &&
           a.startSeconds == b.startSeconds && a.endSeconds == b.endSeconds && a.withHalo == b.withHalo;
}

TEST(Schedule, TheSameArgumentsGiveTheSameSchedule)
{
    const Problem& problem = problemOf("clusters");
    const std::vector<DeviceLimits> devices{deviceOf(problem.need(Encoding::kIndex) / 20),
                                            deviceOf(problem.need(Encoding::kIndex) / 7)};
    const WorkloadTree tree = problem.tree(Encoding::kIndex, blockBudget(devices[0]));
    const Schedule first = makeSchedule(problem.grid, tree, devices);
    for (const int threads : {1, 2, 4}) {
        Schedule again;
        runOnThreads(threads, [&] { again = makeSchedule(problem.grid, tree, devices); });
        ASSERT_EQ(again.blocks.size(), first.blocks.size());
        for (std::size_t b = 0; b < first.blocks.size(); ++b) {
            EXPECT_TRUE(isSame(again.blocks[b], first.blocks[b])) << b;
        }
        EXPECT_EQ(again.predictedSeconds, first.predictedSeconds);
        EXPECT_EQ(again.lowerBoundSeconds, first.lowerBoundSeconds);
        EXPECT_EQ(again.deviceParticles, first.deviceParticles);
        EXPECT_EQ(again.boundary, first.boundary);
    }
}

TEST(Schedule, AnEstimateThatLiesStillTakesEachQueryOnce)
{
    for (const double pairs : {0.0, 1.0, 1e9, 1e18, 1e300}) {
        for (const BoundaryMode boundary : kBoundaries) {
            SCOPED_TRACE(std::to_string(pairs) + " pairs a leaf, boundary " + boundaryModeName(boundary));
            Problem problem = problemOf("clusters");
            for (Work& leaf : problem.estimate.leaves) leaf.expectedPairs = pairs;
            problem.estimate.total.expectedPairs = pairs * static_cast<double>(problem.grid.leafCount());
            ScheduleOptions options;
            options.boundary = boundary;
            const std::vector<DeviceLimits> devices{deviceOf(1 << 20)};
            const Schedule schedule = problem.schedule(Encoding::kIndex, devices, options);
            expectSound(schedule, problem, devices);
            if (pairs > 1e15) {
                EXPECT_FALSE(schedule.inCore);
                EXPECT_EQ(schedule.tooLargeQueries, problem.grid.particleCount());
            }
        }
    }
}

TEST(Schedule, EveryDistributionTakesEachQueryOnce)
{
    forEachGrid([](const PointSet&, const SparseGrid& grid) {
        if (grid.reach() == 2) return;
        WorkEstimate estimate = estimateWork(grid);
        const WorkloadTree tree = treeOf(grid, estimate, 0); // further than any of these budgets asks for
        const std::uint64_t need = blockBytes(tree.nodes[0], tree.options.model).total();
        for (const std::uint64_t memory : {need, need / 2 + 1, need / 20 + 1}) {
            for (const BoundaryMode boundary : kBoundaries) {
                ScheduleOptions options;
                options.boundary = boundary;
                const Schedule schedule = makeSchedule(grid, tree, {deviceOf(memory)}, options);
                std::uint64_t slot = 0;
                for (const Block& block : schedule.blocks) {
                    EXPECT_EQ(block.firstSlot, slot);
                    slot = block.endSlot;
                    EXPECT_LE(boundaryOf(block), block.work.particles);
                }
                EXPECT_EQ(slot, grid.particleCount());
                expectHalos(schedule, grid);
                EXPECT_LE(schedule.deviceParticles, grid.particleCount());
                EXPECT_EQ(schedule.deviceParticles + schedule.cpuParticles, grid.particleCount());
            }
        }
    });
}

TEST(Schedule, AnEmptyGridHasNoBlocks)
{
    const SparseGrid grid;
    for (const std::uint64_t nodeBytes : {0, 1000}) {
        const WorkloadTree tree = treeOf(grid, estimateWork(grid), nodeBytes);
        EXPECT_EQ(tree.nodes.size(), 1u);
        for (const auto& devices :
             {std::vector<DeviceLimits>{}, {deviceOf(1)}, {deviceOf(9), deviceOf(1 << 20)}}) {
            for (const int blockLog2Cells : {0, 4}) {
                ScheduleOptions options;
                options.blockLog2Cells = blockLog2Cells;
                const Schedule schedule = makeSchedule(grid, tree, devices, options);
                EXPECT_TRUE(schedule.blocks.empty());
                EXPECT_EQ(schedule.predictedSeconds, 0);
                EXPECT_EQ(schedule.devices.size(), devices.size());
            }
        }
    }
}

TEST(Schedule, BadLimitsAreRefused)
{
    const Problem& problem = problemOf("spray");
    const WorkloadTree tree = problem.tree(Encoding::kMask, 0);
    const auto expectRefused = [&](const DeviceLimits& device, const ScheduleOptions& options = {}) {
        EXPECT_THROW(makeSchedule(problem.grid, tree, {deviceOf(1 << 20), device}, options), InvalidInput);
    };
    expectRefused(deviceOf(0));
    expectRefused(deviceOf(1 << 20, 0));
    expectRefused(deviceOf(1 << 20, -1));
    for (const double rate : {0.0, -1.0, kNan, kInf}) {
        DeviceLimits device = deviceOf(1 << 20);
        device.rates.testsPerSecond = rate;
        expectRefused(device);
        device.rates = {0, 1, rate, 1};
        expectRefused(device);
        device.rates = {0, 1, 1, rate};
        expectRefused(device);
        ScheduleOptions options;
        options.cpuTestsPerSecond = rate;
        expectRefused(deviceOf(1 << 20), options);
    }
    for (const double latency : {-1.0, kNan, kInf}) {
        DeviceLimits device = deviceOf(1 << 20);
        device.rates.latencySeconds = latency;
        expectRefused(device);
    }
    for (const int log2Cells : {-1, 1, 2}) {
        ScheduleOptions options;
        options.blockLog2Cells = log2Cells;
        expectRefused(deviceOf(1 << 20), options);
    }
    for (const int unknown : {-1, 3, 77}) {
        ScheduleOptions options;
        options.boundary = static_cast<BoundaryMode>(unknown);
        expectRefused(deviceOf(1 << 20), options);
        DeviceLimits device = deviceOf(1 << 20);
        device.kind = static_cast<DeviceKind>(unknown);
        expectRefused(device);
    }
}

TEST(Schedule, ATreeThatIsDividedFurtherCutsNoLeafThatFits)
{
    for (const char* scene : kScenes) {
        const Problem& problem = problemOf(scene);
        const WorkloadTree tree = problem.tree(Encoding::kMask, 0);
        const std::vector<DeviceLimits> devices{deviceOf(6 * largestLeafBytes(problem, Encoding::kMask))};
        for (const BoundaryMode boundary : kBoundaries) {
            ScheduleOptions options;
            options.boundary = boundary;
            const Schedule schedule = makeSchedule(problem.grid, tree, devices, options);
            EXPECT_LE(schedule.blocks.size(), problem.grid.leafCount()) << scene;
        }
    }
}

TEST(Schedule, ATreeThatIsNotDividedFarEnoughIsRefused)
{
    const Problem& problem = problemOf("spray");
    const WorkloadTree tree = problem.tree(Encoding::kMask, ~0ull);
    EXPECT_THROW(makeSchedule(problem.grid, tree, {deviceOf(1000)}), InvalidInput);
}

TEST(Schedule, ATreeOfAnotherGridIsRefused)
{
    const Problem& problem = problemOf("spray");
    const WorkloadTree tree = problem.tree(Encoding::kMask, 0);
    for (const std::uint64_t memory : {1000, 1 << 30}) {
        EXPECT_THROW(makeSchedule(SparseGrid(), tree, {deviceOf(memory)}), InvalidInput);
        EXPECT_THROW(makeSchedule(problemOf("block").grid, tree, {deviceOf(memory)}), InvalidInput);
        EXPECT_THROW(makeSchedule(problem.grid, WorkloadTree(), {deviceOf(memory)}), InvalidInput);
    }
}

TEST(Schedule, ABudgetIsTheMemorySharedByTheSlots)
{
    EXPECT_EQ(blockBudget(deviceOf(1000, 3)), 333u);
    EXPECT_EQ(blockBudget(deviceOf(1000, 1)), 1000u);
    EXPECT_EQ(blockBudget(deviceOf(2, 3)), 0u);
}

// ---- the clock of a device ----------------------------------------------------------------------------------------

// 10 tests, 4 bytes up and 2 bytes down a second; a search begins 1 s late.
constexpr Rates kSlow{1, 10, 4, 2};

void expectRun(DeviceClock& clock, std::uint64_t tests, std::uint64_t up, std::uint64_t down, double start,
               double end)
{
    EXPECT_FALSE(clock.full());
    EXPECT_EQ(clock.ready(), start);
    EXPECT_EQ(clock.begin(tests, up), start);
    EXPECT_EQ(clock.finish(down), end);
    EXPECT_EQ(clock.done(), end);
}

TEST(DeviceClock, ThreeSlotsOverlap)
{
    DeviceClock clock(kSlow, 3);
    EXPECT_EQ(clock.done(), 0);
    expectRun(clock, 30, 8, 6, 0, 9);   // up 0..2, search 2..6, down 6..9
    expectRun(clock, 10, 4, 10, 2, 14); // up 2..3, search 6..8, down 9..14
    expectRun(clock, 90, 4, 2, 3, 19);  // up 3..4, search 8..18, down 18..19
    expectRun(clock, 0, 20, 4, 9, 21);  // the first slot is free at 9: up 9..14, search 18..19, down 19..21
    expectRun(clock, 20, 4, 0, 14, 22); // the second at 14: up 14..15, search 19..22
    EXPECT_EQ(clock.searchSeconds(), 4 + 2 + 10 + 1 + 3);
}

// A block may be begun before the one before it is downloaded: times are the same.
TEST(DeviceClock, BlocksMayBeFinishedLater)
{
    DeviceClock clock(kSlow, 2);
    EXPECT_EQ(clock.begin(30, 8), 0);
    EXPECT_EQ(clock.begin(10, 4), 2);
    EXPECT_TRUE(clock.full());
    EXPECT_EQ(clock.finish(6), 9);
    EXPECT_FALSE(clock.full());
    EXPECT_EQ(clock.ready(), 9); // the first slot
    EXPECT_EQ(clock.begin(90, 4), 9);
    EXPECT_EQ(clock.finish(10), 14);
    EXPECT_EQ(clock.finish(2), 21); // up 9..10, search 10..20
}

TEST(DeviceClock, OneSlotDoesOneThingAtATime)
{
    DeviceClock clock(kSlow, 1);
    expectRun(clock, 30, 8, 6, 0, 9);
    expectRun(clock, 10, 4, 10, 9, 17); // up 9..10, search 10..12, down 12..17
    expectRun(clock, 0, 0, 0, 17, 18);
    EXPECT_EQ(clock.searchSeconds(), 4 + 2 + 1);
}

// Index lists of fewer neighbors take less room: what needed several blocks fits at once. Masks take the same.
TEST(Schedule, FollowsASmallerRadius)
{
    Problem problem("block", 8000);
    EstimateOptions options;
    options.radius = 0.5 * problem.grid.radius();
    Problem smaller(problem.scene);
    smaller.estimate = estimateWork(smaller.grid, options);
    const std::vector<DeviceLimits> device = {deviceOf(problem.need(Encoding::kIndex) / 2)};
    const Schedule several = problem.schedule(Encoding::kIndex, device, {});
    const Schedule one = smaller.schedule(Encoding::kIndex, device, {});
    EXPECT_FALSE(several.inCore);
    EXPECT_GT(several.blocks.size(), 1u);
    EXPECT_TRUE(one.inCore);
    EXPECT_LT(one.blocks[0].work.expectedPairs, 0.3 * problem.estimate.total.expectedPairs);
    EXPECT_EQ(smaller.need(Encoding::kMask), problem.need(Encoding::kMask));
}

} // namespace

} // namespace vdb_nns::testing
