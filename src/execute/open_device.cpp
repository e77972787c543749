// See open_device.h.
#include "execute/open_device.h"

#include "cuda/launch.h"
#include "execute/simulated_device.h"
#include "vdb_nns/error.h"
#include "vdb_nns/executor.h"

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
    std::vector<DeviceLimits> devices;
    for (const cuda::Device& found : cuda::listDevices()) {
        DeviceLimits device;
        device.kind = DeviceKind::kCuda;
        device.name = found.name;
        device.memoryBytes = cuda::freeBytes(found.ordinal);
        device.ordinal = found.ordinal;
        device.rates.testsPerSecond = kTestsOfMultiprocessor * found.multiprocessors;
        devices.push_back(std::move(device));
    }
    return devices;
}

} // namespace vdb_nns
