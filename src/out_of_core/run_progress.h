// What a run has done so far, whoever did it. Thread-safe: jobs add to it while the decider reads.
#pragma once

#include "util/cancel.h"

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class RunProgress {
public:
    RunProgress(const CancelCheck& cancel, std::uint64_t particles, std::size_t blocks)
        : mCancel(cancel), mParticles(particles), mPairs(blocks)
    {
    }

    // Pairs of queries of a block of the schedule.
    void addPairs(std::size_t block, std::uint64_t pairs) { mPairs[block] += pairs; }
    void addCpuQueries(std::uint64_t queries) { mCpuQueries += queries; }
    void addDeviceQueries(std::uint64_t queries) { mDeviceQueries += queries; }

    // Tells the user. Throws Cancelled.
    void show() const
    {
        mCancel.update(static_cast<double>(mDeviceQueries + mCpuQueries) / static_cast<double>(mParticles));
    }

    std::uint64_t cpuQueries() const { return mCpuQueries; }
    std::vector<std::uint64_t> blockPairs() const { return {mPairs.begin(), mPairs.end()}; }

private:
    const CancelCheck& mCancel;
    const std::uint64_t mParticles;
    std::vector<std::atomic<std::uint64_t>> mPairs; // by block of the schedule
    std::atomic<std::uint64_t> mCpuQueries{0}, mDeviceQueries{0};
};

} // namespace vdb_nns
