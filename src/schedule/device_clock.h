// Virtual time of one device: uploads, searches and downloads one block each at a time, and holds a few in its slots.
// The same clock predicts a schedule and runs the simulated device.
#pragma once

#include "vdb_nns/schedule.h"

#include <algorithm>
#include <vector>

namespace vdb_nns {

class DeviceClock {
public:
    DeviceClock(const Rates& rates, int slots)
        : mRates(rates), mSlotFree(static_cast<std::size_t>(slots), 0.0)
    {
    }

    // When the next block could begin its upload.
    double ready() const
    {
        return std::max(mUploadFree, *std::min_element(mSlotFree.begin(), mSlotFree.end()));
    }

    struct Times {
        double start, end;
    };

    Times run(std::uint64_t tests, std::uint64_t bytesUp, std::uint64_t bytesDown)
    {
        const double start = ready();
        mUploadFree = start + static_cast<double>(bytesUp) / mRates.uploadBytesPerSecond;
        const double search = mRates.latencySeconds + static_cast<double>(tests) / mRates.testsPerSecond;
        mSearchFree = std::max(mSearchFree, mUploadFree) + search;
        mSearchSeconds += search;
        mDownloadFree = std::max(mDownloadFree, mSearchFree) +
                        static_cast<double>(bytesDown) / mRates.downloadBytesPerSecond;
        *std::min_element(mSlotFree.begin(), mSlotFree.end()) = mDownloadFree;
        return {start, mDownloadFree};
    }

    // When a block would be done if it were given to the device now.
    double endOf(std::uint64_t tests, std::uint64_t bytesUp, std::uint64_t bytesDown) const
    {
        return DeviceClock(*this).run(tests, bytesUp, bytesDown).end;
    }

    // When all blocks given to it are done.
    double done() const { return mDownloadFree; }
    double searchSeconds() const { return mSearchSeconds; }

private:
    Rates mRates;
    std::vector<double> mSlotFree;
    double mUploadFree = 0, mSearchFree = 0, mDownloadFree = 0, mSearchSeconds = 0;
};

} // namespace vdb_nns
