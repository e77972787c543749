// The schedule: which blocks a search is cut into, what each needs, and who should run it. Plain data, made
// before anything runs; executors decide only timing.
#pragma once

#include "vdb_nns/planning/workload_tree.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

enum class DeviceKind { kCpu, kCuda, kSim };

/// Who runs the boundary region of a block: the queries with occupied cells in reach that lie outside the
/// block.
enum class BoundaryMode {
    kCpu,  ///< TBB workers, one task for each boundary leaf (the paper): a device needs no halo
    kHalo, ///< the device, which is also sent the cells around the block
    kAuto  ///< whichever ends first by the cost model
};

/// Cost model of a device: seconds of a block = latency + tests / testsPerSecond + bytes / (bytes per
/// second). A device uploads, searches and downloads at the same time, each for another block.
struct Rates {
    double latencySeconds = 20e-6;
    double testsPerSecond = 2.5e9;
    double uploadBytesPerSecond = 12e9;
    double downloadBytesPerSecond = 12e9;
};

/// What a device may use, and how fast it is assumed to be.
struct DeviceLimits {
    DeviceKind kind = DeviceKind::kSim;
    std::string name;
    std::uint64_t memoryBytes = 0;
    int buffers = 3; ///< blocks in flight
    Rates rates;
    int ordinal = 0; ///< of a CUDA device: its number in the runtime
    /// A CUDA device that keeps blocks in host memory and reads them through the link: a baseline.
    bool mapped = false;
};

struct ScheduleOptions {
    BoundaryMode boundary = BoundaryMode::kAuto;
    /// Blocks of at most 2^k cells along an edge: the fixed sizes of the paper. 0: the largest that fit.
    int blockLog2Cells = 0;
    double cpuTestsPerSecond = 4e9; ///< of all threads together
    bool useCpu = true;             ///< TBB workers take blocks too, if that ends sooner
    /// One block and no more if everything fits the one device, even if more would end sooner: a baseline.
    bool oneBlock = false;
};

/// The queries of a range of leaves, or a range of the queries of one leaf.
struct Block {
    static constexpr int kOnCpu = -1;
    /// Fewest queries in a part of a leaf: those of a warp.
    static constexpr std::uint64_t kFewestQueries = 32;

    Vec3i origin{};    ///< cell coordinates
    int log2Cells = 0; ///< of its node; WorkloadNode::kRoot for everything at once
    std::uint32_t firstLeaf = 0, endLeaf = 0;
    /// Queries: all those of the leaves, unless a leaf is cut.
    std::uint64_t firstSlot = 0, endSlot = 0;
    Work work; ///< of its queries
    HaloSize halo;
    /// A device runs all queries of the block. If false, the boundary region is left to TBB workers.
    bool withHalo = true;
    BlockBytes bytes;                        ///< on a device
    int preferred = kOnCpu;                  ///< number of the device, in the order of the limits, or kOnCpu
    double startSeconds = 0, endSeconds = 0; ///< predicted
};

/// What one device is expected to do.
struct DevicePlan {
    std::uint64_t peakBytes = 0, blocks = 0, particles = 0;
    double busySeconds = 0;
};

struct Schedule {
    /// Everything fits the one device at once and is searched there, or there is no device.
    bool inCore = true;
    BoundaryMode boundary = BoundaryMode::kHalo; ///< as decided; never kAuto
    MemoryModel model;
    std::vector<Block> blocks;       ///< in the order of the grid; every query is in exactly one
    std::vector<DevicePlan> devices; ///< in the order of the limits
    std::uint64_t deviceParticles = 0, cpuParticles = 0; ///< queries, by who is preferred for them
    std::uint64_t boundaryLeaves = 0;                    ///< leaves with queries left to TBB workers
    /// Queries left to the CPU because not even 32 of them, with their candidates, fit a device.
    std::uint64_t tooLargeQueries = 0;
    int largestLog2Cells = 0; ///< of all blocks
    double cpuBusySeconds = 0;
    double predictedSeconds = 0;  ///< when the last block is done
    double lowerBoundSeconds = 0; ///< all tests over the sum of all rates of tests
};

/// Most bytes that a block may have on a device together with others: its memory, divided among its buffers.
std::uint64_t blockBudget(const DeviceLimits& device);

/// How far the tree is to be divided for these devices (WorkloadTreeOptions::nodeBytes): into nodes that fit
/// a buffer, and into somewhat smaller ones if there would be too few to keep all executors busy to the end,
/// or to fill all buffers of the one device that everything fits. Not at all if everything fits and
/// ScheduleOptions::oneBlock is set, or if there is nothing to gain.
std::uint64_t nodeBytesFor(const SparseGrid& grid, const WorkEstimate& estimate, const MemoryModel& model,
                           const std::vector<DeviceLimits>& devices, const ScheduleOptions& options = {});

/// Cuts the work from the top into the largest nodes that fit every device, and leaves that do not fit into
/// ranges of queries. If everything fits the one device, it is one block, unless the tree is divided and its
/// nodes end sooner because they are sent and searched side by side. A pure function: the same arguments give
/// the same schedule.
/// Cost: some microseconds a block.
/// @throws InvalidInput for a device without memory, buffers or speed, a block size below a leaf, a tree of
///         another grid, or a tree that is not divided as far as the memory of the devices needs
Schedule makeSchedule(const SparseGrid& grid, const WorkloadTree& tree,
                      const std::vector<DeviceLimits>& devices, const ScheduleOptions& options = {});

const char* deviceKindName(DeviceKind kind);
const char* boundaryModeName(BoundaryMode mode);

} // namespace vdb_nns
