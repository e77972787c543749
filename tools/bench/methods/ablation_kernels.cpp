#include "bench/methods/ablation_kernels.h"

#include "vdb_nns/search.h"

#include <algorithm>
#include <cmath>

#if defined(__x86_64__)
#include "bench/methods/ablation_lanes-inl.h"
#endif

namespace vdb_nns::cli {
namespace {

enum class TestKind { kPlain, kBand, kSquares };

template <typename Real>
Real outside(Real v, Real half)
{
    return std::max(std::fabs(v) - half, Real(0));
}

template <typename Real, bool kSample>
std::uint32_t gatherScalar(const CandidateArrays<Real>& from, const CandidateRun* runs,
                           std::uint32_t runCount, const QueryBox<Real>& box, const CandidateSample& sample,
                           const CandidateArrays<Real>& to)
{
    std::uint32_t kept = 0;
    for (std::uint32_t r = 0; r < runCount; ++r) {
        for (std::uint32_t i = runs[r].begin; i < runs[r].end; ++i) {
            if (kSample && sampleHash(from.number[i], sample.key) > sample.most) continue;
            const Real square = squaredDistance(outside(from.x[i] - box.center[0], box.half[0]),
                                                outside(from.y[i] - box.center[1], box.half[1]),
                                                outside(from.z[i] - box.center[2], box.half[2]));
            if (!(square <= box.keep)) continue;
            to.x[kept] = from.x[i];
            to.y[kept] = from.y[i];
            to.z[kept] = from.z[i];
            to.number[kept++] = from.number[i];
        }
    }
    return kept;
}

template <typename Real, TestKind kKind>
QueryHits testScalar(const CandidateArrays<Real>& candidates, std::uint32_t count,
                     const QueryPoint<Real>& query, const PairLimits<Real>& limits, std::uint32_t* numbers,
                     Real* squares)
{
    std::uint32_t hits = 0;
    bool doubtful = false;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Real square =
            squaredDistance(candidates.x[i] - query.x, candidates.y[i] - query.y, candidates.z[i] - query.z);
        if (!(square <= limits.within) || candidates.number[i] == query.number) continue;
        if (kKind == TestKind::kBand) doubtful |= !(square <= limits.sure);
        if (kKind == TestKind::kSquares) squares[hits] = square;
        numbers[hits++] = candidates.number[i];
    }
    return {hits, doubtful};
}

template <typename Real>
AblationKernels<Real> scalarKernels()
{
    return {gatherScalar<Real, false>, gatherScalar<Real, true>, testScalar<Real, TestKind::kPlain>,
            testScalar<Real, TestKind::kBand>, testScalar<Real, TestKind::kSquares>};
}

#if defined(__x86_64__)

VDB_NNS_AVX2_INLINE unsigned drawn(__m256i numbers, __m256i key, __m256i most)
{
    __m256i h = _mm256_mullo_epi32(_mm256_xor_si256(numbers, key), _mm256_set1_epi32(int(0x9e3779b1u)));
    h = _mm256_mullo_epi32(_mm256_xor_si256(h, _mm256_srli_epi32(h, 15)),
                           _mm256_set1_epi32(int(0x85ebca77u)));
    h = _mm256_xor_si256(h, _mm256_srli_epi32(h, 13));
    const __m256i isDrawn = _mm256_cmpeq_epi32(_mm256_min_epu32(h, most), h);
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(isDrawn)));
}

