// Vectors of doubles for each instruction set: SimdD. Included by the search_*.cpp files only, each compiled with its own flags:
// everything has internal linkage. All lanes do the same IEEE operations, so that results do not depend on their number.
//
// where(m, a, b) takes a in the lanes of m. Integers: added bit patterns of doubles, modulo 2^64; sumFour() adds up all lanes of
// each of four vectors.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__SSE4_1__)
#include <immintrin.h>
#endif

// Inlined by force: vectors that are returned would go over the stack.
#define VDB_NNS_INLINE __attribute__((always_inline)) inline

namespace vdb_nns {
namespace {

#if defined(VDB_NNS_SIMD_AVX512) || defined(VDB_NNS_SIMD_AVX2)

// The lanes of each of four vectors.
VDB_NNS_INLINE void sumFourHalves(const __m256i (&v)[4], std::uint64_t* sums)
{
    __m256i two[2]; // of vectors 0 and 1, and of 2 and 3
    for (int k = 0; k < 2; ++k)
        two[k] = _mm256_add_epi64(_mm256_unpacklo_epi64(v[2 * k], v[2 * k + 1]),
                                  _mm256_unpackhi_epi64(v[2 * k], v[2 * k + 1]));
    const __m256i lower = _mm256_permute2x128_si256(two[0], two[1], 0x20),
                  upper = _mm256_permute2x128_si256(two[0], two[1], 0x31);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(sums), _mm256_add_epi64(lower, upper));
}

#endif

#if defined(VDB_NNS_SIMD_AVX512)

struct SimdD {
    using D = __m512d;
    using I = __m512i;
    using M = __mmask8;
    static constexpr int kLanes = 8;
    static D load(const double* p) { return _mm512_loadu_pd(p); }
    static void store(double* p, D v) { _mm512_storeu_pd(p, v); }
    static D set(double v) { return _mm512_set1_pd(v); }
    static D add(D a, D b) { return _mm512_add_pd(a, b); }
    static D sub(D a, D b) { return _mm512_sub_pd(a, b); }
    static D mul(D a, D b) { return _mm512_mul_pd(a, b); }
    static D div(D a, D b) { return _mm512_div_pd(a, b); }
    static D sqrt(D a) { return _mm512_sqrt_pd(a); }
    static D min(D a, D b) { return _mm512_min_pd(a, b); }
    static D max(D a, D b) { return _mm512_max_pd(a, b); }
    static D abs(D a) { return _mm512_abs_pd(a); }
    static M less(D a, D b) { return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ); }
    static M equal(D a, D b) { return _mm512_cmp_pd_mask(a, b, _CMP_EQ_OQ); }
    static D where(M m, D a, D b) { return _mm512_mask_blend_pd(m, b, a); }
    static I zero() { return _mm512_setzero_si512(); }
    static I addBits(I sum, D v) { return _mm512_add_epi64(sum, _mm512_castpd_si512(v)); }
    static I difference(I a, I b) { return _mm512_sub_epi64(a, b); }
    static I loadBits(const std::uint64_t* p) { return _mm512_loadu_si512(p); }
    static void storeBits(std::uint64_t* p, I v) { _mm512_storeu_si512(p, v); }
    static void sumFour(const I (&v)[4], std::uint64_t* sums)
    {
        __m256i half[4]; // not _mm512_reduce_add_epi64(), which adds signed numbers, which must not wrap
        for (int k = 0; k < 4; ++k)
            half[k] = _mm256_add_epi64(_mm512_castsi512_si256(v[k]), _mm512_extracti64x4_epi64(v[k], 1));
        sumFourHalves(half, sums);
    }
    static double greatest(D v) { return _mm512_reduce_max_pd(v); }
};

#elif defined(VDB_NNS_SIMD_AVX2)

