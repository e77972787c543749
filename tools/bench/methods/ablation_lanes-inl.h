// Eight floats or doubles by AVX2, for ablation_kernels.cpp alone. Every function carries its instruction set by itself, so
// the file needs no flags and leaves no code with it to others.
#pragma once

#include <array>
#include <cstdint>

#include <immintrin.h>

#define VDB_NNS_AVX2 __attribute__((target("avx2")))
#define VDB_NNS_AVX2_INLINE __attribute__((target("avx2"), always_inline)) static inline

namespace vdb_nns::cli {
namespace {

// For each mask the lanes whose bit is set, lowest first, as 32-bit lanes of a vector; `kParts` of them to an element.
template <unsigned kElements, unsigned kParts>
constexpr std::array<std::array<std::uint8_t, 8>, (1u << kElements)> packOrders()
{
    std::array<std::array<std::uint8_t, 8>, (1u << kElements)> orders{};
    for (unsigned mask = 0; mask < (1u << kElements); ++mask) {
        unsigned out = 0;
        for (unsigned lane = 0; lane < kElements; ++lane) {
            if (!(mask >> lane & 1)) continue;
            for (unsigned part = 0; part < kParts; ++part) {
                orders[mask][out++] = static_cast<std::uint8_t>(lane * kParts + part);
            }
        }
    }
    return orders;
}

alignas(64) constexpr auto kFloatOrders = packOrders<8, 1>();
alignas(64) constexpr auto kDoubleOrders = packOrders<4, 2>();

VDB_NNS_AVX2_INLINE __m256i orderOf(const std::uint8_t* bytes)
{
    return _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(bytes)));
}

VDB_NNS_AVX2_INLINE __m256i loadNumbers(const std::uint32_t* p)
{
    return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p));
}

VDB_NNS_AVX2_INLINE void storePacked(std::uint32_t* p, __m256i numbers, unsigned mask)
{
    const __m256i packed = _mm256_permutevar8x32_epi32(numbers, orderOf(kFloatOrders[mask].data()));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), packed);
}

template <typename Real>
struct Lanes;

template <>
struct Lanes<float> {
    using V = __m256;

    VDB_NNS_AVX2_INLINE V load(const float* p) { return _mm256_loadu_ps(p); }
    VDB_NNS_AVX2_INLINE V set(float x) { return _mm256_set1_ps(x); }
    VDB_NNS_AVX2_INLINE V sub(V a, V b) { return _mm256_sub_ps(a, b); }

    // max(|v| - half, 0)
    VDB_NNS_AVX2_INLINE V outside(V v, V half)
    {
        const V abs = _mm256_andnot_ps(_mm256_set1_ps(-0.0f), v);
        return _mm256_max_ps(_mm256_sub_ps(abs, half), _mm256_setzero_ps());
    }
    VDB_NNS_AVX2_INLINE V squared(V x, V y, V z)
    {
        return _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(x, x), _mm256_mul_ps(y, y)), _mm256_mul_ps(z, z));
    }
    VDB_NNS_AVX2_INLINE unsigned lessEqual(V a, V b)
    {
        return static_cast<unsigned>(_mm256_movemask_ps(_mm256_cmp_ps(a, b, _CMP_LE_OQ)));
    }
    // a <= b in lanes that `without` does not have
    VDB_NNS_AVX2_INLINE unsigned lessEqualWithout(V a, V b, __m256i without)
    {
        const __m256 hits = _mm256_andnot_ps(_mm256_castsi256_ps(without), _mm256_cmp_ps(a, b, _CMP_LE_OQ));
        return static_cast<unsigned>(_mm256_movemask_ps(hits));
    }
    // The larger of `most` and those of v that are at most `limit`; none is negative.
    VDB_NNS_AVX2_INLINE V maxUpTo(V most, V v, V limit)
    {
        return _mm256_max_ps(most, _mm256_and_ps(v, _mm256_cmp_ps(v, limit, _CMP_LE_OQ)));
    }
    VDB_NNS_AVX2_INLINE void storePacked(float* p, V v, unsigned mask)
    {
        _mm256_storeu_ps(p, _mm256_permutevar8x32_ps(v, orderOf(kFloatOrders[mask].data())));
    }
};

template <>
struct Lanes<double> {
    struct V {
        __m256d low, high;
    };

    VDB_NNS_AVX2_INLINE V load(const double* p) { return {_mm256_loadu_pd(p), _mm256_loadu_pd(p + 4)}; }
    VDB_NNS_AVX2_INLINE V set(double x) { return {_mm256_set1_pd(x), _mm256_set1_pd(x)}; }
    VDB_NNS_AVX2_INLINE V sub(V a, V b)
    {
        return {_mm256_sub_pd(a.low, b.low), _mm256_sub_pd(a.high, b.high)};
    }
    VDB_NNS_AVX2_INLINE V outside(V v, V half)
    {
        return {outside(v.low, half.low), outside(v.high, half.high)};
    }
    VDB_NNS_AVX2_INLINE V squared(V x, V y, V z)
    {
        return {squared(x.low, y.low, z.low), squared(x.high, y.high, z.high)};
    }
    VDB_NNS_AVX2_INLINE unsigned lessEqual(V a, V b)
    {
        const int low = _mm256_movemask_pd(_mm256_cmp_pd(a.low, b.low, _CMP_LE_OQ));
        const int high = _mm256_movemask_pd(_mm256_cmp_pd(a.high, b.high, _CMP_LE_OQ));
        return static_cast<unsigned>(low | high << 4);
    }
    VDB_NNS_AVX2_INLINE unsigned lessEqualWithout(V a, V b, __m256i without)
    {
        return lessEqual(a, b) & ~static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(without)));
    }
    VDB_NNS_AVX2_INLINE V maxUpTo(V most, V v, V limit)
    {
        return {maxUpTo(most.low, v.low, limit.low), maxUpTo(most.high, v.high, limit.high)};
    }
    VDB_NNS_AVX2_INLINE void storePacked(double* p, V v, unsigned mask)
    {
        storePacked(p, v.low, mask & 15);
        storePacked(p + __builtin_popcount(mask & 15), v.high, mask >> 4);
    }

private:
    VDB_NNS_AVX2_INLINE __m256d outside(__m256d v, __m256d half)
    {
        const __m256d abs = _mm256_andnot_pd(_mm256_set1_pd(-0.0), v);
        return _mm256_max_pd(_mm256_sub_pd(abs, half), _mm256_setzero_pd());
    }
    VDB_NNS_AVX2_INLINE __m256d squared(__m256d x, __m256d y, __m256d z)
    {
        return _mm256_add_pd(_mm256_add_pd(_mm256_mul_pd(x, x), _mm256_mul_pd(y, y)), _mm256_mul_pd(z, z));
    }
    VDB_NNS_AVX2_INLINE __m256d maxUpTo(__m256d most, __m256d v, __m256d limit)
    {
        return _mm256_max_pd(most, _mm256_and_pd(v, _mm256_cmp_pd(v, limit, _CMP_LE_OQ)));
    }
    VDB_NNS_AVX2_INLINE void storePacked(double* p, __m256d v, unsigned mask)
    {
        const __m256i order = orderOf(kDoubleOrders[mask].data());
        _mm256_storeu_ps(reinterpret_cast<float*>(p), _mm256_permutevar8x32_ps(_mm256_castpd_ps(v), order));
    }
};

} // namespace
} // namespace vdb_nns::cli
