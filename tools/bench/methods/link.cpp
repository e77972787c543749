#include "bench/methods/link.h"

#include "cuda/launch.h"
#include "numbers.h"

#include <algorithm>
#include <cstring>
#include <memory>

namespace vdb_nns::cli {
namespace {

// Two buffers with memory of their own, so that one may upload while the other downloads.
class Link {
public:
    Link(const DeviceLimits& limits, std::uint64_t bytes)
        : mBytes(bytes), mDevice(cuda::openBlockDevice({limits.ordinal, limits.name, 2 * bytes, kSlots}))
    {
        for (std::byte*& memory : mMemory) memory = mDevice->allocate(bytes);
        for (std::byte*& memory : mStaging) {
            memory = mDevice->allocateStaging(bytes);
            std::memset(memory, 1, bytes); // pages that were never written may be read from nowhere
        }
    }

    double up()
    {
        mDevice->upload(0, mMemory[0], mStaging[0], mBytes);
        return gbs(mDevice->wait(0).uploadSeconds);
    }

    double down()
    {
        mDevice->download(1, mStaging[1], mMemory[1], mBytes);
        return gbs(mDevice->wait(1).downloadSeconds);
    }

    void both(double& up, double& down)
    {
        mDevice->upload(0, mMemory[0], mStaging[0], mBytes);
        mDevice->download(1, mStaging[1], mMemory[1], mBytes);
        up = gbs(mDevice->wait(0).uploadSeconds);
        down = gbs(mDevice->wait(1).downloadSeconds);
    }

private:
    static constexpr int kSlots = 2;

    double gbs(double seconds) const
    {
        return seconds > 0 ? 1e-9 * static_cast<double>(mBytes) / seconds : 0;
    }

    const std::uint64_t mBytes;
    const std::unique_ptr<BlockDevice> mDevice;
    std::byte *mMemory[kSlots] = {}, *mStaging[kSlots] = {};
};

} // namespace

std::optional<LinkRates> measureLink(const std::vector<DeviceLimits>& devices)
{
    // Some milliseconds a transfer, so that starting it does not count; and no more than a small part of a small device.
    constexpr std::uint64_t kMostBytes = std::uint64_t(256) << 20, kShare = 16;
    constexpr int kRepeats = 5;
    const auto cuda = std::find_if(devices.begin(), devices.end(), [](const DeviceLimits& device) {
        return device.kind == DeviceKind::kCuda;
    });
    if (cuda == devices.end()) return std::nullopt;
    LinkRates rates;
    rates.name = cuda->name;
    rates.bytes = std::min(kMostBytes, cuda->memoryBytes / kShare) / 4096 * 4096;
    if (rates.bytes == 0) return std::nullopt;
    Link link(*cuda, rates.bytes);
    std::vector<double> up, down, bothUp, bothDown;
    for (int run = 0; run <= kRepeats; ++run) { // the first warms up
        const double upGbs = link.up(), downGbs = link.down();
        double bothUpGbs = 0, bothDownGbs = 0;
        link.both(bothUpGbs, bothDownGbs);
        if (run == 0) continue;
        up.push_back(upGbs);
        down.push_back(downGbs);
        bothUp.push_back(bothUpGbs);
        bothDown.push_back(bothDownGbs);
    }
    rates.upGbs = median(up);
    rates.downGbs = median(down);
    rates.bothUpGbs = median(bothUp);
    rates.bothDownGbs = median(bothDown);
    return rates;
}

} // namespace vdb_nns::cli
