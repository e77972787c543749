// Vectors of floats or 32-bit integers for each instruction set that the search is built for: Simd, the widest, and
// NarrowSimd for what is short and stands anywhere. Included by the
// search_*.cpp files only, each compiled with its own flags: everything has internal linkage.
//
// movesign() gives one bit a lane, lane 0 lowest. compress(v, order(m)) moves the lanes of m to the front, in order; what
// it leaves in the other lanes is finite if v is. stream() writes past the caches, to aligned addresses. For sorting:
// swapLanes<x>(v) has lane i ^ x of v in lane i; lanesOf<bit>(v, w) takes the lanes whose number has the bit from w, the
// others from v. loadFirst() reads 0 <= n < kLanes values; the other lanes are 2^32-1.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(__SSE4_1__)
#include <immintrin.h>
#endif

namespace vdb_nns {
namespace {

#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)

// Lane numbers of the set bits of each 8-bit mask, in order.
struct CompressTable {
    alignas(32) std::uint32_t lanes[256][8];
    constexpr CompressTable() : lanes()
    {
        for (int m = 0; m < 256; ++m) {
            int k = 0;
            for (std::uint32_t b = 0; b < 8; ++b) {
                if (m >> b & 1) lanes[m][k++] = b;
            }
        }
    }
};
alignas(32) constexpr CompressTable kCompress;

struct Simd256 {
    using F = __m256;
    using I = __m256i;
    using Mask = std::uint32_t;
    static constexpr int kLanes = 8;
    static F load(const float* p) { return _mm256_loadu_ps(p); }
    static I load(const std::uint32_t* p) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)); }
    static void store(float* p, F v) { _mm256_storeu_ps(p, v); }
    static void store(std::uint32_t* p, I v) { _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), v); }
    static void stream(std::uint32_t* p, I v) { _mm256_stream_si256(reinterpret_cast<__m256i*>(p), v); }
    static void streamFence() { _mm_sfence(); }
    static F set(float v) { return _mm256_set1_ps(v); }
    static I set(std::int32_t v) { return _mm256_set1_epi32(v); }
    static F add(F a, F b) { return _mm256_add_ps(a, b); }
    static F sub(F a, F b) { return _mm256_sub_ps(a, b); }
    static F mul(F a, F b) { return _mm256_mul_ps(a, b); }
    static F mulAdd(F a, F b, F c) { return _mm256_fmadd_ps(a, b, c); }
    static F min(F a, F b) { return _mm256_min_ps(a, b); }
    static F max(F a, F b) { return _mm256_max_ps(a, b); }
    static F abs(F a) { return _mm256_andnot_ps(_mm256_set1_ps(-0.0f), a); }
    static I bits(F a) { return _mm256_castps_si256(a); }
    static F floatsOf(I a) { return _mm256_castsi256_ps(a); }
    static I min(I a, I b) { return _mm256_min_epi32(a, b); }
    static Mask movesign(F a) { return static_cast<Mask>(_mm256_movemask_ps(a)); }
    static Mask lessEqual(F a, F b) { return movesign(_mm256_cmp_ps(a, b, _CMP_LE_OQ)); }
    static Mask lessEqual(I a, I b) { return ~movesign(_mm256_castsi256_ps(_mm256_cmpgt_epi32(a, b))) & 255; }
    static Mask equal(I a, I b) { return movesign(_mm256_castsi256_ps(_mm256_cmpeq_epi32(a, b))); }
    using Order = __m256i;
    static Order order(Mask m)
    {
        return _mm256_load_si256(reinterpret_cast<const __m256i*>(kCompress.lanes[m]));
    }
    static F compress(F v, Order o) { return _mm256_permutevar8x32_ps(v, o); }
    static I compress(I v, Order o) { return _mm256_permutevar8x32_epi32(v, o); }
    static I minUnsigned(I a, I b) { return _mm256_min_epu32(a, b); }
    static I maxUnsigned(I a, I b) { return _mm256_max_epu32(a, b); }
    template <int kX>
    static I swapLanes(I v)
    {
        if constexpr (kX < 4) return _mm256_shuffle_epi32(v, kX == 1 ? 0xB1 : kX == 2 ? 0x4E : 0x1B);
        if constexpr (kX == 4) return _mm256_permute2x128_si256(v, v, 1);
        return _mm256_permutevar8x32_epi32(v, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0));
    }
    template <int kBit>
    static I lanesOf(I without, I with)
    {
        return _mm256_blend_epi32(without, with, kBit == 1 ? 0xAA : kBit == 2 ? 0xCC : 0xF0);
    }
    static I loadFirst(const std::uint32_t* p, std::ptrdiff_t n)
    {
        const __m256i taken = _mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(n)),
                                                 _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
        return _mm256_or_si256(_mm256_maskload_epi32(reinterpret_cast<const int*>(p), taken),
                               _mm256_xor_si256(taken, _mm256_set1_epi32(-1)));
    }
};

