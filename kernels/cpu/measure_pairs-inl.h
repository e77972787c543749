// Pairs of measures (measure_rows.h) for the instruction set of the including file: differences and distances, and values of the
// candidates. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

constexpr int kParts = static_cast<int>(kPairPad) / SimdD::kLanes;

// A number for each of kPairPad pairs.
struct EightDoubles {
    SimdD::D part[kParts];
};
struct EightVectors {
    EightDoubles axis[3];
};

#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)

struct EightFloats {
    __m256 x, y, z, w;
};

// Eight times four floats that begin `stride` floats apart.
VDB_NNS_INLINE EightFloats eightFloats(const float* records, std::size_t stride, const std::uint32_t* n)
{
    const auto two = [&](int low, int high) {
        return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(records + stride * n[low])),
                                    _mm_loadu_ps(records + stride * n[high]), 1);
    };
    const __m256 a = two(0, 4), b = two(1, 5), c = two(2, 6), d = two(3, 7);
    const __m256 xyAB = _mm256_unpacklo_ps(a, b), zwAB = _mm256_unpackhi_ps(a, b);
    const __m256 xyCD = _mm256_unpacklo_ps(c, d), zwCD = _mm256_unpackhi_ps(c, d);
    return {_mm256_shuffle_ps(xyAB, xyCD, 0x44), _mm256_shuffle_ps(xyAB, xyCD, 0xee),
            _mm256_shuffle_ps(zwAB, zwCD, 0x44), _mm256_shuffle_ps(zwAB, zwCD, 0xee)};
}

VDB_NNS_INLINE EightDoubles doublesOf(__m256 v)
{
#if defined(VDB_NNS_SIMD_AVX512)
    return {{_mm512_cvtps_pd(v)}};
#else
    return {{_mm256_cvtps_pd(_mm256_castps256_ps128(v)), _mm256_cvtps_pd(_mm256_extractf128_ps(v, 1))}};
#endif
}

VDB_NNS_INLINE EightDoubles doublesOf(__m256i v)
{
#if defined(VDB_NNS_SIMD_AVX512)
    return {{_mm512_cvtepi32_pd(v)}};
#else
    return {
        {_mm256_cvtepi32_pd(_mm256_castsi256_si128(v)), _mm256_cvtepi32_pd(_mm256_extracti128_si256(v, 1))}};
#endif
}

VDB_NNS_INLINE EightVectors eightVectors(const FloatPosition* records, const std::uint32_t* n)
{
    const EightFloats f = eightFloats(&records->x, 4, n);
    return {{doublesOf(f.x), doublesOf(f.y), doublesOf(f.z)}};
}

VDB_NNS_INLINE EightVectors eightVectors(const DoublePosition* records, const std::uint32_t* n)
{
    EightVectors v;
    __m256d part[3][2];
    for (int half = 0; half < 2; ++half, n += 4) {
        const __m256d a = _mm256_loadu_pd(&records[n[0]].x), b = _mm256_loadu_pd(&records[n[1]].x),
                      c = _mm256_loadu_pd(&records[n[2]].x), d = _mm256_loadu_pd(&records[n[3]].x);
        const __m256d xzAB = _mm256_unpacklo_pd(a, b), xzCD = _mm256_unpacklo_pd(c, d);
        part[0][half] = _mm256_permute2f128_pd(xzAB, xzCD, 0x20);
        part[2][half] = _mm256_permute2f128_pd(xzAB, xzCD, 0x31);
        part[1][half] = _mm256_permute2f128_pd(_mm256_unpackhi_pd(a, b), _mm256_unpackhi_pd(c, d), 0x20);
    }
    for (int k = 0; k < 3; ++k) {
#if defined(VDB_NNS_SIMD_AVX512)
        v.axis[k].part[0] = _mm512_insertf64x4(_mm512_castpd256_pd512(part[k][0]), part[k][1], 1);
#else
        v.axis[k].part[0] = part[k][0];
        v.axis[k].part[1] = part[k][1];
#endif
    }
    return v;
}

