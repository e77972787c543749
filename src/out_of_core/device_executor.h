// One device in a run: the memory of its buffers, the blocks that it has in flight, and what it has done. Knows its BlockDevice
// and blocks; nothing of the schedule, of other devices, and of who decides.
//
// Threads: everything that is public is called by the decider alone. A block in flight is a job: on the arena where the device is
// simulated, else on a thread of its buffer, where it sleeps while the device works. Until BlockInFlight::ended is true it is
// that job's, then the decider's. A buffer holds one block at a time: a device that is full() to the dispatcher begins none
// before its oldest has ended.
#pragma once

#include "out_of_core/block_split.h"
#include "out_of_core/block_transfer.h"
#include "out_of_core/collector.h"
#include "out_of_core/cpu_blocks.h"
#include "out_of_core/job_queue.h"
#include "out_of_core/run_progress.h"
#include "search/engine_state.h"
#include "shared/block_device.h"
#include "vdb_nns/planning/executor.h"
#include "vdb_nns/planning/schedule.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns {

// A block on a device, and what has come of it.
struct BlockInFlight {
    PendingBlock block;
    std::size_t buffer = 0;
    std::atomic<bool> ended{false};
    TransferredBlock transferred;
    Collector::Collected collected; // unless it has overflowed
    double collectSeconds = 0;
    std::vector<std::uint32_t> counts; // of its queries, after an overflow
    std::string failure;               // of the device; the block is to be run elsewhere

    std::uint64_t pairs() const;
};

// What the blocks in flight of all devices share. It outlives the jobs.
struct DeviceContext {
    EngineState& engine;
    const SearchRun& run;
    const MemoryModel& model;
    Collector& collector;
    CpuBlocks& cpu; // has the boundary regions
    RunProgress& progress;
    JobQueue& jobs;
};

// Buffers that a device can use.
struct BufferNeed {
    std::size_t buffers = 0;
    std::uint64_t bytes = 0; // each
};

// Of the blocks that have come back: what a device's own clock says, and of what.
struct DeviceWork {
    StepTimes times;
    std::uint64_t tests = 0, bytesUp = 0, bytesDown = 0;
};

class DeviceExecutor {
public:
    DeviceExecutor(std::unique_ptr<BlockDevice> device, const DeviceContext& crew)
        : mDevice(std::move(device)), mContext(crew)
    {
    }
    DeviceExecutor(const DeviceExecutor&) = delete; // jobs have its address
    DeviceExecutor& operator=(const DeviceExecutor&) = delete;

    // Memory, and threads where it needs some, for the buffers: as large as that, or half of it, and half of that, where the
    // device refuses; fewer buffers where threads are. Throws OutOfDeviceMemory when it refuses a small block, and DeviceError; it has no buffers then.
    void openBuffers(const BufferNeed& need);
    std::size_t bufferCount() const { return mBuffers.size(); }
    std::uint64_t bufferBytes() const { return mBufferBytes; }
    std::uint64_t halvings() const { return mHalvings; } // of what was asked for

    // The device itself, once no block is in flight; after that, only what has been measured is left.
    std::unique_ptr<BlockDevice> close() { return std::move(mDevice); }

    // One that could not be opened, a null device, has no buffers, and no times of its own.
    bool isSimulated() const { return !mDevice || mDevice->isSimulated(); }
    std::uint64_t peakBytes() const { return mDevice ? mDevice->peakBytes() : 0; }

    // There is a buffer for it.
    void begin(PendingBlock block);
    bool hasInFlight() const { return !mInFlight.empty(); }
    bool oldestHasEnded() const { return hasInFlight() && mInFlight.front()->ended; }
    // The block that was begun first, once it has ended; meanwhile the caller works on jobs. Throws what a job threw.
    std::unique_ptr<BlockInFlight> awaitOldest();

    // Adds a block that has come back.
    void measure(const BlockInFlight& inFlight);
    const DeviceWork& work() const { return mWork; }

private:
    bool tryOpenBuffers(const BufferNeed& need);
    void startThreads();
    void requireRoom(const PendingBlock& block) const;
    void transfer(BlockInFlight& inFlight) const;

    std::unique_ptr<BlockDevice> mDevice;
    const DeviceContext mContext;
    std::vector<DeviceBuffer> mBuffers;
    std::vector<std::size_t> mThreads; // of the buffers, where they have some
    std::uint64_t mBufferBytes = 0, mHalvings = 0;
    std::size_t mBegun = 0;
    DeviceWork mWork;
    std::deque<std::unique_ptr<BlockInFlight>> mInFlight; // oldest first
};

// What a device has turned out to do in a second; `before` where it has done nothing yet. Latency is in its times.
Rates ratesOf(const DeviceWork& work, const Rates& before);

} // namespace vdb_nns
