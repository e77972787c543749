// What vdb_nns/version.h promises. git_hash.h is written at every build, build_config.h by CMake.
#include "vdb_nns/version.h"

#include "cuda/launch.h"
#include "util/build_config.h"
#include "util/git_hash.h"
#include "vdb_nns/search.h"

#include <string>

namespace vdb_nns {

static std::string describeBuild()
{
    return std::string("vdb_nns " VDB_NNS_VERSION ", commit " VDB_NNS_GIT_HASH "\ncompiler: " VDB_NNS_COMPILER
                       ", " VDB_NNS_BUILD_TYPE "\nlibraries: OpenVDB " VDB_NNS_OPENVDB_VERSION
                       ", oneTBB " VDB_NNS_TBB_VERSION
                       "\ninstruction sets: scalar, SSE4, AVX2, AVX-512; this processor: ") +
           simdLevelName(bestSimdLevel()) + "\nCUDA: " + cudaBuild() + " (" VDB_NNS_CUDA_WHY ")";
}

const char* buildInfo()
{
    static const std::string text = describeBuild();
    return text.c_str();
}

const char* cudaBuild()
{
    return cuda::buildDescription();
}

} // namespace vdb_nns
