// The one place where kernels are launched. Under nvcc it is the triple angle brackets with a range for profilers and a
// check; other compilers hand the kernel to an emulation of the CUDA runtime, which brings its own cuda_runtime_api.h.
#pragma once

#include "cuda/cuda_check.h"

#if defined(__CUDACC__)
#include <nvtx3/nvToolsExt.h>
#endif

#include <cstddef>

namespace vdb_nns::cuda {

/// Starts a kernel on a stream. @throws DeviceError if it cannot start
template <typename... Parameters, typename... Arguments>
void launch(const char* label, void (*kernel)(Parameters...), std::size_t blocks, unsigned threads,
            cudaStream_t stream, const Arguments&... arguments)
{
    const auto grid = static_cast<unsigned>(blocks);
#if defined(__CUDACC__)
    nvtxRangePushA(label);
    kernel<<<grid, threads, 0, stream>>>(arguments...);
    nvtxRangePop();
#else
    simt::launchAsync(kernel, grid, threads, 0, stream, arguments...);
#endif
    checkCall(cudaGetLastError(), label, __FILE__, __LINE__);
}

} // namespace vdb_nns::cuda