#endif

#if defined(VDB_NNS_SIMD_AVX512)

struct Simd {
    using F = __m512;
    using I = __m512i;
    using Mask = std::uint32_t;
    static constexpr int kLanes = 16;
    static F load(const float* p) { return _mm512_loadu_ps(p); }
    static I load(const std::uint32_t* p) { return _mm512_loadu_si512(p); }
    static void store(float* p, F v) { _mm512_storeu_ps(p, v); }
    static void store(std::uint32_t* p, I v) { _mm512_storeu_si512(p, v); }
    static void stream(std::uint32_t* p, I v) { _mm512_stream_si512(reinterpret_cast<__m512i*>(p), v); }
    static void streamFence() { _mm_sfence(); }
    static F set(float v) { return _mm512_set1_ps(v); }
    static I set(std::int32_t v) { return _mm512_set1_epi32(v); }
    static F add(F a, F b) { return _mm512_add_ps(a, b); }
    static F sub(F a, F b) { return _mm512_sub_ps(a, b); }
    static F mul(F a, F b) { return _mm512_mul_ps(a, b); }
    static F mulAdd(F a, F b, F c) { return _mm512_fmadd_ps(a, b, c); }
    static F min(F a, F b) { return _mm512_min_ps(a, b); }
    static F max(F a, F b) { return _mm512_max_ps(a, b); }
    static F abs(F a) { return _mm512_abs_ps(a); }
    static I bits(F a) { return _mm512_castps_si512(a); }
    static F floatsOf(I a) { return _mm512_castsi512_ps(a); }
    static I min(I a, I b) { return _mm512_min_epi32(a, b); }
    static Mask movesign(F a) { return _mm512_movepi32_mask(_mm512_castps_si512(a)); }
    static Mask lessEqual(F a, F b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
    static Mask lessEqual(I a, I b) { return _mm512_cmple_epi32_mask(a, b); }
    static Mask equal(I a, I b) { return _mm512_cmpeq_epi32_mask(a, b); }
    using Order = __mmask16;
    static Order order(Mask m) { return static_cast<__mmask16>(m); }
    static F compress(F v, Order o) { return _mm512_maskz_compress_ps(o, v); }
    static I compress(I v, Order o) { return _mm512_maskz_compress_epi32(o, v); }
    static I minUnsigned(I a, I b) { return _mm512_min_epu32(a, b); }
    static I maxUnsigned(I a, I b) { return _mm512_max_epu32(a, b); }
    template <int kX>
    static I swapLanes(I v)
    {
        if constexpr (kX < 4) {
            return _mm512_shuffle_epi32(v, static_cast<_MM_PERM_ENUM>(kX == 1   ? 0xB1
                                                                      : kX == 2 ? 0x4E
                                                                                : 0x1B));
        }
        if constexpr (kX == 4) return _mm512_shuffle_i32x4(v, v, 0xB1);
        if constexpr (kX == 8) return _mm512_shuffle_i32x4(v, v, 0x4E);
        if constexpr (kX == 7) return swapLanes<4>(swapLanes<3>(v));
        return _mm512_shuffle_i32x4(swapLanes<3>(v), swapLanes<3>(v), 0x1B);
    }
    template <int kBit>
    static I lanesOf(I without, I with)
    {
        constexpr int lanes = kBit == 1 ? 0xAAAA : kBit == 2 ? 0xCCCC : kBit == 4 ? 0xF0F0 : 0xFF00;
        return _mm512_mask_mov_epi32(without, static_cast<__mmask16>(lanes), with);
    }
    static I loadFirst(const std::uint32_t* p, std::ptrdiff_t n)
    {
        return _mm512_mask_loadu_epi32(_mm512_set1_epi32(-1), static_cast<__mmask16>((1u << n) - 1), p);
    }
};

#elif defined(VDB_NNS_SIMD_AVX2)

using Simd = Simd256;

#elif defined(VDB_NNS_SIMD_SSE4)

// Byte shuffles that move the lanes of each 4-bit mask to the front; 0x80 makes zeros of the rest, which must be finite.
struct CompressTable {
    alignas(16) std::uint8_t bytes[16][16];
    constexpr CompressTable() : bytes()
    {
        for (int m = 0; m < 16; ++m) {
            int k = 0;
            for (std::uint8_t& byte : bytes[m]) byte = 0x80;
            for (int b = 0; b < 4; ++b) {
                if (!(m >> b & 1)) continue;
                for (int c = 0; c < 4; ++c) bytes[m][k * 4 + c] = static_cast<std::uint8_t>(b * 4 + c);
                ++k;
            }
        }
    }
};
alignas(16) constexpr CompressTable kCompress;

struct Simd {
    using F = __m128;
    using I = __m128i;
    using Mask = std::uint32_t;
    static constexpr int kLanes = 4;
    static F load(const float* p) { return _mm_loadu_ps(p); }
    static I load(const std::uint32_t* p) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(p)); }
    static void store(float* p, F v) { _mm_storeu_ps(p, v); }
    static void store(std::uint32_t* p, I v) { _mm_storeu_si128(reinterpret_cast<__m128i*>(p), v); }
    static void stream(std::uint32_t* p, I v) { _mm_stream_si128(reinterpret_cast<__m128i*>(p), v); }
    static void streamFence() { _mm_sfence(); }
    static F set(float v) { return _mm_set1_ps(v); }
    static I set(std::int32_t v) { return _mm_set1_epi32(v); }
    static F add(F a, F b) { return _mm_add_ps(a, b); }
    static F sub(F a, F b) { return _mm_sub_ps(a, b); }
    static F mul(F a, F b) { return _mm_mul_ps(a, b); }
    static F mulAdd(F a, F b, F c) { return _mm_add_ps(_mm_mul_ps(a, b), c); }
    static F min(F a, F b) { return _mm_min_ps(a, b); }
    static F max(F a, F b) { return _mm_max_ps(a, b); }
    static F abs(F a) { return _mm_andnot_ps(_mm_set1_ps(-0.0f), a); }
    static I bits(F a) { return _mm_castps_si128(a); }
    static F floatsOf(I a) { return _mm_castsi128_ps(a); }
    static I min(I a, I b) { return _mm_min_epi32(a, b); }
    static Mask movesign(F a) { return static_cast<Mask>(_mm_movemask_ps(a)); }
    static Mask lessEqual(F a, F b) { return movesign(_mm_cmple_ps(a, b)); }
    static Mask lessEqual(I a, I b) { return ~movesign(_mm_castsi128_ps(_mm_cmpgt_epi32(a, b))) & 15; }
    static Mask equal(I a, I b) { return movesign(_mm_castsi128_ps(_mm_cmpeq_epi32(a, b))); }
    using Order = __m128i;
    static Order order(Mask m)
    {
        return _mm_load_si128(reinterpret_cast<const __m128i*>(kCompress.bytes[m]));
    }
    static F compress(F v, Order o) { return _mm_castsi128_ps(_mm_shuffle_epi8(_mm_castps_si128(v), o)); }
    static I compress(I v, Order o) { return _mm_shuffle_epi8(v, o); }
    static I minUnsigned(I a, I b) { return _mm_min_epu32(a, b); }
    static I maxUnsigned(I a, I b) { return _mm_max_epu32(a, b); }
    template <int kX>
    static I swapLanes(I v)
    {
        return _mm_shuffle_epi32(v, kX == 1 ? 0xB1 : kX == 2 ? 0x4E : 0x1B);
    }
    template <int kBit>
    static I lanesOf(I without, I with)
    {
        return _mm_blend_epi16(without, with, kBit == 1 ? 0xCC : 0xF0);
    }
    static I loadFirst(const std::uint32_t* p, std::ptrdiff_t n)
    {
        std::uint32_t lane[kLanes];
        for (std::ptrdiff_t i = 0; i < kLanes; ++i) lane[i] = i < n ? p[i] : ~0u;
        return load(lane);
    }
};

