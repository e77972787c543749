// The search of one block on a CUDA device, as host code starts it. Any compiler that finds the CUDA runtime's header.
#pragma once

#include "shared/block_device.h"

#include <cuda_runtime_api.h>

namespace vdb_nns::cuda {

/// Loads all kernels into the current device, which the driver else does at the first launch of each: while that is timed, and
/// when the device may be full.
/// @throws DeviceError
void loadKernels();

/// Starts the kernels of a block on a stream. The result has the layout of shared/block_result.h: counts and masks, or
/// counts and numbers of neighbors, or counts alone. Allocates nothing and waits for nothing.
/// @throws DeviceError if a kernel cannot start
void launchSearchAsync(const BlockSearch& search, cudaStream_t stream);

} // namespace vdb_nns::cuda
