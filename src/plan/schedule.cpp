// Three steps, each a function: cut the tree into blocks; hand them out in predicted time; with
// BoundaryMode::kAuto do both for either mode and take what ends first.
#include "vdb_nns/planning/schedule.h"

#include "lists/cell_candidates.h"
#include "plan/dispatcher.h"
#include "util/known_value.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

namespace vdb_nns {

namespace {

void check(const std::vector<DeviceLimits>& devices, const ScheduleOptions& options)
{
    requireKnown(options.boundary, BoundaryMode::kAuto, "boundary mode");
    const auto isSpeed = [](double rate) { return rate > 0 && std::isfinite(rate); };
    for (const DeviceLimits& device : devices) {
        requireKnown(device.kind, DeviceKind::kSim, "kind of device");
        const std::string name = "device '" + device.name + "' ";
        if (device.memoryBytes == 0) throw InvalidInput(name + "has no memory: allow it some");
        if (device.buffers < 1) {
            throw InvalidInput(name + "has " + std::to_string(device.buffers) +
                               " buffers: it needs one at least");
        }
        const Rates& rates = device.rates;
        if (!isSpeed(rates.testsPerSecond) || !isSpeed(rates.uploadBytesPerSecond) ||
            !isSpeed(rates.downloadBytesPerSecond) ||
            !(rates.latencySeconds >= 0 && std::isfinite(rates.latencySeconds))) {
            throw InvalidInput(name + "needs rates above 0 and a latency of 0 or more");
        }
    }
    if (!isSpeed(options.cpuTestsPerSecond)) throw InvalidInput("the CPU needs a rate of tests above 0");
    if (options.blockLog2Cells != 0 && options.blockLog2Cells < 3) {
        throw InvalidInput("a block of 2^" + std::to_string(options.blockLog2Cells) +
                           " cells is less than a leaf: use 2^3 or more");
    }
}

Block blockOf(const WorkloadNode& node, const SparseGridData& grid, const MemoryModel& model, bool withHalo)
{
    Block block;
    block.origin = node.origin;
    block.log2Cells = node.log2Cells;
    block.firstLeaf = node.firstLeaf;
    block.endLeaf = node.endLeaf;
    block.firstSlot = grid.leaves[node.firstLeaf].firstSlot;
    block.endSlot = grid.leaves[node.endLeaf].firstSlot;
    block.work = node.work;
    block.halo = node.halo;
    block.withHalo = withHalo;
    block.bytes = blockBytes(node, model, withHalo);
    return block;
}

// Cuts the tree from the top into blocks of at most `budget` bytes.
class Cutter {
public:
    Cutter(const SparseGridData& grid, const WorkloadTree& tree, std::uint64_t budget, int blockLog2Cells,
           bool withHalo)
        : mGrid(grid),
          mTree(tree),
          mBudget(budget),
          mNodeBudget(std::min(budget, tree.options.nodeBytes)),
          mBlockLog2Cells(blockLog2Cells),
          mWithHalo(withHalo)
    {
    }

    std::vector<Block> cut()
    {
        if (mGrid.leafCount() > 0) cut(mTree.nodes[0]);
        return std::move(mBlocks);
    }

private:
    void cut(const WorkloadNode& node)
    {
        const Block block = blockOf(node, mGrid, mTree.options.model, mWithHalo);
        const bool isSmall = mBlockLog2Cells == 0 || node.log2Cells <= mBlockLog2Cells;
        // What was divided has no halo where it was larger than the tree's nodeBytes, and is no block.
        if (isSmall && block.bytes.total() <= (node.childCount > 0 ? mNodeBudget : mBudget)) {
            mBlocks.push_back(block);
        } else if (node.childCount > 0) {
            for (std::uint32_t c = 0; c < node.childCount; ++c) cut(mTree.nodes[node.firstChild + c]);
        } else if (node.endLeaf - node.firstLeaf > 1) {
            throw InvalidInput("the workload tree is not divided as far as a budget of " +
                               std::to_string(mBudget) +
                               " bytes or the block size needs: build it for those");
        } else {
            cutLeaf(node);
        }
    }