#else

struct Simd {
    using F = float;
    struct I {
        std::int32_t v;
    };
    using Mask = std::uint32_t;
    static constexpr int kLanes = 1;
    static F load(const float* p) { return *p; }
    static I load(const std::uint32_t* p) { return {static_cast<std::int32_t>(*p)}; }
    static void store(float* p, F v) { *p = v; }
    static void store(std::uint32_t* p, I v) { *p = static_cast<std::uint32_t>(v.v); }
    static void stream(std::uint32_t* p, I v) { store(p, v); }
    static void streamFence() {}
    static F set(float v) { return v; }
    static I set(std::int32_t v) { return {v}; }
    static F add(F a, F b) { return a + b; }
    static F sub(F a, F b) { return a - b; }
    static F mul(F a, F b) { return a * b; }
    static F mulAdd(F a, F b, F c) { return a * b + c; }
    static F min(F a, F b) { return a < b ? a : b; }
    static F max(F a, F b) { return a > b ? a : b; }
    static F abs(F a) { return a < 0 ? -a : a; }
    static I bits(F a)
    {
        I i;
        std::memcpy(&i.v, &a, sizeof i.v);
        return i;
    }
    static F floatsOf(I a)
    {
        F f;
        std::memcpy(&f, &a.v, sizeof f);
        return f;
    }
    static I min(I a, I b) { return a.v < b.v ? a : b; }
    static Mask movesign(F a) { return bits(a).v < 0; }
    static Mask lessEqual(F a, F b) { return a <= b; }
    static Mask lessEqual(I a, I b) { return a.v <= b.v; }
    static Mask equal(I a, I b) { return a.v == b.v; }
    struct Order {};
    static Order order(Mask) { return {}; }
    static F compress(F v, Order) { return v; }
    static I compress(I v, Order) { return v; }
    static I minUnsigned(I a, I b) { return isBelow(b, a) ? b : a; }
    static I maxUnsigned(I a, I b) { return isBelow(b, a) ? a : b; }
    template <int kX>
    static I swapLanes(I v)
    {
        return v;
    }
    template <int kBit>
    static I lanesOf(I without, I)
    {
        return without;
    }
    static I loadFirst(const std::uint32_t*, std::ptrdiff_t) { return {-1}; }

private:
    static bool isBelow(I a, I b)
    {
        return static_cast<std::uint32_t>(a.v) < static_cast<std::uint32_t>(b.v);
    }
};

