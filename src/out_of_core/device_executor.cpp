// How the buffers of a device are opened, and the steps of a block in flight.
#include "out_of_core/device_executor.h"

#include "util/wall_clock.h"
#include "vdb_nns/error.h"

#include <numeric>
#include <string>
#include <system_error>
#include <utility>

namespace vdb_nns {

std::uint64_t BlockInFlight::pairs() const
{
    return transferred.overflowed ? std::accumulate(counts.begin(), counts.end(), std::uint64_t(0))
                                  : collected.pairs;
}

// ---- buffers ---------------------------------------------------------------------------------------------------------

void DeviceExecutor::openBuffers(const BufferNeed& need)
{
    constexpr std::uint64_t kLeastBytes = 1024;
    if (need.buffers == 0 || !mDevice) return;
    BufferNeed asked = need;
    while (!tryOpenBuffers(asked)) {
        ++mHalvings;
        asked.bytes = asked.bytes / 2 / 16 * 16;
        if (asked.bytes < kLeastBytes) throw OutOfDeviceMemory("it refused memory for even a small block");
    }
    mBufferBytes = asked.bytes;
    if (!mDevice->isSimulated()) startThreads();
}

// One a buffer. Buffers that get none are done without.
void DeviceExecutor::startThreads()
{
    try {
        while (mThreads.size() < mBuffers.size()) mThreads.push_back(mContext.jobs.addThread());
    } catch (const std::system_error& error) {
        mBuffers.resize(mThreads.size());
        if (!mBuffers.empty()) return;
        mDevice->releaseAll();
        throw DeviceError(std::string("no thread could be started for its buffers: ") + error.what() +
                          "; allow more threads (ulimit -u) or memory");
    }
}

// False when there is not so much memory. Throws DeviceError. Nothing is held after either.
bool DeviceExecutor::tryOpenBuffers(const BufferNeed& need)
{
    const auto release = [this] {
        mBuffers.clear();
        mDevice->releaseAll();
    };
    try {
        for (std::size_t s = 0; s < need.buffers; ++s) {
            mBuffers.push_back({static_cast<int>(s), mDevice->allocate(need.bytes), nullptr, need.bytes});
        }
        for (DeviceBuffer& buffer : mBuffers) buffer.staging = mDevice->allocateStaging(need.bytes);
        return true;
    } catch (const OutOfDeviceMemory&) {
        release();
        return false;
    } catch (...) {
        release();
        throw;
    }
}

// ---- blocks in flight --------------------------------------------------------------------------------------------

void DeviceExecutor::begin(PendingBlock block)
{
    auto inFlight = std::make_unique<BlockInFlight>();
    inFlight->block = std::move(block);
    inFlight->buffer = mBegun++ % mBuffers.size();
    BlockInFlight& own = *inFlight;
    mInFlight.push_back(std::move(inFlight));
    const auto job = [this, &own] { transfer(own); };
    if (mThreads.empty()) {
        mContext.jobs.add(job);
    } else {
        mContext.jobs.addTo(mThreads[own.buffer], job);
    }
}

std::unique_ptr<BlockInFlight> DeviceExecutor::awaitOldest()
{
    mContext.jobs.runUntil([&] { return mInFlight.front()->ended.load(); });
    std::unique_ptr<BlockInFlight> inFlight = std::move(mInFlight.front());
    mInFlight.pop_front();
    return inFlight;
}

// A schedule of another grid may say less than its blocks take; nothing is written then.
void DeviceExecutor::requireRoom(const PendingBlock& block) const
{
    const std::uint64_t needed = leastBytes(mContext.run.queries, block.part, mContext.model.encoding);
    if (needed <= mBufferBytes) return;
    throw InvalidInput("block " + std::to_string(block.block) + " needs " + std::to_string(needed) +
                       " bytes and more, and the schedule has " + std::to_string(mBufferBytes) +
                       " for it: it is not of this grid");
}

// The job. What is no failure of the device ends the run; the block has not ended then.
void DeviceExecutor::transfer(BlockInFlight& inFlight) const
{
    const SearchRun& run = mContext.run;
    const Encoding encoding = mContext.model.encoding;
    try {
        run.cancel.check();
        mContext.cpu.stage(inFlight.block);
        requireRoom(inFlight.block);
        const BlockPart& part = inFlight.block.part;
        const bool isKnown =
            encoding == Encoding::kNone ||
            (encoding == Encoding::kMask && mContext.model.masksAreExact && part.without.empty());
        inFlight.transferred =
            transferBlock(*mDevice, mBuffers[inFlight.buffer], run.queries, part,
                          {run.context.bounds, encoding, isKnown ? inFlight.block.item.bytes.down : 0});
        const TransferredBlock& transferred = inFlight.transferred;
        if (transferred.overflowed) {
            const auto* const counts =
                reinterpret_cast<const std::uint32_t*>(transferred.result + transferred.layout.counts);
            inFlight.counts.assign(counts, counts + inFlight.block.queries());
        } else {
            const double start = wallSeconds();
            inFlight.collected = mContext.collector.collect(part, transferred.layout, transferred.result,
                                                            mContext.engine.states.local());
            inFlight.collectSeconds = wallSeconds() - start;
            mContext.progress.addPairs(inFlight.block.block, inFlight.collected.pairs);
        }
    } catch (const DeviceError& error) {
        inFlight.failure = error.what();
        if (inFlight.failure.empty()) inFlight.failure = "unknown";
    }
    inFlight.ended = true;
}

// ---- measured ------------------------------------------------------------------------------------------------------

void DeviceExecutor::measure(const BlockInFlight& inFlight)
{
    const TransferredBlock& transferred = inFlight.transferred;
    mWork.times.uploadSeconds += transferred.times.uploadSeconds;
    mWork.times.searchSeconds += transferred.times.searchSeconds;
    mWork.times.downloadSeconds += transferred.times.downloadSeconds;
    mWork.tests += inFlight.block.item.tests;
    mWork.bytesUp += transferred.bytesUp;
    mWork.bytesDown += transferred.bytesDown;
}

Rates ratesOf(const DeviceWork& work, const Rates& before)
{
    const auto rate = [](std::uint64_t amount, double seconds, double known) {
        return amount > 0 && seconds > 0 ? static_cast<double>(amount) / seconds : known;
    };
    return {0, rate(work.tests, work.times.searchSeconds, before.testsPerSecond),
            rate(work.bytesUp, work.times.uploadSeconds, before.uploadBytesPerSecond),
            rate(work.bytesDown, work.times.downloadSeconds, before.downloadBytesPerSecond)};
}

} // namespace vdb_nns
