// What nvcc knows about this build.
#include "cuda/launch.h"
#include "util/build_config.h"

#define VDB_NNS_TEXT2(x) #x
#define VDB_NNS_TEXT(x) VDB_NNS_TEXT2(x)

namespace vdb_nns::cuda {

const char* buildDescription()
{
    return VDB_NNS_TEXT(__CUDACC_VER_MAJOR__) "." VDB_NNS_TEXT(
        __CUDACC_VER_MINOR__) " for " VDB_NNS_CUDA_ARCHITECTURES;
}

} // namespace vdb_nns::cuda
