// Virtual time of one device: uploads, searches and downloads one block each at a time, and holds a few in its buffers.
// The same clock predicts a schedule and runs the simulated device, whose downloads are known only once a block has run:
// so a block is begun, and finished later, in the same order. The clock of a real device is set by the one on the wall.
#pragma once

#include "vdb_nns/planning/schedule.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class DeviceClock {
public:
    DeviceClock(const Rates& rates, int buffers) : mRates(rates), mBuffers(static_cast<std::size_t>(buffers))
    {
    }

    // Every buffer holds a block that is not finished.
    bool full() const { return mBegun - mFinished == mBuffers.size(); }

    // When the next block can begin its upload. Not for a full device.
    double ready() const { return std::max(mUploadFree, mBuffers[mBegun % mBuffers.size()].free); }

    // Uploads and searches a block. Returns when its upload begins.
    double begin(std::uint64_t tests, std::uint64_t bytesUp)
    {
        const double start = ready();
        mUploadFree = start + static_cast<double>(bytesUp) / mRates.uploadBytesPerSecond;
        const double search = mRates.latencySeconds + static_cast<double>(tests) / mRates.testsPerSecond;
        mSearchFree = std::max(mSearchFree, mUploadFree) + search;
        mSearchSeconds += search;
        Buffer& buffer = mBuffers[mBegun++ % mBuffers.size()];
        buffer.searched = mSearchFree;
        buffer.tests = tests;
        return start;
    }

    // Downloads the oldest block that is not finished. Returns when that is done, and its buffer free.
    double finish(std::uint64_t bytesDown)
    {
        Buffer& buffer = mBuffers[mFinished++ % mBuffers.size()];
        mDownloadFree = std::max(mDownloadFree, buffer.searched) +
                        static_cast<double>(bytesDown) / mRates.downloadBytesPerSecond;
        return buffer.free = mDownloadFree;
    }

    // At this time, on the wall, a block has come back. What is in flight will be done as the rates say.
    void observe(double seconds, const Rates& rates)
    {
        mRates = rates;
        double inFlight = 0;
        for (std::size_t i = mFinished; i < mBegun; ++i) {
            inFlight += static_cast<double>(mBuffers[i % mBuffers.size()].tests) / rates.testsPerSecond;
        }
        mUploadFree = mSearchFree = mDownloadFree = seconds + inFlight;
        for (Buffer& buffer : mBuffers) buffer.free = std::min(buffer.free, mUploadFree);
    }

    // When all finished blocks are done.
    double done() const { return mDownloadFree; }
    double searchSeconds() const { return mSearchSeconds; }

private:
    struct Buffer {
        double free = 0, searched = 0;
        std::uint64_t tests = 0;
    };

    Rates mRates;
    std::vector<Buffer> mBuffers; // in turn: blocks leave in the order in which they came
    std::size_t mBegun = 0, mFinished = 0;
    double mUploadFree = 0, mSearchFree = 0, mDownloadFree = 0, mSearchSeconds = 0;
};

} // namespace vdb_nns
