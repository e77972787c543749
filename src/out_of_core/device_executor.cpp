// See device_executor.h.
#include "out_of_core/device_executor.h"

#include "util/wall_clock.h"
#include "vdb_nns/error.h"

#include <numeric>
#include <string>
#include <system_error>
#include <utility>

namespace vdb_nns {

std::uint64_t Flight::pairs() const
{
    return flown.overflowed ? std::accumulate(counts.begin(), counts.end(), std::uint64_t(0))
                            : collected.pairs;
}

// ---- slots ---------------------------------------------------------------------------------------------------------

void DeviceExecutor::openSlots(const SlotNeed& need)
{
    constexpr std::uint64_t kLeastBytes = 1024;
    if (need.slots == 0 || !mDevice) return;
    SlotNeed asked = need;
    while (!tryOpenSlots(asked)) {
        ++mHalvings;
        asked.bytes = asked.bytes / 2 / 16 * 16;
        if (asked.bytes < kLeastBytes) throw OutOfDeviceMemory("it refused memory for even a small block");
    }
    mSlotBytes = asked.bytes;
    if (!mDevice->isSimulated()) startThreads();
}

// One a slot. Slots that get none are done without.
void DeviceExecutor::startThreads()
{
    try {
        while (mThreads.size() < mSlots.size()) mThreads.push_back(mCrew.jobs.addThread());
    } catch (const std::system_error& error) {
        mSlots.resize(mThreads.size());
        if (!mSlots.empty()) return;
        mDevice->releaseAll();
        throw DeviceError(std::string("no thread could be started for its slots: ") + error.what() +
                          "; allow more threads (ulimit -u) or memory");
    }
}

// False when there is not so much memory. Throws DeviceError. Nothing is held after either.
bool DeviceExecutor::tryOpenSlots(const SlotNeed& need)
{
    const auto release = [this] {
        mSlots.clear();
        mDevice->releaseAll();
    };
    try {
        for (std::size_t s = 0; s < need.slots; ++s) {
            mSlots.push_back({static_cast<int>(s), mDevice->allocate(need.bytes), nullptr, need.bytes});
        }
        for (DeviceSlot& slot : mSlots) slot.staging = mDevice->allocateStaging(need.bytes);
        return true;
    } catch (const OutOfDeviceMemory&) {
        release();
        return false;
    } catch (...) {
        release();
        throw;
    }
}

// ---- flights -------------------------------------------------------------------------------------------------------

void DeviceExecutor::begin(RunBlock block)
{
    auto flight = std::make_unique<Flight>();
    flight->block = std::move(block);
    flight->slot = mBegun++ % mSlots.size();
    Flight& own = *flight;
    mFlights.push_back(std::move(flight));
    const auto job = [this, &own] { fly(own); };
    if (mThreads.empty()) {
        mCrew.jobs.add(job);
    } else {
        mCrew.jobs.addTo(mThreads[own.slot], job);
    }
}

std::unique_ptr<Flight> DeviceExecutor::awaitOldest()
{
    mCrew.jobs.runUntil([&] { return mFlights.front()->ended.load(); });
    std::unique_ptr<Flight> flight = std::move(mFlights.front());
    mFlights.pop_front();
    return flight;
}

// A schedule of another grid may say less than its blocks take; nothing is written then.
void DeviceExecutor::requireRoom(const RunBlock& block) const
{
    const std::uint64_t needed = leastBytes(mCrew.run.grid, block.part, mCrew.model.encoding);
    if (needed <= mSlotBytes) return;
    throw InvalidInput("block " + std::to_string(block.block) + " needs " + std::to_string(needed) +
                       " bytes and more, and the schedule has " + std::to_string(mSlotBytes) +
                       " for it: it is not of this grid");
}

// The job. What is no failure of the device ends the run; the flight has not ended then.
void DeviceExecutor::fly(Flight& flight) const
{
    const SearchRun& run = mCrew.run;
    const Encoding encoding = mCrew.model.encoding;
    try {
        run.cancel.check();
        mCrew.cpu.stage(flight.block);
        requireRoom(flight.block);
        const BlockPart& part = flight.block.part;
        const bool isKnown =
            encoding == Encoding::kNone ||
            (encoding == Encoding::kMask && mCrew.model.masksAreExact && part.without.empty());
        flight.flown = flyBlock(*mDevice, mSlots[flight.slot], run.grid, part,
                                {run.context.bounds, encoding, isKnown ? flight.block.item.bytes.down : 0});
        const FlownBlock& flown = flight.flown;
        if (flown.overflowed) {
            const auto* const counts =
                reinterpret_cast<const std::uint32_t*>(flown.result + flown.layout.counts);
            flight.counts.assign(counts, counts + flight.block.queries());
        } else {
            const double start = wallSeconds();
            flight.collected =
                mCrew.collector.collect(part, flown.layout, flown.result, mCrew.engine.states.local());
            flight.collectSeconds = wallSeconds() - start;
            mCrew.tally.addPairs(flight.block.block, flight.collected.pairs);
        }
    } catch (const DeviceError& error) {
        flight.failure = error.what();
        if (flight.failure.empty()) flight.failure = "unknown";
    }
    flight.ended = true;
}

// ---- measured ------------------------------------------------------------------------------------------------------

void DeviceExecutor::measure(const Flight& flight)
{
    const FlownBlock& flown = flight.flown;
    mWork.times.uploadSeconds += flown.times.uploadSeconds;
    mWork.times.searchSeconds += flown.times.searchSeconds;
    mWork.times.downloadSeconds += flown.times.downloadSeconds;
    mWork.tests += flight.block.item.tests;
    mWork.bytesUp += flown.bytesUp;
    mWork.bytesDown += flown.bytesDown;
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
