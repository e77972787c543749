// The one way in which a CUDA call is checked: VDB_NNS_CUDA_CHECK(cudaSomething(...)) throws a DeviceError with the
// call, the code and the place. For files that nvcc compiles, and for host files that include the CUDA runtime.
#pragma once

#include "vdb_nns/error.h"

#include <cuda_runtime_api.h>
#include <string>

namespace vdb_nns::cuda {

inline void checkCall(cudaError_t code, const char* call, const char* file, int line)
{
    if (code == cudaSuccess) return;
    std::string place = file;
    place = place.substr(place.find_last_of('/') + 1) + ":" + std::to_string(line);
    throw DeviceError("CUDA: " + std::string(cudaGetErrorString(code)) + " (" + cudaGetErrorName(code) +
                      ", code " + std::to_string(static_cast<int>(code)) + ") from " + call + " at " + place);
}

} // namespace vdb_nns::cuda

#define VDB_NNS_CUDA_CHECK(call) ::vdb_nns::cuda::checkCall((call), #call, __FILE__, __LINE__)
