// A device that is not there: host memory under a budget that is enforced to the byte, real results by the kernels of the
// CPU. What it would take is reckoned by plan/device_clock.h; nothing here sleeps.
#pragma once

#include "search/engine_state.h"
#include "shared/block_device.h"

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace vdb_nns {

class SimulatedDevice : public BlockDevice {
public:
    SimulatedDevice(std::string name, std::uint64_t budgetBytes, const SearchRun& run, ThreadStates& states);

    bool isSimulated() const override { return true; }
    std::byte* allocate(std::uint64_t bytes) override;
    void releaseAll() override;
    std::byte* allocateStaging(std::uint64_t bytes) override;
    void upload(int buffer, std::byte* device, const std::byte* staging, std::uint64_t bytes) override;
    void search(int buffer, const BlockSearch& block) override;
    std::byte* download(int buffer, std::byte* staging, std::byte* device, std::uint64_t bytes) override;
    StepTimes wait(int) override { return {}; }
    std::uint64_t peakBytes() const override { return mPeakBytes; }

private:
    // Of exactly the size that was asked for, so that a sanitizer sees the first byte past it.
    using Memory = std::unique_ptr<std::byte[]>;
    Memory hostMemory(std::uint64_t bytes) const;
    void copy(std::byte* to, const std::byte* from, std::uint64_t bytes) const;

    std::string mName;
    std::uint64_t mBudgetBytes, mUsedBytes = 0, mPeakBytes = 0;
    const SearchRun& mRun;
    ThreadStates& mStates;
    std::vector<Memory> mMemory, mStaging;
};

} // namespace vdb_nns
