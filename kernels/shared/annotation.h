// The one host/device macro. Any compiler.
#pragma once

#if defined(__CUDACC__)
#define VDB_NNS_HOST_DEVICE __host__ __device__
#else
#define VDB_NNS_HOST_DEVICE
#endif
