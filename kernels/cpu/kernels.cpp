// Asks the processor which instruction sets it has, and chooses the kernels of one. Compiled without flags of its own: it
// runs before anything is known.
#include "cpu/kernels.h"

#include "vdb_nns/search.h"

namespace vdb_nns {

SimdLevel bestSimdLevel()
{
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                      __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")) {
        return SimdLevel::kAvx512;
    }
    if (avx2) return SimdLevel::kAvx2;
    if (__builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt")) return SimdLevel::kSse4;
    return SimdLevel::kScalar;
}

const char* simdLevelName(SimdLevel level)
{
    switch (level) {
    case SimdLevel::kScalar:
        return "scalar";
    case SimdLevel::kSse4:
        return "sse4";
    case SimdLevel::kAvx2:
        return "avx2";
    case SimdLevel::kAvx512:
        return "avx512";
    case SimdLevel::kBest:
        break;
    }
    return simdLevelName(bestSimdLevel());
}

const Kernels& kernelsFor(SimdLevel level)
{
    switch (level == SimdLevel::kBest ? bestSimdLevel() : level) {
    case SimdLevel::kScalar:
        return kKernelsScalar;
    case SimdLevel::kSse4:
        return kKernelsSse4;
    case SimdLevel::kAvx2:
        return kKernelsAvx2;
    default:
        return kKernelsAvx512;
    }
}

} // namespace vdb_nns
