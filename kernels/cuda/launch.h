// The device layer as plain C++: any compiler reads this header, and nothing in it is CUDA's. It is defined by the .cu
// files beside it when CUDA is built and by launch_stub.cpp when it is not. Which of the two is linked is decided by
// VDB_NNS_CUDA at configure time and by nothing else: callers do not ask, they call.
#pragma once

#include "shared/block_device.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::cuda {

/// A CUDA device that this process sees.
struct Device {
    int ordinal; ///< what `cuda:N` calls it
    std::string name;
    std::uint64_t totalBytes; ///< memory of the device; the driver keeps some of it
    int computeMajor, computeMinor;
    int multiprocessors;
};

/// "absent", or the toolkit and the architectures that this was built for, e.g. "13.0 for sm_75".
const char* buildDescription();

/// All visible devices, in the order of the runtime; at least one.
/// @throws DeviceError when this was built without CUDA, when there is no driver or no device, or when a call fails;
///         the message has the call, the code and the place.
std::vector<Device> listDevices();

/// Memory of a device that is free once the kernels are loaded, less what is left to the driver.
/// @throws DeviceError
std::uint64_t freeBytes(int ordinal);

struct OpenOptions {
    int ordinal = 0;
    std::string name; ///< for messages
    std::uint64_t budgetBytes = 0;
    int buffers = 3;
    bool mapped =
        false; ///< blocks stay in host memory, and kernels read and write them through the link: a baseline
};

/// @throws DeviceError
std::unique_ptr<BlockDevice> openBlockDevice(const OpenOptions& options);

} // namespace vdb_nns::cuda
