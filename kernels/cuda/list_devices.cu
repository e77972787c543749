// The devices of this machine. The runtime is linked statically and opens the driver at its first call, so a program
// with this inside starts on machines that have none.
#include "cuda/cuda_check.h"
#include "cuda/launch.h"
#include "util/build_config.h"

#define VDB_NNS_TEXT2(x) #x
#define VDB_NNS_TEXT(x) VDB_NNS_TEXT2(x)

namespace vdb_nns::cuda {

const char* buildDescription()
{
    return VDB_NNS_TEXT(__CUDACC_VER_MAJOR__) "." VDB_NNS_TEXT(
        __CUDACC_VER_MINOR__) " for sm_" VDB_NNS_CUDA_ARCHITECTURES;
}

std::vector<Device> listDevices()
{
    int count = 0;
    VDB_NNS_CUDA_CHECK(cudaGetDeviceCount(&count));
    std::vector<Device> devices;
    for (int ordinal = 0; ordinal < count; ++ordinal) {
        cudaDeviceProp properties;
        VDB_NNS_CUDA_CHECK(cudaGetDeviceProperties(&properties, ordinal));
        devices.push_back(
            {ordinal, properties.name, properties.totalGlobalMem, properties.major, properties.minor});
    }
    return devices;
}

} // namespace vdb_nns::cuda