#endif

// For runs of particles that begin anywhere and are short: 64 bytes at an odd place always touch two lines, and leave more
// lanes empty. Against 64-byte vectors throughout, counts of `block` take 0.72 of the time on a Zen 4.
#if defined(VDB_NNS_SIMD_AVX512)
using NarrowSimd = Simd256;
#else
using NarrowSimd = Simd;
#endif

constexpr Simd::Mask kAllLanes = (1u << Simd::kLanes) - 1;

inline const float* floats(const char* p)
{
    return reinterpret_cast<const float*>(p);
}
inline float* floats(char* p)
{
    return reinterpret_cast<float*>(p);
}
inline const std::uint32_t* integers(const char* p)
{
    return reinterpret_cast<const std::uint32_t*>(p);
}
inline std::uint32_t* integers(char* p)
{
    return reinterpret_cast<std::uint32_t*>(p);
}

// The lowest `n` lanes of v, the others of w. 0 < n < kLanes.
inline NarrowSimd::F firstLanesOr(NarrowSimd::F v, std::uint32_t n, NarrowSimd::F w)
{
    float lane[2 * NarrowSimd::kLanes];
    NarrowSimd::store(lane, v);
    NarrowSimd::store(lane + n, w);
    return NarrowSimd::load(lane);
}

inline float minOfLanes(NarrowSimd::F v)
{
    float lane[2 * NarrowSimd::kLanes];
    NarrowSimd::store(lane, v);
    for (int half = NarrowSimd::kLanes / 2; half > 0; half /= 2) {
        for (int i = 0; i < half; ++i) lane[i] = lane[i + half] < lane[i] ? lane[i + half] : lane[i];
    }
    return lane[0];
}

inline float maxOfLanes(NarrowSimd::F v)
{
    return -minOfLanes(NarrowSimd::sub(NarrowSimd::set(0.0f), v));
}

} // namespace
} // namespace vdb_nns
