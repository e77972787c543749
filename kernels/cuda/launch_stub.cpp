// The device layer of a build without CUDA: every function that would need a device throws a sentence.
#include "cuda/launch.h"

#include "vdb_nns/error.h"

namespace vdb_nns::cuda {

const char* buildDescription()
{
    return "absent";
}

namespace {

DeviceError noCuda()
{
    return DeviceError(
        "vdb_nns was built without CUDA, so it has no CUDA devices; use the CPU, or build it with "
        "-DVDB_NNS_CUDA=ON where there is a CUDA toolkit");
}

} // namespace

std::vector<Device> listDevices()
{
    throw noCuda();
}

std::uint64_t freeBytes(int)
{
    throw noCuda();
}

std::unique_ptr<BlockDevice> openBlockDevice(const OpenOptions&)
{
    throw noCuda();
}

} // namespace vdb_nns::cuda
