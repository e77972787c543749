// Hands blocks out to whoever is free first, in virtual time: devices take the largest, TBB workers boundary regions and the
// smallest, so that all end together. Predicts a schedule, and runs one on simulated devices. No device calls.
#pragma once

#include "plan/device_clock.h"
#include "vdb_nns/planning/schedule.h"

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

namespace vdb_nns {

// Tests of a block that are left to TBB workers when a device runs it.
std::uint64_t boundaryTests(const Block& block);

class Dispatcher {
public:
    struct Item {
        std::size_t block; // the caller's number of it
        std::uint64_t tests;
        std::uint64_t outsideTests; // of those, left to TBB workers when a device takes the block
        BlockBytes bytes;
        bool isExact = true;  // the bytes are known, not estimated
        bool isTried = false; // has found no room before, and has bytes for what was counted then
    };
    static constexpr int kTooLarge = -2;
    struct Turn {
        std::size_t block;
        int executor; // device, Block::kOnCpu, or kTooLarge: it fits no device now, nobody has it, split it
        double startSeconds;
        double endSeconds; // on the CPU only; a device's is known once it has finished
    };

    // `budgets`: the most bytes of a block, by device.
    Dispatcher(const std::vector<DeviceLimits>& devices, std::vector<std::uint64_t> budgets,
               const ScheduleOptions& options);

    // Blocks to hand out. Called once.
    void setItems(std::vector<Item> items);
    // A block to be taken before all others.
    void addFirst(const Item& item) { mAgain.push_back(item); }
    // Downloads have turned out to be larger than they were taken to be.
    struct Correction {
        double ratio = 1; // times as large, where they were estimated; 1 or more
        double more = 0;  // and by this share, wherever they come from
    };
    void correct(const Correction& correction) { mCorrection = correction; }

    // What the clock on the wall says: a device has ended a block, and this is how fast it is.
    void observe(int device, double seconds, const Rates& rates);
    // The CPU has done so many of the tests that it was given.
    void observeCpu(double seconds, std::uint64_t testsDone, double testsPerSecond);

    // A device that is full() takes none; one that is in use must not be.
    std::optional<Turn> next();
    // Tests that TBB workers have to do besides.
    double addCpuTests(std::uint64_t tests);
    // The oldest block of a device is downloaded. Returns when.
    double finish(int device, std::uint64_t bytesDown);
    bool full(int device) const { return mClocks[static_cast<std::size_t>(device)].full(); }
    // The device takes no more blocks.
    bool isRetired(int device) const { return mRetired[static_cast<std::size_t>(device)]; }
    void retire(int device) { mRetired[static_cast<std::size_t>(device)] = true; }
    std::uint64_t mostBytes() const; // of a block for a device that is in use; 0 without one

    double cpuSeconds() const { return mCpuDone; }
    double deviceSeconds(int device) const
    {
        return mClocks[static_cast<std::size_t>(device)].searchSeconds();
    }
    double doneSeconds() const; // of what is finished

private:
    Turn giveToDevices(const Item& item, std::size_t free);
    Turn giveToCpu(const Item& item);
    double shareOf(const Item& item) const;

    std::vector<DeviceLimits> mDevices;
    std::vector<std::uint64_t> mBudgets;
    ScheduleOptions mOptions;
    std::vector<DeviceClock> mClocks;
    std::vector<bool> mRetired;
    std::deque<Item> mItems; // largest first
    std::vector<Item> mAgain;
    Correction mCorrection;
    std::uint64_t mCpuTests = 0; // given to the CPU
    double mLeft = 0;            // seconds of what is not handed out, by the devices together
    double mCpuDone = 0;         // when the CPU's work so far is done
};

} // namespace vdb_nns