// Voxels of eight records less that of the query.
VDB_NNS_INLINE EightVectors voxelDifferences(const VoxelPosition9& query, __m256i packed)
{
    using V = VoxelPosition9;
    EightVectors v;
    const __m256i from = _mm256_set1_epi32(static_cast<int>(query.voxel - V::kBorrow));
    const __m256i difference = _mm256_sub_epi32(packed, from);
    for (int k = 0; k < 3; ++k)
        v.axis[k] =
            doublesOf(_mm256_srai_epi32(_mm256_slli_epi32(difference, V::kNextAxis * k), 32 - V::kBits));
    return v;
}

#else

template <typename Read>
VDB_NNS_INLINE EightVectors eightBy(Read&& read)
{
    double lane[3][kPairPad];
    for (std::size_t k = 0; k < kPairPad; ++k) {
        double d[3];
        read(k, d);
        for (int c = 0; c < 3; ++c) lane[c][k] = d[c];
    }
    EightVectors v;
    for (int c = 0; c < 3; ++c) {
        for (int p = 0; p < kParts; ++p) v.axis[c].part[p] = SimdD::load(lane[c] + p * SimdD::kLanes);
    }
    return v;
}

template <typename Record> // x, y and z
VDB_NNS_INLINE EightVectors eightVectors(const Record* records, const std::uint32_t* n)
{
    return eightBy([&](std::size_t k, double(&d)[3]) {
        const Record& r = records[n[k]];
        d[0] = static_cast<double>(r.x);
        d[1] = static_cast<double>(r.y);
        d[2] = static_cast<double>(r.z);
    });
}

#endif

VDB_NNS_INLINE EightVectors less(const EightVectors& a, const double (&b)[3])
{
    EightVectors v;
    for (int c = 0; c < 3; ++c) {
        for (int p = 0; p < kParts; ++p) v.axis[c].part[p] = SimdD::sub(a.axis[c].part[p], SimdD::set(b[c]));
    }
    return v;
}

VDB_NNS_INLINE EightVectors sumOf(const EightVectors& a, const EightVectors& b)
{
    EightVectors v;
    for (int c = 0; c < 3; ++c) {
        for (int p = 0; p < kParts; ++p) v.axis[c].part[p] = SimdD::add(a.axis[c].part[p], b.axis[c].part[p]);
    }
    return v;
}

// Candidate less query, of eight candidates.
VDB_NNS_INLINE EightVectors eightDifferences(const FloatPosition& query, const FloatPosition* records,
                                             const std::uint32_t* n)
{
    const double from[3] = {static_cast<double>(query.x), static_cast<double>(query.y),
                            static_cast<double>(query.z)};
    return less(eightVectors(records, n), from);
}

VDB_NNS_INLINE EightVectors eightDifferences(const DoublePosition& query, const DoublePosition* records,
                                             const std::uint32_t* n)
{
    const double from[3] = {query.x, query.y, query.z};
    return less(eightVectors(records, n), from);
}

VDB_NNS_INLINE EightVectors eightDifferences(const VoxelPosition9& query, const VoxelPosition9* records,
                                             const std::uint32_t* n)
{
    const double from[3] = {static_cast<double>(query.x), static_cast<double>(query.y),
                            static_cast<double>(query.z)};
#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)
    const EightFloats f = eightFloats(&records->x, 4, n);
    const EightVectors offsets = less({{doublesOf(f.x), doublesOf(f.y), doublesOf(f.z)}}, from);
    return sumOf(voxelDifferences(query, _mm256_castps_si256(f.w)), offsets);
#else
    const EightVectors voxels = eightBy([&](std::size_t k, double(&d)[3]) {
        const std::uint32_t difference = records[n[k]].voxel + VoxelPosition9::kBorrow - query.voxel;
        for (int c = 0; c < 3; ++c) d[c] = VoxelPosition9::axisOf(difference, c);
    });
    return sumOf(voxels, less(eightVectors(records, n), from));
#endif
}

