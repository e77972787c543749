// The kernels' own sources, compiled by the host's compiler over the emulation.
#include <cuda_runtime_api.h>

#include "cuda/search_block.cu"
