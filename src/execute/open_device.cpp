// See open_device.h.
#include "execute/open_device.h"

#include "cuda/launch.h"
#include "execute/simulated_device.h"
#include "vdb_nns/error.h"
#include "vdb_nns/executor.h"

#include <algorithm>
#include <thread>
#include <utility>
#include <vector>

namespace vdb_nns {

std::unique_ptr<BlockDevice> openDevice(const DeviceLimits& limits, const SearchRun& run,
                                        ThreadStates& states)
{
    switch (limits.kind) {
    case DeviceKind::kSim:
        return std::make_unique<SimulatedDevice>(limits.name, limits.memoryBytes, run, states);
    case DeviceKind::kCuda:
        return cuda::openBlockDevice(
            {limits.ordinal, limits.name, limits.memoryBytes, limits.slots, limits.mapped});
    case DeviceKind::kCpu:
        break;
    }
    throw InvalidInput("device '" + limits.name + "' is the CPU, which is no device: give none instead");
}

std::vector<DeviceLimits> cudaDevices()
{
    // A guess: 128 lanes at 1.5 GHz, ten operations a test, and a fifth of that.
    constexpr double kTestsOfMultiprocessor = 4e9;
    // A slot is a stream of the device and a thread of the host, which stages and collects its blocks. Three keep the device
    // busy; on a fast link it is the host's copies that bind, so more where there are cores for them.
    constexpr unsigned kFewestSlots = 3, kMostSlots = 8;
    const unsigned slots = std::clamp(std::thread::hardware_concurrency() / 2, kFewestSlots, kMostSlots);
    std::vector<DeviceLimits> devices;
    for (const cuda::Device& found : cuda::listDevices()) {
        DeviceLimits device;
        device.kind = DeviceKind::kCuda;
        device.name = found.name;
        device.memoryBytes = cuda::freeBytes(found.ordinal);
        device.ordinal = found.ordinal;
        device.slots = static_cast<int>(slots);
        device.rates.testsPerSecond = kTestsOfMultiprocessor * found.multiprocessors;
        devices.push_back(std::move(device));
    }
    return devices;
}

} // namespace vdb_nns