VDB_NNS_INLINE EightVectors eightDifferences(const WideVoxelPosition& query, const WideVoxelPosition* records,
                                             const std::uint32_t* n)
{
    double voxel[3], offset[3];
    for (int c = 0; c < 3; ++c) {
        voxel[c] = query.voxel[c];
        offset[c] = static_cast<double>(query.offset[c]);
    }
#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)
    const EightFloats v = eightFloats(reinterpret_cast<const float*>(records->voxel), 8, n);
    const EightFloats f = eightFloats(records->offset, 8, n);
    const auto integers = [](__m256 bits) { return doublesOf(_mm256_castps_si256(bits)); };
    return sumOf(less({{integers(v.x), integers(v.y), integers(v.z)}}, voxel),
                 less({{doublesOf(f.x), doublesOf(f.y), doublesOf(f.z)}}, offset));
#else
    const EightVectors voxels = eightBy([&](std::size_t k, double(&d)[3]) {
        for (int c = 0; c < 3; ++c) d[c] = records[n[k]].voxel[c];
    });
    const EightVectors offsets = eightBy([&](std::size_t k, double(&d)[3]) {
        for (int c = 0; c < 3; ++c) d[c] = static_cast<double>(records[n[k]].offset[c]);
    });
    return sumOf(less(voxels, voxel), less(offsets, offset));
#endif
}

#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)

VDB_NNS_INLINE __m256i eightSlots(const FloatPosition* records, const std::uint32_t* n)
{
    return _mm256_castps_si256(eightFloats(&records->x, 4, n).w);
}

VDB_NNS_INLINE __m256i eightSlots(const DoublePosition* records, const std::uint32_t* n)
{
    __m256 half[2];
    for (int h = 0; h < 2; ++h, n += 4) { // what eightVectors() loads too
        const __m256d ab =
            _mm256_unpackhi_pd(_mm256_loadu_pd(&records[n[0]].x), _mm256_loadu_pd(&records[n[1]].x));
        const __m256d cd =
            _mm256_unpackhi_pd(_mm256_loadu_pd(&records[n[2]].x), _mm256_loadu_pd(&records[n[3]].x));
        half[h] = _mm256_castpd_ps(_mm256_permute2f128_pd(ab, cd, 0x31));
    }
    const __m256 low = _mm256_shuffle_ps(half[0], half[1], 0x88); // 0 1 4 5, 2 3 6 7
    return _mm256_permute4x64_epi64(_mm256_castps_si256(low), 0xd8);
}

template <typename Record>
VDB_NNS_INLINE void eightPlaces(const Record* records, const std::uint32_t* n, std::uint32_t pairs,
                                const LeafPlaces& places, std::uint32_t* out)
{
    const __m256i lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    const __m256i outside = _mm256_add_epi32(_mm256_set1_epi32(static_cast<int>(places.particles)), lane);
    const __m256i place =
        _mm256_sub_epi32(eightSlots(records, n), _mm256_set1_epi32(static_cast<int>(places.firstSlot)));
    const __m256i isPair = _mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(pairs)), lane);
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out),
                        _mm256_blendv_epi8(outside, _mm256_min_epu32(place, outside), isPair));
}

#else

template <typename Record>
VDB_NNS_INLINE void eightPlaces(const Record* records, const std::uint32_t* n, std::uint32_t pairs,
                                const LeafPlaces& places, std::uint32_t* out)
{
    for (std::uint32_t k = 0; k < kPairPad; ++k) {
        const std::uint32_t place = static_cast<std::uint32_t>(records[n[k]].slot) - places.firstSlot;
        out[k] = k < pairs && place < places.particles ? place : places.particles + k;
    }
}

#endif

// Those records have no slot.
inline void eightPlaces(const VoxelPosition9*, const std::uint32_t*, std::uint32_t, const LeafPlaces&,
                        std::uint32_t*)
{
}
inline void eightPlaces(const WideVoxelPosition*, const std::uint32_t*, std::uint32_t, const LeafPlaces&,
                        std::uint32_t*)
{
}

VDB_NNS_INLINE void storeEight(double* to, const EightDoubles& v)
{
    for (int p = 0; p < kParts; ++p) SimdD::store(to + p * SimdD::kLanes, v.part[p]);
}

// What is made besides the squares.
enum class Besides { kNothing, kVectors, kPlaces };

