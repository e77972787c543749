// Opens devices by their kind, and finds the CUDA devices that this machine has.
#include "out_of_core/open_device.h"

#include "cuda/launch.h"
#include "out_of_core/simulated_device.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/executor.h"

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
            {limits.ordinal, limits.name, limits.memoryBytes, limits.buffers, limits.mapped});
    case DeviceKind::kCpu:
        break;
    }
    throw InvalidInput("device '" + limits.name + "' is the CPU, which is no device: give none instead");
}

namespace {

constexpr int kLeastCompute = 75; // the kernels are built for it and for what comes after

// Why a device cannot be used; empty if it can. Opens it.
std::string whyNot(const cuda::Device& found, DeviceLimits& limits)
{
    // A guess: 128 lanes at 1.5 GHz, ten operations a test, and a fifth of that.
    constexpr double kTestsOfMultiprocessor = 4e9;
    // A buffer is a stream of the device and a thread of the host, which stages and collects its blocks. Three keep the device
    // busy; on a fast link it is the host's copies that bind, so more where there are cores for them.
    constexpr unsigned kFewestBuffers = 3, kMostBuffers = 8;
    const unsigned buffers =
        std::clamp(std::thread::hardware_concurrency() / 2, kFewestBuffers, kMostBuffers);
    const std::string name = "CUDA device " + std::to_string(found.ordinal) + " (" + found.name + ")";
    if (10 * found.computeMajor + found.computeMinor < kLeastCompute) {
        return name + " has compute capability " + std::to_string(found.computeMajor) + "." +
               std::to_string(found.computeMinor) + ", and 7.5 is the least";
    }
    limits.kind = DeviceKind::kCuda;
    limits.name = found.name;
    limits.ordinal = found.ordinal;
    limits.buffers = static_cast<int>(buffers);
    limits.rates.testsPerSecond = kTestsOfMultiprocessor * found.multiprocessors;
    try {
        limits.memoryBytes = cuda::freeBytes(found.ordinal);
    } catch (const DeviceError& error) {
        return name + " cannot be opened: " + error.what();
    }
    return limits.memoryBytes > 0 ? "" : name + " has no memory free";
}

} // namespace

std::vector<DeviceLimits> cudaDevices(std::vector<std::string>* leftOut)
{
    std::vector<DeviceLimits> devices;
    std::string reasons;
    for (const cuda::Device& found : cuda::listDevices()) {
        DeviceLimits limits;
        const std::string reason = whyNot(found, limits);
        if (reason.empty()) {
            devices.push_back(std::move(limits));
            continue;
        }
        reasons += (reasons.empty() ? "" : "; ") + reason;
        if (leftOut) leftOut->push_back(reason);
    }
    if (devices.empty()) throw DeviceError(reasons.empty() ? "there is no CUDA device" : reasons);
    return devices;
}

DeviceLimits cudaDevice(int ordinal)
{
    const std::vector<cuda::Device> found = cuda::listDevices();
    if (ordinal < 0 || static_cast<std::size_t>(ordinal) >= found.size()) {
        throw DeviceError("there are " + std::to_string(found.size()) + " CUDA devices, numbered from 0");
    }
    DeviceLimits limits;
    const std::string reason = whyNot(found[static_cast<std::size_t>(ordinal)], limits);
    if (!reason.empty()) throw DeviceError(reason);
    return limits;
}

} // namespace vdb_nns
