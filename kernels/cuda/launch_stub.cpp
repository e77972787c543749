// The device layer of a build without CUDA: every function that would need a device throws a sentence.
#include "cuda/launch.h"

#include "vdb_nns/error.h"

namespace vdb_nns::cuda {

const char* buildDescription()
{
    return "absent";
}

std::vector<Device> listDevices()
{
    throw DeviceError(
        "vdb_nns was built without CUDA, so it has no CUDA devices; use the CPU, or build it with "
        "-DVDB_NNS_CUDA=ON where there is a CUDA toolkit");
}

} // namespace vdb_nns::cuda