template <typename Record, PairMap::Kind kKind, Besides kBesides>
void makePairs(const PairGroups& groups, const Record* queries, const Record* records, const PairMap& map,
               const LeafPlaces& places, double* x, double* y, double* z, double* square)
{
    using S = SimdD;
    for (std::size_t g = 0; g < groups.groups; ++g) {
        const Record& query = queries[groups.query[groups.row[g]]];
        const std::size_t k = g * kGroup;
        const EightVectors d = eightDifferences(query, records, groups.numbers + k);
        EightVectors w = d;
        EightDoubles squares;
        for (int p = 0; p < kParts; ++p) {
            for (int r = 0; r < 3; ++r) {
                S::D& to = w.axis[r].part[p];
                if (kKind == PairMap::Kind::kDiagonal) to = S::mul(S::set(map.m[r][r]), to);
                if (kKind == PairMap::Kind::kGeneral) {
                    to = S::add(S::add(S::mul(S::set(map.m[r][0]), d.axis[0].part[p]),
                                       S::mul(S::set(map.m[r][1]), d.axis[1].part[p])),
                                S::mul(S::set(map.m[r][2]), d.axis[2].part[p]));
                }
            }
            const S::D wx = w.axis[0].part[p], wy = w.axis[1].part[p], wz = w.axis[2].part[p];
            squares.part[p] = S::add(S::add(S::mul(wx, wx), S::mul(wy, wy)), S::mul(wz, wz));
        }
        if (kBesides == Besides::kVectors) {
            storeEight(x + k, w.axis[0]);
            storeEight(y + k, w.axis[1]);
            storeEight(z + k, w.axis[2]);
        }
        if (kBesides == Besides::kPlaces)
            eightPlaces(records, groups.numbers + k, groups.pairs[g], places, places.out + k);
        storeEight(square + k, squares);
    }
}

template <typename Record, PairMap::Kind kKind>
void makePairsOf(const PairGroups& groups, const Record* queries, const Record* records, const PairMap& map,
                 const LeafPlaces& places, double* x, double* y, double* z, double* square)
{
    if (x) {
        makePairs<Record, kKind, Besides::kVectors>(groups, queries, records, map, places, x, y, z, square);
    } else if (places.out) {
        makePairs<Record, kKind, Besides::kPlaces>(groups, queries, records, map, places, x, y, z, square);
    } else {
        makePairs<Record, kKind, Besides::kNothing>(groups, queries, records, map, places, x, y, z, square);
    }
}

template <typename Record>
void pairs(const PairGroups& groups, const void* queries, const void* candidates, const PairMap& map,
           const LeafPlaces& places, double* x, double* y, double* z, double* square)
{
    using Kind = PairMap::Kind;
    const Record* const from = static_cast<const Record*>(queries);
    const Record* const to = static_cast<const Record*>(candidates);
    switch (map.kind) {
    case Kind::kIdentity:
        return makePairsOf<Record, Kind::kIdentity>(groups, from, to, map, places, x, y, z, square);
    case Kind::kDiagonal:
        return makePairsOf<Record, Kind::kDiagonal>(groups, from, to, map, places, x, y, z, square);
    case Kind::kGeneral:
        return makePairsOf<Record, Kind::kGeneral>(groups, from, to, map, places, x, y, z, square);
    }
}

template <typename Record>
void vectors(const PairGroups& groups, const void* values, double* x, double* y, double* z)
{
    for (std::size_t g = 0; g < groups.groups; ++g) {
        const std::size_t k = g * kGroup;
        const EightVectors v = eightVectors(static_cast<const Record*>(values), groups.numbers + k);
        storeEight(x + k, v.axis[0]);
        storeEight(y + k, v.axis[1]);
        storeEight(z + k, v.axis[2]);
    }
}

template <typename Real>
void scalars(const PairGroups& groups, const void* values, double* out)
{
    for (std::size_t k = 0; k < groups.groups * kGroup; ++k)
        out[k] = static_cast<double>(static_cast<const Real*>(values)[groups.numbers[k]]);
}

} // namespace
} // namespace vdb_nns