template <typename Real, bool kSample>
VDB_NNS_AVX2 std::uint32_t gatherAvx2(const CandidateArrays<Real>& from, const CandidateRun* runs,
                                      std::uint32_t runCount, const QueryBox<Real>& box,
                                      const CandidateSample& sample, const CandidateArrays<Real>& to)
{
    using L = Lanes<Real>;
    using V = typename L::V;
    const V cx = L::set(box.center[0]), cy = L::set(box.center[1]), cz = L::set(box.center[2]);
    const V hx = L::set(box.half[0]), hy = L::set(box.half[1]), hz = L::set(box.half[2]);
    const V keep = L::set(box.keep);
    const __m256i key = _mm256_set1_epi32(static_cast<int>(sample.key));
    const __m256i most = _mm256_set1_epi32(static_cast<int>(sample.most));
    const CandidateArrays<Real> in = from, out = to; // so that stores cannot change where they are
    std::uint32_t kept = 0;
    for (std::uint32_t r = 0; r < runCount; ++r) {
        const std::uint32_t end = runs[r].end;
        for (std::uint32_t i = runs[r].begin; i < end; i += 8) {
            const V x = L::load(in.x + i), y = L::load(in.y + i), z = L::load(in.z + i);
            const __m256i numbers = loadNumbers(in.number + i);
            const V square = L::squared(L::outside(L::sub(x, cx), hx), L::outside(L::sub(y, cy), hy),
                                        L::outside(L::sub(z, cz), hz));
            unsigned mask = L::lessEqual(square, keep);
            if (end - i < 8) mask &= (1u << (end - i)) - 1;
            if constexpr (kSample) mask &= drawn(numbers, key, most);
            L::storePacked(out.x + kept, x, mask);
            L::storePacked(out.y + kept, y, mask);
            L::storePacked(out.z + kept, z, mask);
            storePacked(out.number + kept, numbers, mask);
            kept += static_cast<std::uint32_t>(__builtin_popcount(mask));
        }
    }
    return kept;
}

template <typename Real, TestKind kKind>
VDB_NNS_AVX2 QueryHits testAvx2(const CandidateArrays<Real>& candidates, std::uint32_t count,
                                const QueryPoint<Real>& query, const PairLimits<Real>& limits,
                                std::uint32_t* numbers, Real* squares)
{
    using L = Lanes<Real>;
    using V = typename L::V;
    const V qx = L::set(query.x), qy = L::set(query.y), qz = L::set(query.z);
    const V within = L::set(limits.within), sure = L::set(limits.sure);
    const __m256i self = _mm256_set1_epi32(static_cast<int>(query.number));
    const CandidateArrays<Real> in = candidates;
    std::uint32_t hits = 0;
    V farthest = L::set(0);
    for (std::uint32_t i = 0; i < count; i += 8) {
        const V square = L::squared(L::sub(L::load(in.x + i), qx), L::sub(L::load(in.y + i), qy),
                                    L::sub(L::load(in.z + i), qz));
        const __m256i candidate = loadNumbers(in.number + i);
        unsigned mask = L::lessEqualWithout(square, within, _mm256_cmpeq_epi32(candidate, self));
        if (count - i < 8) mask &= (1u << (count - i)) - 1;
        if constexpr (kKind == TestKind::kBand) farthest = L::maxUpTo(farthest, square, within);
        if constexpr (kKind == TestKind::kSquares) L::storePacked(squares + hits, square, mask);
        storePacked(numbers + hits, candidate, mask);
        hits += static_cast<std::uint32_t>(__builtin_popcount(mask));
    }
    return {hits, L::lessEqual(farthest, sure) != 255};
}

template <typename Real>
AblationKernels<Real> avx2Kernels()
{
    return {gatherAvx2<Real, false>, gatherAvx2<Real, true>, testAvx2<Real, TestKind::kPlain>,
            testAvx2<Real, TestKind::kBand>, testAvx2<Real, TestKind::kSquares>};
}

#endif

} // namespace

template <typename Real>
AblationKernels<Real> ablationKernels(SimdLevel simd)
{
    const SimdLevel best = bestSimdLevel();
    const SimdLevel level = simd == SimdLevel::kBest ? best : std::min(simd, best);
#if defined(__x86_64__)
    if (level >= SimdLevel::kAvx2) return avx2Kernels<Real>();
#endif
    (void)level;
    return scalarKernels<Real>();
}

template AblationKernels<float> ablationKernels(SimdLevel);
template AblationKernels<double> ablationKernels(SimdLevel);

} // namespace vdb_nns::cli
