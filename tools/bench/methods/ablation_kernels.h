// The two loops of the part methods: gather the candidates near a box of queries, test a query against them. Floats and
// doubles, 8 at a time by AVX2 or one by one; both give the same bits, since nothing is fused.
#pragma once

#include "vdb_nns/search_options.h"

#include <cstdint>

namespace vdb_nns::cli {

/// Loops read and write whole vectors: this many values behind the last one must be there.
constexpr std::uint32_t kVectorSlack = 8;

template <typename Real>
struct CandidateArrays {
    Real *x, *y, *z;
    std::uint32_t* number; ///< of the particle
};

/// Candidates that stand together.
struct CandidateRun {
    std::uint32_t begin, end;
};

/// Candidates farther from the box than that are nobody's neighbors.
template <typename Real>
struct QueryBox {
    Real center[3], half[3];
    Real keep; ///< squared, and a little more
};

/// Which candidates are drawn: those whose hash with `key` is at most `most`.
struct CandidateSample {
    std::uint32_t key = 0, most = 0xffffffffu;
};

inline std::uint32_t sampleHash(std::uint32_t number, std::uint32_t key)
{
    std::uint32_t h = (number ^ key) * 0x9e3779b1u;
    h = (h ^ h >> 15) * 0x85ebca77u;
    return h ^ h >> 13;
}

template <typename Real>
struct QueryPoint {
    Real x, y, z;
    std::uint32_t number; ///< excluded from its own row
};

/// Squared distances.
template <typename Real>
struct PairLimits {
    Real within; ///< neighbors up to here
    Real sure;   ///< the certified test: above here somebody else decides
};

struct QueryHits {
    std::uint32_t count;
    bool doubtful; ///< some may be above `sure`
};

template <typename Real>
inline Real squaredDistance(Real dx, Real dy, Real dz)
{
    return dx * dx + dy * dy + dz * dz;
}

/// Returns how many candidates of the runs were copied to `to`, in their order.
template <typename Real>
using GatherFunction = std::uint32_t (*)(const CandidateArrays<Real>& from, const CandidateRun* runs,
                                         std::uint32_t runCount, const QueryBox<Real>& box,
                                         const CandidateSample& sample, const CandidateArrays<Real>& to);

/// Writes the numbers of the hits, and their squared distances if there is a place for them.
template <typename Real>
using TestFunction = QueryHits (*)(const CandidateArrays<Real>& candidates, std::uint32_t count,
                                   const QueryPoint<Real>& query, const PairLimits<Real>& limits,
                                   std::uint32_t* numbers, Real* squares);

template <typename Real>
struct AblationKernels {
    GatherFunction<Real> gather, gatherSample; ///< `sample` counts for the second alone
    TestFunction<Real> test;                   ///< neither `sure` nor `squares` are looked at
    TestFunction<Real> testBand;               ///< with QueryHits::doubtful
    TestFunction<Real> testSquares;            ///< with squared distances
};

/// AVX2 where the processor has it and `simd` allows it. For float and double.
template <typename Real>
AblationKernels<Real> ablationKernels(SimdLevel simd);

} // namespace vdb_nns::cli
