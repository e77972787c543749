// The kernels of measures (measure_rows.h) for the instruction set of the including file. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

// ---------------------------------------------------------------------------------------------------- pairs

// Inlined by force: vectors that are returned would go over the stack.
#define VDB_NNS_INLINE __attribute__((always_inline)) inline

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

VDB_NNS_INLINE __m256i topBits(__m256i packed, int axis)
{
    return _mm256_and_si256(_mm256_slli_epi32(packed, 10 * axis),
                            _mm256_set1_epi32(static_cast<int>(0xffc00000u)));
}

// Voxels of eight records less that of the query: ten bits at the top wrap as the difference does.
VDB_NNS_INLINE EightVectors voxelDifferences(const VoxelPosition10& query, __m256i packed)
{
    EightVectors v;
    const __m256i from = _mm256_set1_epi32(static_cast<int>(query.voxel));
    for (int k = 0; k < 3; ++k) {
        v.axis[k] = doublesOf(_mm256_srai_epi32(_mm256_sub_epi32(topBits(packed, k), topBits(from, k)), 22));
    }
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

VDB_NNS_INLINE EightVectors eightDifferences(const VoxelPosition10& query, const VoxelPosition10* records,
                                             const std::uint32_t* n)
{
    const double from[3] = {static_cast<double>(query.x), static_cast<double>(query.y),
                            static_cast<double>(query.z)};
#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)
    const EightFloats f = eightFloats(&records->x, 4, n);
    const EightVectors offsets = less({{doublesOf(f.x), doublesOf(f.y), doublesOf(f.z)}}, from);
    return sumOf(voxelDifferences(query, _mm256_castps_si256(f.w)), offsets);
#else
    constexpr std::uint32_t kTop = 0xffc00000u;
    const EightVectors voxels = eightBy([&](std::size_t k, double(&d)[3]) {
        for (int c = 0; c < 3; ++c) {
            const std::uint32_t top = (records[n[k]].voxel << 10 * c & kTop) - (query.voxel << 10 * c & kTop);
            d[c] = static_cast<double>(static_cast<std::int32_t>(top) >> 22);
        }
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

VDB_NNS_INLINE void storeEight(double* to, const EightDoubles& v)
{
    for (int p = 0; p < kParts; ++p) SimdD::store(to + p * SimdD::kLanes, v.part[p]);
}

template <typename Record, PairMap::Kind kKind, bool kVectors>
void makePairs(const PairGroups& groups, const Record* records, const PairMap& map, double* x, double* y,
               double* z, double* distance)
{
    using S = SimdD;
    for (std::size_t g = 0; g < groups.groups; ++g) {
        const Record& query = *static_cast<const Record*>(groups.query[groups.row[g]]);
        const std::size_t k = g * kGroup;
        const EightVectors d = eightDifferences(query, records, groups.numbers + k);
        EightVectors w = d;
        EightDoubles length;
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
            length.part[p] = S::sqrt(S::add(S::add(S::mul(wx, wx), S::mul(wy, wy)), S::mul(wz, wz)));
        }
        if (kVectors) {
            storeEight(x + k, w.axis[0]);
            storeEight(y + k, w.axis[1]);
            storeEight(z + k, w.axis[2]);
        }
        storeEight(distance + k, length);
    }
}

template <typename Record, PairMap::Kind kKind>
void makePairsOf(const PairGroups& groups, const Record* records, const PairMap& map, double* x, double* y,
                 double* z, double* distance)
{
    if (x) {
        makePairs<Record, kKind, true>(groups, records, map, x, y, z, distance);
    } else {
        makePairs<Record, kKind, false>(groups, records, map, x, y, z, distance);
    }
}

template <typename Record>
void pairs(const PairGroups& groups, const void* candidates, const PairMap& map, double* x, double* y,
           double* z, double* distance)
{
    using Kind = PairMap::Kind;
    const Record* const records = static_cast<const Record*>(candidates);
    switch (map.kind) {
    case Kind::kIdentity:
        return makePairsOf<Record, Kind::kIdentity>(groups, records, map, x, y, z, distance);
    case Kind::kDiagonal:
        return makePairsOf<Record, Kind::kDiagonal>(groups, records, map, x, y, z, distance);
    case Kind::kGeneral:
        return makePairsOf<Record, Kind::kGeneral>(groups, records, map, x, y, z, distance);
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

// -------------------------------------------------------------------------------------------------- weights

template <PairWeight kWeight>
SimdD::D weightOf(SimdD::D q)
{
    using S = SimdD;
    const S::D one = S::set(1);
    if (kWeight == PairWeight::kCubic) {
        const S::D near = S::add(S::mul(S::mul(S::set(6), S::mul(q, q)), S::sub(q, one)), one);
        const S::D left = S::sub(one, q);
        const S::D far = S::mul(S::add(left, left), S::mul(left, left));
        return S::where(S::less(q, S::set(0.5)), near, far);
    }
    if (kWeight == PairWeight::kWendland2) {
        const S::D left = S::sub(one, q), square = S::mul(left, left);
        return S::mul(S::mul(square, square), S::add(one, S::mul(S::set(4), q)));
    }
    if (kWeight == PairWeight::kPoly6) {
        const S::D left = S::sub(one, S::mul(q, q));
        return S::mul(S::mul(left, left), left);
    }
    if (kWeight == PairWeight::kPca) return S::sub(one, S::mul(S::mul(q, q), q));
    return one;
}

// Ones for the pairs of a group, zeros for its pads.
struct PairMasks {
    alignas(64) double lane[kGroup + 1][kGroup];
    constexpr PairMasks() : lane()
    {
        for (std::size_t pairs = 0; pairs <= kGroup; ++pairs) {
            for (std::size_t k = 0; k < pairs; ++k) lane[pairs][k] = 1;
        }
    }
};
alignas(64) constexpr PairMasks kPairMasks;

template <PairWeight kWeight>
void weigh(const PairGroups& groups, const double* distance, const double* inverse, std::size_t inverseStep,
           double* out)
{
    using S = SimdD;
    const S::D first = S::set(inverse[0]);
    for (std::size_t g = 0; g < groups.groups; ++g) {
        const double* const mask = kPairMasks.lane[groups.pairs[g]];
        for (std::size_t lane = 0; lane < kGroup; lane += S::kLanes) {
            const std::size_t k = g * kGroup + lane;
            const S::D by = inverseStep == 0 ? first : S::load(inverse + k);
            const S::D q = S::min(S::mul(S::load(distance + k), by), S::set(1));
            S::store(out + k, S::mul(weightOf<kWeight>(q), S::load(mask + lane)));
        }
    }
}

inline void weights(PairWeight weight, const PairGroups& groups, const double* distance,
                    const double* inverse, std::size_t inverseStep, double* out)
{
    switch (weight) {
    case PairWeight::kCubic:
        return weigh<PairWeight::kCubic>(groups, distance, inverse, inverseStep, out);
    case PairWeight::kWendland2:
        return weigh<PairWeight::kWendland2>(groups, distance, inverse, inverseStep, out);
    case PairWeight::kPoly6:
        return weigh<PairWeight::kPoly6>(groups, distance, inverse, inverseStep, out);
    case PairWeight::kTophat:
        return weigh<PairWeight::kTophat>(groups, distance, inverse, inverseStep, out);
    case PairWeight::kPca:
        return weigh<PairWeight::kPca>(groups, distance, inverse, inverseStep, out);
    }
}

// ----------------------------------------------------------------------------------------------------- sums

// 1.5 * 2^52 + an integer below 2^51 has the integer as its lowest bits.
constexpr double kShift = 6755399441055744.0;
constexpr std::uint64_t kShiftBits = 0x4338000000000000u;

inline double powerOfTwo(int exponent)
{
    const std::uint64_t bits = static_cast<std::uint64_t>(exponent + 1023) << 52;
    double power;
    std::memcpy(&power, &bits, sizeof power);
    return power;
}

// What brings the terms of a row, of magnitudes up to `greatest`, to integers.
inline RowScale scaleOf(double greatest, std::uint32_t count)
{
    constexpr int kLeastExponent = -900; // what is smaller would need a scale that no double holds
    std::uint64_t bits;
    std::memcpy(&bits, &greatest, sizeof bits);
    int exponent = static_cast<int>(bits >> 52) - 1022; // the greatest is below 2^exponent
    if (exponent > 1024) return {0, __builtin_inf()};
    if (exponent < kLeastExponent) exponent = kLeastExponent;
    const int spare = 62 - (32 - __builtin_clz(count | 1));
    const int most = spare < 50 ? spare : 50;
    return {powerOfTwo(most - exponent), powerOfTwo(exponent - most)};
}

// Pairs and pads.
inline std::uint32_t pairsOfRow(const PairGroups& groups, std::size_t r)
{
    return (groups.firstGroup[r + 1] - groups.firstGroup[r]) * static_cast<std::uint32_t>(kGroup);
}

// scaleOf() of each row by the largest of magnitude(k), a vector of lanes from the pair k on.
template <typename Magnitude>
VDB_NNS_INLINE void scaleRows(const PairGroups& groups, const double* greatest, RowScale* out,
                              Magnitude&& magnitude)
{
    using S = SimdD;
    for (std::size_t r = 0; r < groups.rows; ++r) {
        double most = greatest ? greatest[r] : 0;
        if (!(most > 0)) {
            S::D largest = S::set(0);
            const std::size_t end = groups.firstGroup[r + 1] * kGroup;
            for (std::size_t k = groups.firstGroup[r] * kGroup; k < end; k += S::kLanes)
                largest = S::max(largest, magnitude(k));
            most = S::greatest(largest);
        }
        out[r] = scaleOf(most, pairsOfRow(groups, r));
    }
}

inline void scales(const PairGroups& groups, const double* greatest, const double* weight,
                   const double* const* factors, int factorCount, RowScale* out)
{
    using S = SimdD;
    const auto factor = [&](int f, std::size_t k) { return S::abs(S::load(factors[f] + k)); };
    if (factorCount == 0) {
        scaleRows(groups, greatest, out, [&](std::size_t k) { return S::load(weight + k); });
    } else if (factorCount == 1) {
        scaleRows(groups, greatest, out,
                  [&](std::size_t k) { return S::mul(S::load(weight + k), factor(0, k)); });
    } else {
        scaleRows(groups, greatest, out, [&](std::size_t k) {
            const S::D largest = S::max(S::max(factor(0, k), factor(1, k)), factor(2, k));
            return S::mul(S::load(weight + k), largest);
        });
    }
}

// Adds up the scaled terms of all groups, `kSums` at once: term(k, t) writes those from the pair k on. A row's sum is then the
// difference of two running sums, modulo 2^64.
template <int kSums, typename Term>
VDB_NNS_INLINE void sumRows(const PairGroups& groups, const RowScale* scales, std::uint64_t* scratch,
                            double* out, Term&& term)
{
    using S = SimdD;
    S::I running[kSums];
    for (S::I& sum : running) sum = S::zero();
    const auto note = [&](std::size_t g) {
        for (int n = 0; n < kSums; ++n)
            S::storeBits(scratch + (g * kSums + static_cast<std::size_t>(n)) * S::kLanes, running[n]);
    };
    note(0);
    for (std::size_t g = 0; g < groups.groups; ++g) {
        const S::D scale = S::set(scales[groups.row[g]].scale);
        for (std::size_t lane = 0; lane < kGroup; lane += S::kLanes) {
            S::D terms[kSums];
            term(g * kGroup + lane, terms);
            for (int n = 0; n < kSums; ++n)
                running[n] = S::addBits(running[n], S::add(S::mul(terms[n], scale), S::set(kShift)));
        }
        note(g + 1);
    }
    for (std::size_t r = 0; r < groups.rows; ++r) {
        const std::size_t first = groups.firstGroup[r], end = groups.firstGroup[r + 1];
        for (std::size_t n = 0; n < kSums; ++n, ++out) {
            const std::uint64_t sum =
                S::sum(S::difference(S::loadBits(scratch + (end * kSums + n) * S::kLanes),
                                     S::loadBits(scratch + (first * kSums + n) * S::kLanes))) -
                (end - first) * kGroup * kShiftBits;
            // Without a scale terms are infinite.
            *out = scales[r].scale > 0
                       ? static_cast<double>(static_cast<std::int64_t>(sum)) * scales[r].inverse
                       : scales[r].inverse;
        }
    }
}

inline void sums(const PairGroups& groups, const RowScale* scales, const double* weight,
                 const double* const* factors, int factorCount, std::uint64_t* scratch, double* out)
{
    using S = SimdD;
    if (factorCount == 0) {
        sumRows<1>(groups, scales, scratch, out,
                   [&](std::size_t k, S::D(&terms)[1]) { terms[0] = S::load(weight + k); });
    } else if (factorCount == 1) {
        sumRows<1>(groups, scales, scratch, out, [&](std::size_t k, S::D(&terms)[1]) {
            terms[0] = S::mul(S::load(weight + k), S::load(factors[0] + k));
        });
    } else {
        sumRows<3>(groups, scales, scratch, out, [&](std::size_t k, S::D(&terms)[3]) {
            const S::D w = S::load(weight + k);
            for (int f = 0; f < 3; ++f) terms[f] = S::mul(w, S::load(factors[f] + k));
        });
    }
}

inline void moments(const PairGroups& groups, const double* weight, const double* x, const double* y,
                    const double* z, const double* centers, RowScale* rowScales, std::uint64_t* scratch,
                    double* out)
{
    using S = SimdD;
    const auto fromCenter = [&](std::size_t k, S::D(&d)[3]) {
        const double* const center = centers + std::size_t(3) * groups.row[k / kGroup];
        d[0] = S::sub(S::load(x + k), S::set(center[0]));
        d[1] = S::sub(S::load(y + k), S::set(center[1]));
        d[2] = S::sub(S::load(z + k), S::set(center[2]));
    };
    // Each product is at most the square, and its roundings are far below the bits that are left.
    scaleRows(groups, nullptr, rowScales, [&](std::size_t k) {
        S::D d[3];
        fromCenter(k, d);
        const S::D square = S::add(S::add(S::mul(d[0], d[0]), S::mul(d[1], d[1])), S::mul(d[2], d[2]));
        return S::mul(S::load(weight + k), square);
    });
    sumRows<6>(groups, rowScales, scratch, out, [&](std::size_t k, S::D(&terms)[6]) {
        S::D d[3];
        fromCenter(k, d);
        const S::D w = S::load(weight + k);
        const S::D wx = S::mul(w, d[0]), wy = S::mul(w, d[1]), wz = S::mul(w, d[2]);
        terms[0] = S::mul(wx, d[0]);
        terms[1] = S::mul(wy, d[1]);
        terms[2] = S::mul(wz, d[2]);
        terms[3] = S::mul(wx, d[1]);
        terms[4] = S::mul(wx, d[2]);
        terms[5] = S::mul(wy, d[2]);
    });
}

inline void least(const PairGroups& groups, double* distance, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < groups.rows; ++r) {
        S::D nearest = S::set(__builtin_inf());
        const std::size_t end = groups.firstGroup[r + 1] * kGroup;
        for (std::size_t k = groups.firstGroup[r] * kGroup; k < end; k += S::kLanes)
            nearest = S::min(nearest, S::load(distance + k));   // pads repeat the last pair
        out[r] = 0.0 - S::greatest(S::sub(S::set(0), nearest)); // never a negative zero
    }
    for (std::size_t g = 0; g < groups.groups; ++g) {
        for (std::size_t lane = 0; lane < kGroup; lane += S::kLanes) {
            double* const d = distance + g * kGroup + lane;
            S::store(d, S::mul(S::load(d), S::load(kPairMasks.lane[groups.pairs[g]] + lane)));
        }
    }
}

// ----------------------------------------------------------------------------------------------------- eigen

// One rotation of the plane (p, q), r being the third axis: the off-diagonal apq becomes 0.
inline void rotate(SimdD::D& app, SimdD::D& aqq, SimdD::D& apq, SimdD::D& arp, SimdD::D& arq, SimdD::D* vp,
                   SimdD::D* vq)
{
    using S = SimdD;
    const S::D zero = S::set(0), one = S::set(1);
    const S::D h = S::sub(aqq, app), two = S::add(apq, apq);
    const S::D root = S::sqrt(S::add(S::mul(h, h), S::mul(two, two)));
    const S::D under = S::where(S::less(h, zero), S::sub(h, root), S::add(h, root));
    S::D t = S::div(two, under);
    t = S::where(S::equal(under, zero), zero, t); // apq is 0, or its square is
    const S::D c = S::div(one, S::sqrt(S::add(S::mul(t, t), one))), s = S::mul(t, c);
    const S::D moved = S::mul(t, apq);
    app = S::sub(app, moved);
    aqq = S::add(aqq, moved);
    apq = zero;
    const auto turn = [&](S::D& a, S::D& b) {
        const S::D p = a, q = b;
        a = S::sub(S::mul(c, p), S::mul(s, q));
        b = S::add(S::mul(s, p), S::mul(c, q));
    };
    turn(arp, arq);
    for (int k = 0; k < 3; ++k) turn(vp[k], vq[k]);
}

// A power of two that brings the largest of six numbers to about 1, so that their squares stay within the range.
inline double scaleOfMatrix(const double* matrix)
{
    double largest = 0;
    for (int p = 0; p < 6; ++p) {
        const double magnitude = __builtin_fabs(matrix[p]);
        largest = magnitude > largest ? magnitude : largest;
    }
    std::uint64_t bits;
    std::memcpy(&bits, &largest, sizeof bits);
    const int exponent = static_cast<int>(bits >> 52) - 1023;
    return exponent > 1000 || exponent < -1000 ? 1 : powerOfTwo(-exponent);
}

inline void eigen(const double* matrices, std::size_t count, double* out)
{
    using S = SimdD;
    constexpr int kSweeps =
        4; // after which off-diagonals of 4 million random and graded matrices were below 1e-19 of the rest
    for (std::size_t i = 0; i < count; i += S::kLanes) {
        double lanes[kEigenNumbers][S::kLanes], inverse[S::kLanes];
        S::D a[6];
        for (std::size_t l = 0; l < S::kLanes; ++l) {
            const double* const matrix = matrices + 6 * (i + l);
            const double scale = scaleOfMatrix(matrix);
            inverse[l] = 1 / scale;
            for (std::size_t p = 0; p < 6; ++p) lanes[p][l] = matrix[p] * scale;
        }
        for (int p = 0; p < 6; ++p) a[p] = S::load(lanes[p]);
        S::D v[3][3]; // of each vector x, y and z
        for (int k = 0; k < 3; ++k) {
            for (int c = 0; c < 3; ++c) v[k][c] = S::set(k == c ? 1 : 0);
        }
        for (int sweep = 0; sweep < kSweeps; ++sweep) {
            rotate(a[0], a[1], a[3], a[4], a[5], v[0], v[1]);
            rotate(a[0], a[2], a[4], a[3], a[5], v[0], v[2]);
            rotate(a[1], a[2], a[5], a[3], a[4], v[1], v[2]);
        }
        for (int k = 0; k < 3; ++k) {
            S::store(lanes[k], S::mul(a[k], S::load(inverse)));
            for (int c = 0; c < 3; ++c) S::store(lanes[3 + 3 * c + k], v[k][c]);
        }
        for (int l = 0; l < S::kLanes; ++l) {
            for (std::size_t n = 0; n < kEigenNumbers; ++n)
                out[kEigenNumbers * (i + static_cast<std::size_t>(l)) + n] = lanes[n][l];
        }
    }
}

#undef VDB_NNS_INLINE

constexpr MeasureKernels kMeasureKernels = {
    {pairs<FloatPosition>, pairs<DoublePosition>, pairs<VoxelPosition10>, pairs<WideVoxelPosition>},
    {vectors<FloatPosition>, vectors<DoublePosition>},
    {scalars<float>, scalars<double>},
    weights,
    scales,
    sums,
    moments,
    least,
    eigen};

} // namespace
} // namespace vdb_nns
