#include "plan/dispatcher.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace vdb_nns {

std::uint64_t boundaryTests(const Block& block)
{
    if (block.withHalo || block.work.particles == 0) return 0;
    const double share =
        static_cast<double>(block.halo.boundaryQueries) / static_cast<double>(block.work.particles);
    return static_cast<std::uint64_t>(share * static_cast<double>(block.work.candidateTests));
}

Dispatcher::Dispatcher(const std::vector<DeviceLimits>& devices, std::vector<std::uint64_t> budgets,
                       const ScheduleOptions& options)
    : mDevices(devices), mBudgets(std::move(budgets)), mOptions(options), mRetired(devices.size(), false)
{
    for (const DeviceLimits& device : devices) mClocks.emplace_back(device.rates, device.buffers);
}

void Dispatcher::setItems(std::vector<Item> items)
{
    std::stable_sort(items.begin(), items.end(),
                     [](const Item& a, const Item& b) { return a.tests > b.tests; });
    for (const Item& item : items) mLeft += shareOf(item);
    mItems.assign(items.begin(), items.end());
}

std::uint64_t Dispatcher::mostBytes() const
{
    std::uint64_t most = 0;
    for (std::size_t d = 0; d < mBudgets.size(); ++d) {
        if (!mRetired[d]) most = std::max(most, mBudgets[d]);
    }
    return most;
}

// Seconds that all devices together need for a block when nothing else holds them up: each by its slowest stage.
double Dispatcher::shareOf(const Item& item) const
{
    double perSecond = 0;
    for (const DeviceLimits& device : mDevices) {
        const Rates& rates = device.rates;
        const double seconds =
            std::max({static_cast<double>(item.tests) / rates.testsPerSecond,
                      static_cast<double>(item.bytes.up) / rates.uploadBytesPerSecond,
                      static_cast<double>(item.bytes.down) / rates.downloadBytesPerSecond});
        perSecond += seconds > 0 ? 1 / seconds : 0;
    }
    return perSecond > 0 ? 1 / perSecond : 0;
}

double Dispatcher::addCpuTests(std::uint64_t tests)
{
    mCpuTests += tests;
    return mCpuDone += static_cast<double>(tests) / mOptions.cpuTestsPerSecond;
}

void Dispatcher::observe(int device, double seconds, const Rates& rates)
{
    const auto d = static_cast<std::size_t>(device);
    mClocks[d].observe(seconds, rates);
    // What is left is added up again, a pass over the blocks, only where it would come out different.
    const auto moved = [](double before, double now) { return !(std::fabs(now - before) < 0.05 * before); };
    Rates& known = mDevices[d].rates;
    if (!moved(known.testsPerSecond, rates.testsPerSecond) &&
        !moved(known.uploadBytesPerSecond, rates.uploadBytesPerSecond) &&
        !moved(known.downloadBytesPerSecond, rates.downloadBytesPerSecond)) {
        return;
    }
    known = rates;
    mLeft = 0;
    for (const Item& item : mItems) mLeft += shareOf(item);
}

void Dispatcher::observeCpu(double seconds, std::uint64_t testsDone, double testsPerSecond)
{
    mOptions.cpuTestsPerSecond = testsPerSecond;
    const std::uint64_t open = mCpuTests - std::min(mCpuTests, testsDone);
    mCpuDone = seconds + static_cast<double>(open) / testsPerSecond;
}

Dispatcher::Turn Dispatcher::giveToCpu(const Item& item)
{
    Turn turn{item.block, Block::kOnCpu, mCpuDone, 0};
    turn.endSeconds = addCpuTests(item.tests);
    return turn;
}

// To `free` if it fits, else to the first that it fits.
Dispatcher::Turn Dispatcher::giveToDevices(const Item& item, std::size_t free)
{
    const double more = (item.isExact ? 0 : mCorrection.ratio - 1) + (item.isTried ? 0 : mCorrection.more);
    const double moreBytes = more * static_cast<double>(item.bytes.down);
    const auto fitsOn = [&](std::size_t d) {
        return item.bytes.total() <= mBudgets[d] &&
               moreBytes <= static_cast<double>(mBudgets[d] - item.bytes.total());
    };
    std::size_t device = free;
    for (std::size_t d = 0; d < mClocks.size() && !fitsOn(device); ++d) {
        if (!mRetired[d] && !mClocks[d].full()) device = d;
    }
    if (!fitsOn(device)) return {item.block, kTooLarge, 0, 0};
    const double start = mClocks[device].begin(item.tests - item.outsideTests, item.bytes.up);
    addCpuTests(item.outsideTests);
    return {item.block, static_cast<int>(device), start, 0};
}

std::optional<Dispatcher::Turn> Dispatcher::next()
{
    // The device that is ready first takes the largest block that it can hold.
    std::optional<std::size_t> free;
    double devicesDone = 0;
    for (std::size_t d = 0; d < mClocks.size(); ++d) {
        if (mRetired[d] || mClocks[d].full()) continue;
        if (!free || mClocks[d].ready() < mClocks[*free].ready()) free = d;
        devicesDone = std::max(devicesDone, mClocks[d].ready());
    }
    if (!mAgain.empty()) {
        const Item item = mAgain.back();
        mAgain.pop_back();
        return free ? giveToDevices(item, *free) : giveToCpu(item);
    }
    if (mItems.empty()) return std::nullopt;
    const Item small = mItems.back();
    const double cpuDone = mCpuDone + static_cast<double>(small.tests) / mOptions.cpuTestsPerSecond;
    const bool cpuEndsSooner =
        mOptions.useCpu && free && mCpuDone <= mClocks[*free].ready() && cpuDone <= devicesDone + mLeft;
    if (cpuEndsSooner || !free) {
        mItems.pop_back();
        mLeft -= shareOf(small);
        return giveToCpu(small);
    }
    const Item large = mItems.front();
    mItems.pop_front();
    mLeft -= shareOf(large);
    return giveToDevices(large, *free);
}

double Dispatcher::finish(int device, std::uint64_t bytesDown)
{
    return mClocks[static_cast<std::size_t>(device)].finish(bytesDown);
}

double Dispatcher::doneSeconds() const
{
    double done = mCpuDone;
    for (const DeviceClock& clock : mClocks) done = std::max(done, clock.done());
    return done;
}

} // namespace vdb_nns
