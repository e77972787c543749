// The schedule: which blocks a search is cut into, what each needs, and who should run it. Plain data, made before anything
// runs; executors decide only timing.
#pragma once

#include "vdb_nns/planning/workload_tree.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

enum class DeviceKind { kCpu, kCuda, kSim };

/// Who runs the boundary region of a block: the queries whose cells in reach hold occupied cells outside the block.
enum class BoundaryMode {
    kCpu,  ///< TBB workers, one task a boundary leaf (the paper): a device needs no halo
    kHalo, ///< the device, which is sent the cells around the block too
    kAuto  ///< whichever the cost model says ends first
};

/// Cost model of a device: seconds of a block = latency + tests / testsPerSecond + bytes / (bytes per second). A device
/// uploads, searches and downloads at the same time, each for another block.
struct Rates {
    double latencySeconds = 20e-6;
    double testsPerSecond = 2.5e9;
    double uploadBytesPerSecond = 12e9;
    double downloadBytesPerSecond = 12e9;
};

/// What a device may use and how fast it is taken to be.
struct DeviceLimits {
    DeviceKind kind = DeviceKind::kSim;
    std::string name;
    std::uint64_t memoryBytes = 0;
    int buffers = 3; ///< blocks in flight
    Rates rates;
    int ordinal = 0; ///< of a CUDA device
    bool mapped =
        false; ///< a CUDA device that keeps blocks in host memory and reads them through the link: a baseline
};

struct ScheduleOptions {
    BoundaryMode boundary = BoundaryMode::kAuto;
    int blockLog2Cells =
        0; ///< blocks of 2^k cells at most: the paper's fixed sizes; 0 for the largest that fit
    double cpuTestsPerSecond = 4e9; ///< of all threads together
    bool useCpu = true;             ///< TBB workers take blocks too, where that ends sooner
    /// No more than one block where everything fits the one device, even if more would end sooner: a baseline.
    bool oneBlock = false;
};

/// The queries of a range of leaves, or a range of the queries of one leaf.
struct Block {
    static constexpr int kOnCpu = -1;
    static constexpr std::uint64_t kFewestQueries = 32; ///< of a part of a leaf: a warp

    Vec3i origin{};    ///< cell coordinates
    int log2Cells = 0; ///< as of its node; WorkloadNode::kRoot for everything at once
    std::uint32_t firstLeaf = 0, endLeaf = 0;
    std::uint64_t firstSlot = 0, endSlot = 0; ///< queries; all of the leaves' but where a leaf is cut
    Work work;                                ///< of its queries
    HaloSize halo;
    bool withHalo =
        true;         ///< a device runs all of its queries; else the boundary region is left to TBB workers
    BlockBytes bytes; ///< on a device
    int preferred = kOnCpu;                  ///< number of the device, in the order of the limits
    double startSeconds = 0, endSeconds = 0; ///< predicted
};

struct DevicePlan {
    std::uint64_t peakBytes = 0, blocks = 0, particles = 0;
    double busySeconds = 0;
};

struct Schedule {
    /// Everything fits the one device at once, and is searched there; or there is no device.
    bool inCore = true;
    BoundaryMode boundary = BoundaryMode::kHalo; ///< decided
    MemoryModel model;
    std::vector<Block> blocks;       ///< in the order of the grid; every query is in one of them
    std::vector<DevicePlan> devices; ///< by device
    std::uint64_t deviceParticles = 0, cpuParticles = 0; ///< queries, by who is preferred
    std::uint64_t boundaryLeaves = 0;                    ///< leaves with queries left to TBB workers
    std::uint64_t tooLargeQueries = 0; ///< of the CPU's: 32 of them with their candidates fit no device
    int largestLog2Cells = 0;
    double cpuBusySeconds = 0;
    double predictedSeconds = 0;  ///< when the last of all is done
    double lowerBoundSeconds = 0; ///< all tests over the sum of all rates of tests
};

/// Most bytes that a block may have on a device beside others: its memory, shared by its buffers.
std::uint64_t blockBudget(const DeviceLimits& device);

/// How far the tree is to be divided for those devices (WorkloadTreeOptions::nodeBytes): into nodes that fit a slot, and somewhat
/// smaller ones where so few would not keep all executors busy to the end, or not all buffers of the one device that everything
/// fits. Not at all where everything fits and ScheduleOptions::oneBlock is set, or nothing could be gained.
std::uint64_t nodeBytesFor(const SparseGrid& grid, const WorkEstimate& estimate, const MemoryModel& model,
                           const std::vector<DeviceLimits>& devices, const ScheduleOptions& options = {});

/// Cuts the work into the largest nodes that fit every device, top-down; leaves that do not fit into ranges of queries. What fits
/// the one device is one block, unless the tree is divided and its nodes end sooner, as they are sent and searched side by side.
/// A pure function: the same arguments give the same schedule.
/// Cost: some microseconds a block.
/// @throws InvalidInput for a device without memory, buffers or speed, a block size below a leaf, a tree of another grid, or one
///         that is not divided as far as the devices' memory needs
Schedule makeSchedule(const SparseGrid& grid, const WorkloadTree& tree,
                      const std::vector<DeviceLimits>& devices, const ScheduleOptions& options = {});

const char* deviceKindName(DeviceKind kind);
const char* boundaryModeName(BoundaryMode mode);

} // namespace vdb_nns
