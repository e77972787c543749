// Virtual time of one device: uploads, searches and downloads one block each at a time, and holds a few in its slots.
// The same clock predicts a schedule and runs the simulated device, whose downloads are known only once a block has run:
// so a block is begun, and finished later, in the same order.
#pragma once

#include "vdb_nns/schedule.h"

#include <algorithm>
#include <cstddef>
#include <vector>

namespace vdb_nns {

class DeviceClock {
public:
    DeviceClock(const Rates& rates, int slots) : mRates(rates), mSlots(static_cast<std::size_t>(slots)) {}

    // Every slot holds a block that is not finished.
    bool full() const { return mBegun - mFinished == mSlots.size(); }

    // When the next block can begin its upload. Not for a full device.
    double ready() const { return std::max(mUploadFree, mSlots[mBegun % mSlots.size()].free); }

    // Uploads and searches a block. Returns when its upload begins.
    double begin(std::uint64_t tests, std::uint64_t bytesUp)
    {
        const double start = ready();
        mUploadFree = start + static_cast<double>(bytesUp) / mRates.uploadBytesPerSecond;
        const double search = mRates.latencySeconds + static_cast<double>(tests) / mRates.testsPerSecond;
        mSearchFree = std::max(mSearchFree, mUploadFree) + search;
        mSearchSeconds += search;
        mSlots[mBegun++ % mSlots.size()].searched = mSearchFree;
        return start;
    }

    // Downloads the oldest block that is not finished. Returns when that is done, and its slot free.
    double finish(std::uint64_t bytesDown)
    {
        Slot& slot = mSlots[mFinished++ % mSlots.size()];
        mDownloadFree = std::max(mDownloadFree, slot.searched) +
                        static_cast<double>(bytesDown) / mRates.downloadBytesPerSecond;
        return slot.free = mDownloadFree;
    }

    // When all finished blocks are done.
    double done() const { return mDownloadFree; }
    double searchSeconds() const { return mSearchSeconds; }

private:
    struct Slot {
        double free = 0, searched = 0;
    };

    Rates mRates;
    std::vector<Slot> mSlots; // in turn: blocks leave in the order in which they came
    std::size_t mBegun = 0, mFinished = 0;
    double mUploadFree = 0, mSearchFree = 0, mDownloadFree = 0, mSearchSeconds = 0;
};

} // namespace vdb_nns