    // Ranges of the queries of a leaf, as many as fit beside its candidates, which are the leaf's and its halo's in either mode.
    void cutLeaf(const WorkloadNode& node)
    {
        const Block leaf = blockOf(node, mGrid, mTree.options.model, true);
        if (leaf.bytes.up > mBudget) return mBlocks.push_back(leaf); // no part of it fits
        LeafNeighborhood neighborhood;
        mGrid.topology.neighborhoods({&mGrid.leafOrigins[leaf.firstLeaf], 1}, &neighborhood);
        const double pairsPerQuery = leaf.work.expectedPairs / static_cast<double>(leaf.work.particles);
        Block part = leaf;
        const auto bytesOf = [&](const Work& work) {
            WorkloadNode sized;
            sized.endLeaf = 1;
            sized.work = work;
            BlockBytes bytes = blockBytes(sized, mTree.options.model);
            bytes.up = leaf.bytes.up;
            return bytes;
        };
        const auto end = [&] {
            part.bytes = bytesOf(part.work);
            // The halo is the whole leaf's; its boundary region is not a part's.
            if (part.work.particles < node.work.particles)
                part.halo.boundaryQueries = part.halo.boundaryLeaves = 0;
            mBlocks.push_back(part);
            part.firstSlot = part.endSlot;
            part.work = {};
        };
        part.endSlot = part.firstSlot;
        part.work = {};
        Work warp; // the next queries, not yet in the part
        const auto addWarp = [&] {
            Work sum = part.work;
            sum += warp;
            if (part.work.particles > 0 && bytesOf(sum).total() > mBudget) {
                end();
                sum = warp;
            }
            part.work = sum;
            part.endSlot += warp.particles;
            warp = {};
        };
        forEachOccupiedCell(blockViewOf(mGrid), leaf.firstLeaf, neighborhood, [&](const OccupiedCell& cell) {
            for (std::uint64_t left = cell.end - cell.begin; left > 0;) {
                const std::uint64_t queries = std::min(left, Block::kFewestQueries - warp.particles);
                warp += {queries, pairsPerQuery * static_cast<double>(queries), queries * cell.candidates,
                         queries * cell.rowWords() * sizeof(std::uint32_t)};
                left -= queries;
                if (warp.particles == Block::kFewestQueries) addWarp();
            }
        });
        if (warp.particles > 0) addWarp();
        end();
    }