struct SimdD {
    using D = __m256d;
    using I = __m256i;
    using M = __m256d;
    static constexpr int kLanes = 4;
    static D load(const double* p) { return _mm256_loadu_pd(p); }
    static void store(double* p, D v) { _mm256_storeu_pd(p, v); }
    static D set(double v) { return _mm256_set1_pd(v); }
    static D add(D a, D b) { return _mm256_add_pd(a, b); }
    static D sub(D a, D b) { return _mm256_sub_pd(a, b); }
    static D mul(D a, D b) { return _mm256_mul_pd(a, b); }
    static D div(D a, D b) { return _mm256_div_pd(a, b); }
    static D sqrt(D a) { return _mm256_sqrt_pd(a); }
    static D min(D a, D b) { return _mm256_min_pd(a, b); }
    static D max(D a, D b) { return _mm256_max_pd(a, b); }
    static D abs(D a) { return _mm256_andnot_pd(_mm256_set1_pd(-0.0), a); }
    static M less(D a, D b) { return _mm256_cmp_pd(a, b, _CMP_LT_OQ); }
    static M equal(D a, D b) { return _mm256_cmp_pd(a, b, _CMP_EQ_OQ); }
    static D where(M m, D a, D b) { return _mm256_blendv_pd(b, a, m); }
    static I zero() { return _mm256_setzero_si256(); }
    static I addBits(I sum, D v) { return _mm256_add_epi64(sum, _mm256_castpd_si256(v)); }
    static I difference(I a, I b) { return _mm256_sub_epi64(a, b); }
    static I loadBits(const std::uint64_t* p)
    {
        return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
    }
    static void storeBits(std::uint64_t* p, I v) { _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), v); }
    static void sumFour(const I (&v)[4], std::uint64_t* sums) { sumFourHalves(v, sums); }
    static double greatest(D v)
    {
        const __m128d two = _mm_max_pd(_mm256_castpd256_pd128(v), _mm256_extractf128_pd(v, 1));
        return _mm_cvtsd_f64(_mm_max_sd(two, _mm_unpackhi_pd(two, two)));
    }
};

#elif defined(VDB_NNS_SIMD_SSE4)

struct SimdD {
    using D = __m128d;
    using I = __m128i;
    using M = __m128d;
    static constexpr int kLanes = 2;
    static D load(const double* p) { return _mm_loadu_pd(p); }
    static void store(double* p, D v) { _mm_storeu_pd(p, v); }
    static D set(double v) { return _mm_set1_pd(v); }
    static D add(D a, D b) { return _mm_add_pd(a, b); }
    static D sub(D a, D b) { return _mm_sub_pd(a, b); }
    static D mul(D a, D b) { return _mm_mul_pd(a, b); }
    static D div(D a, D b) { return _mm_div_pd(a, b); }
    static D sqrt(D a) { return _mm_sqrt_pd(a); }
    static D min(D a, D b) { return _mm_min_pd(a, b); }
    static D max(D a, D b) { return _mm_max_pd(a, b); }
    static D abs(D a) { return _mm_andnot_pd(_mm_set1_pd(-0.0), a); }
    static M less(D a, D b) { return _mm_cmplt_pd(a, b); }
    static M equal(D a, D b) { return _mm_cmpeq_pd(a, b); }
    static D where(M m, D a, D b) { return _mm_blendv_pd(b, a, m); }
    static I zero() { return _mm_setzero_si128(); }
    static I addBits(I sum, D v) { return _mm_add_epi64(sum, _mm_castpd_si128(v)); }
    static I difference(I a, I b) { return _mm_sub_epi64(a, b); }
    static I loadBits(const std::uint64_t* p) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(p)); }
    static void storeBits(std::uint64_t* p, I v) { _mm_storeu_si128(reinterpret_cast<__m128i*>(p), v); }
    static void sumFour(const I (&v)[4], std::uint64_t* sums)
    {
        for (int k = 0; k < 4; k += 2)
            storeBits(sums + k,
                      _mm_add_epi64(_mm_unpacklo_epi64(v[k], v[k + 1]), _mm_unpackhi_epi64(v[k], v[k + 1])));
    }
    static double greatest(D v) { return _mm_cvtsd_f64(_mm_max_sd(v, _mm_unpackhi_pd(v, v))); }
};

#else

struct SimdD {
    using D = double;
    using I = std::uint64_t;
    using M = bool;
    static constexpr int kLanes = 1;
    static D load(const double* p) { return *p; }
    static void store(double* p, D v) { *p = v; }
    static D set(double v) { return v; }
    static D add(D a, D b) { return a + b; }
    static D sub(D a, D b) { return a - b; }
    static D mul(D a, D b) { return a * b; }
    static D div(D a, D b) { return a / b; }
    static D sqrt(D a) { return __builtin_sqrt(a); }
    static D min(D a, D b) { return a < b ? a : b; }
    static D max(D a, D b) { return a > b ? a : b; }
    static D abs(D a) { return __builtin_fabs(a); }
    static M less(D a, D b) { return a < b; }
    static M equal(D a, D b) { return a == b; }
    static D where(M m, D a, D b) { return m ? a : b; }
    static I zero() { return 0; }
    static I addBits(I sum, D v)
    {
        std::uint64_t bits;
        std::memcpy(&bits, &v, sizeof bits);
        return sum + bits;
    }
    static I difference(I a, I b) { return a - b; }
    static I loadBits(const std::uint64_t* p) { return *p; }
    static void storeBits(std::uint64_t* p, I v) { *p = v; }
    static void sumFour(const I (&v)[4], std::uint64_t* sums)
    {
        for (int k = 0; k < 4; ++k) sums[k] = v[k];
    }
    static double greatest(D v) { return v; }
};

#endif

} // namespace
} // namespace vdb_nns