    const SparseGridData& mGrid;
    const WorkloadTree& mTree;
    std::uint64_t mBudget, mNodeBudget;
    int mBlockLog2Cells;
    bool mWithHalo;
    std::vector<Block> mBlocks;
};

// Hands blocks out in predicted time.
void handOut(const std::vector<DeviceLimits>& devices, const std::vector<std::uint64_t>& budgets,
             const ScheduleOptions& options, Schedule& schedule)
{
    schedule.devices.assign(devices.size(), {});
    Dispatcher dispatcher(devices, budgets, options);
    double testsPerSecond = options.cpuTestsPerSecond;
    for (const DeviceLimits& device : devices) testsPerSecond += device.rates.testsPerSecond;
    std::uint64_t tests = 0;
    std::vector<Dispatcher::Item> items;
    for (std::size_t b = 0; b < schedule.blocks.size(); ++b) {
        Block& block = schedule.blocks[b];
        tests += block.work.candidateTests;
        if (block.bytes.total() <= dispatcher.mostBytes()) {
            items.push_back({b, block.work.candidateTests, boundaryTests(block), block.bytes});
            continue;
        }
        if (!devices.empty()) schedule.tooLargeQueries += block.work.particles;
        block.startSeconds = dispatcher.cpuSeconds();
        block.endSeconds = dispatcher.addCpuTests(block.work.candidateTests);
        schedule.cpuParticles += block.work.particles;
    }
    schedule.lowerBoundSeconds = static_cast<double>(tests) / testsPerSecond;
    dispatcher.setItems(std::move(items));
    while (const std::optional<Dispatcher::Turn> turn = dispatcher.next()) {
        Block& block = schedule.blocks[turn->block];
        block.preferred = turn->executor;
        block.startSeconds = turn->startSeconds;
        if (turn->executor == Block::kOnCpu) {
            block.endSeconds = turn->endSeconds;
            schedule.cpuParticles += block.work.particles;
            continue;
        }
        block.endSeconds = dispatcher.finish(turn->executor, block.bytes.down);
        const auto d = static_cast<std::size_t>(turn->executor);
        const std::uint64_t boundary = block.withHalo ? 0 : block.halo.boundaryQueries;
        DevicePlan& device = schedule.devices[d];
        schedule.deviceParticles += block.work.particles - boundary;
        schedule.cpuParticles += boundary;
        schedule.boundaryLeaves += block.withHalo ? 0 : block.halo.boundaryLeaves;
        device.blocks += 1;
        device.particles += block.work.particles - boundary;
        // A buffer is as large as the largest block, so that any of them may hold any block.
        device.peakBytes = std::max(device.peakBytes, block.bytes.total());
    }
    schedule.cpuBusySeconds = dispatcher.cpuSeconds();
    schedule.predictedSeconds = dispatcher.doneSeconds();
    for (std::size_t d = 0; d < devices.size(); ++d) {
        DevicePlan& device = schedule.devices[d];
        device.busySeconds = dispatcher.deviceSeconds(static_cast<int>(d));
        device.peakBytes *= std::min(device.blocks, static_cast<std::uint64_t>(devices[d].buffers));
    }
}

// Cut into blocks for the buffers of the devices.
Schedule scheduleWith(const SparseGridData& grid, const WorkloadTree& tree,
                      const std::vector<DeviceLimits>& devices, const ScheduleOptions& options,
                      BoundaryMode boundary, bool inCore)
{
    Schedule schedule;
    schedule.boundary = boundary;
    schedule.model = tree.options.model;
    schedule.inCore = inCore;
    std::vector<std::uint64_t> budgets;
    for (const DeviceLimits& device : devices) budgets.push_back(blockBudget(device));
    const std::uint64_t budget = *std::min_element(budgets.begin(), budgets.end());
    const int ofTree = tree.options.blockLog2Cells, wanted = options.blockLog2Cells;
    const int blockLog2Cells = ofTree && wanted ? std::min(ofTree, wanted) : ofTree + wanted;
    schedule.blocks =
        Cutter(grid, tree, budget, blockLog2Cells, schedule.boundary == BoundaryMode::kHalo).cut();
    handOut(devices, budgets, options, schedule);
    return schedule;
}

bool fitsOne(const std::vector<DeviceLimits>& devices, const ScheduleOptions& options,
             std::uint64_t everythingBytes)
{
    return devices.size() == 1 && options.blockLog2Cells == 0 && everythingBytes <= devices[0].memoryBytes;
}

// All of it, on the one device or on the CPU where there is none.
Schedule scheduleAtOnce(const SparseGridData& grid, const WorkloadTree& tree,
                        const std::vector<DeviceLimits>& devices, const ScheduleOptions& options)
{
    const WorkloadNode& root = tree.nodes[0];
    Schedule one;
    one.model = tree.options.model;
    one.boundary = options.boundary == BoundaryMode::kCpu ? BoundaryMode::kCpu : BoundaryMode::kHalo;
    if (root.work.particles > 0) one.blocks.push_back(blockOf(root, grid, tree.options.model, true));
    std::vector<std::uint64_t> budgets;
    for (const DeviceLimits& device : devices) budgets.push_back(device.memoryBytes);
    ScheduleOptions alone = options;
    alone.useCpu = devices.empty();
    handOut(devices, budgets, alone, one);
    // A tree that is not divided so far has no nodes for the buffers.
    const bool mayBeCut = !devices.empty() && tree.options.nodeBytes <= blockBudget(devices[0]);
    if (options.oneBlock || !mayBeCut) return one;
    Schedule cut = scheduleWith(grid, tree, devices, alone, one.boundary, true);
    const bool endsSooner = cut.tooLargeQueries == 0 && cut.predictedSeconds < one.predictedSeconds;
    return endsSooner ? cut : one;
}

Schedule scheduleFor(const SparseGridData& grid, const WorkloadTree& tree,
                     const std::vector<DeviceLimits>& devices, const ScheduleOptions& options)
{
    if (devices.empty() || fitsOne(devices, options, blockBytes(tree.nodes[0], tree.options.model).total())) {
        return scheduleAtOnce(grid, tree, devices, options);
    }
    if (options.boundary != BoundaryMode::kAuto) {
        return scheduleWith(grid, tree, devices, options, options.boundary, false);
    }
    Schedule halo = scheduleWith(grid, tree, devices, options, BoundaryMode::kHalo, false);
    Schedule cpu = scheduleWith(grid, tree, devices, options, BoundaryMode::kCpu, false);
    return cpu.predictedSeconds < halo.predictedSeconds ? cpu : halo;
}

// Seconds that blocks side by side can save over one at most: but for the slowest stage they hide all.
double mostOverlap(const Work& work, const BlockBytes& bytes, const Rates& rates)
{
    const double search = static_cast<double>(work.candidateTests) / rates.testsPerSecond,
                 up = static_cast<double>(bytes.up) / rates.uploadBytesPerSecond,
                 down = static_cast<double>(bytes.down) / rates.downloadBytesPerSecond;
    return search + up + down - std::max({search, up, down});
}

} // namespace

std::uint64_t nodeBytesFor(const SparseGrid& grid, const WorkEstimate& estimate, const MemoryModel& model,
                           const std::vector<DeviceLimits>& devices, const ScheduleOptions& options)
{
    // With fewer blocks than that for each executor they do not end together; with blocks whose search takes less than 20
    // latencies, those cost more than that loses. Where everything fits, makeSchedule() weighs that against one block.
    constexpr double kBlocksEach = 48, kLatencies = 20, kBlocksOfBuffer = 4;
    if (devices.empty()) return std::numeric_limits<std::uint64_t>::max();
    WorkloadNode root;
    root.endLeaf = static_cast<std::uint32_t>(grid.leafCount());
    root.occupiedCells = grid.cellCount();
    root.work = estimate.total;
    const BlockBytes bytes = blockBytes(root, model);
    const std::uint64_t everything = bytes.total();
    const bool isInCore = fitsOne(devices, options, everything);
    if (isInCore && options.oneBlock) return devices[0].memoryBytes;
    std::uint64_t budget = std::numeric_limits<std::uint64_t>::max();
    for (const DeviceLimits& device : devices) budget = std::min(budget, blockBudget(device));
    double blocks = kBlocksEach * static_cast<double>(devices.size() + (options.useCpu ? 1 : 0));
    for (const DeviceLimits& device : devices) {
        const double tests = kLatencies * device.rates.latencySeconds * device.rates.testsPerSecond;
        if (tests > 0) blocks = std::min(blocks, static_cast<double>(estimate.total.candidateTests) / tests);
    }
    if (isInCore) {
        blocks = std::max(blocks, kBlocksOfBuffer * devices[0].buffers);
        if (blocks * devices[0].rates.latencySeconds >= mostOverlap(root.work, bytes, devices[0].rates)) {
            return devices[0].memoryBytes;
        }
    }
    return std::min(budget,
                    static_cast<std::uint64_t>(static_cast<double>(everything) / std::max(1.0, blocks)));
}

std::uint64_t blockBudget(const DeviceLimits& device)
{
    return device.memoryBytes / static_cast<std::uint64_t>(std::max(device.buffers, 1));
}

Schedule makeSchedule(const SparseGrid& grid, const WorkloadTree& tree,
                      const std::vector<DeviceLimits>& devices, const ScheduleOptions& options)
{
    check(devices, options);
    if (tree.nodes.empty() || tree.nodes[0].endLeaf != grid.leafCount() ||
        tree.nodes[0].work.particles != grid.particleCount()) {
        throw InvalidInput("the workload tree is not of a grid with " + std::to_string(grid.leafCount()) +
                           " leaves");
    }
    Schedule schedule = scheduleFor(grid.data(), tree, devices, options);
    for (const Block& block : schedule.blocks) {
        schedule.largestLog2Cells = std::max(schedule.largestLog2Cells, block.log2Cells);
    }
    return schedule;
}

const char* deviceKindName(DeviceKind kind)
{
    return kind == DeviceKind::kCpu ? "cpu" : kind == DeviceKind::kCuda ? "cuda" : "sim";
}

const char* boundaryModeName(BoundaryMode mode)
{
    return mode == BoundaryMode::kCpu ? "cpu" : mode == BoundaryMode::kHalo ? "halo" : "auto";
}

} // namespace vdb_nns
