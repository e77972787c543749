// The kernels of measures (measure_rows.h) for the instruction set of the including file. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

// ---------------------------------------------------------------------------------------------------- pairs

constexpr std::uint32_t paddedPairs(std::uint32_t count)
{
    return (count + static_cast<std::uint32_t>(kPairPad) - 1) & ~static_cast<std::uint32_t>(kPairPad - 1);
}

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

// 0 < count < kPairPad numbers, and the last of them again as often as it takes.
inline void lastNumbers(const std::uint32_t* numbers, std::uint32_t count, std::uint32_t* out)
{
#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)
    const __m256i wanted = _mm256_cmpgt_epi32(_mm256_set1_epi32(static_cast<int>(count)),
                                              _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
    const __m256i taken = _mm256_maskload_epi32(reinterpret_cast<const int*>(numbers), wanted);
    const __m256i last = _mm256_set1_epi32(static_cast<int>(numbers[count - 1]));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(out), _mm256_blendv_epi8(last, taken, wanted));
#else
    for (std::uint32_t i = 0; i < kPairPad; ++i) out[i] = numbers[i < count ? i : count - 1];
#endif
}

template <typename Record, PairMap::Kind kKind, bool kVectors>
void makePairs(const Record& query, const Record* records, const PairMap& map, const std::uint32_t* numbers,
               std::uint32_t count, double* x, double* y, double* z, double* distance)
{
    using S = SimdD;
    const auto eight = [&](std::uint32_t k, const std::uint32_t* n) __attribute__((always_inline))
    {
        const EightVectors d = eightDifferences(query, records, n);
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
    };
    std::uint32_t k = 0;
    for (; k + kPairPad <= count; k += kPairPad) eight(k, numbers + k);
    if (k == count) return;
    std::uint32_t last[kPairPad];
    lastNumbers(numbers + k, count - k, last);
    eight(k, last);
}

template <typename Record, PairMap::Kind kKind>
void makePairsOf(const Record& query, const Record* records, const PairMap& map, const std::uint32_t* numbers,
                 std::uint32_t count, double* x, double* y, double* z, double* distance)
{
    if (x) {
        makePairs<Record, kKind, true>(query, records, map, numbers, count, x, y, z, distance);
    } else {
        makePairs<Record, kKind, false>(query, records, map, numbers, count, x, y, z, distance);
    }
}

template <typename Record>
void pairs(const void* query, const void* candidates, const PairMap& map, const std::uint32_t* numbers,
           std::uint32_t count, double* x, double* y, double* z, double* distance)
{
    using Kind = PairMap::Kind;
    const Record& from = *static_cast<const Record*>(query);
    const Record* const records = static_cast<const Record*>(candidates);
    switch (map.kind) {
    case Kind::kIdentity:
        return makePairsOf<Record, Kind::kIdentity>(from, records, map, numbers, count, x, y, z, distance);
    case Kind::kDiagonal:
        return makePairsOf<Record, Kind::kDiagonal>(from, records, map, numbers, count, x, y, z, distance);
    case Kind::kGeneral:
        return makePairsOf<Record, Kind::kGeneral>(from, records, map, numbers, count, x, y, z, distance);
    }
}

template <typename Record>
void vectors(const void* values, const std::uint32_t* numbers, std::size_t count, double* x, double* y,
             double* z)
{
    for (std::size_t k = 0; k < count; k += kPairPad) {
        const EightVectors v = eightVectors(static_cast<const Record*>(values), numbers + k);
        storeEight(x + k, v.axis[0]);
        storeEight(y + k, v.axis[1]);
        storeEight(z + k, v.axis[2]);
    }
}

template <typename Real>
void scalars(const void* values, const std::uint32_t* numbers, std::size_t count, double* out)
{
    for (std::size_t k = 0; k < count; ++k)
        out[k] = static_cast<double>(static_cast<const Real*>(values)[numbers[k]]);
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

// ----------------------------------------------------------------------------------------------------- sums

// What brings the terms of a row to integers. 1.5 * 2^52 + an integer below 2^51 has the integer as its lowest bits.
struct IntegerScale {
    static constexpr double kShift = 6755399441055744.0;
    static constexpr std::uint64_t kShiftBits = 0x4338000000000000u;

    double scale, inverse;
    bool isFinite;

    // For `count` terms of magnitudes up to `greatest`.
    IntegerScale(double greatest, std::uint32_t count)
    {
        std::uint64_t bits;
        std::memcpy(&bits, &greatest, sizeof bits);
        int exponent = static_cast<int>(bits >> 52) - 1022; // the greatest is below 2^exponent
        isFinite = exponent <= 1024;
        if (exponent < kLeastExponent) exponent = kLeastExponent;
        const int spare = 62 - (32 - __builtin_clz(count | 1));
        const int most = spare < 50 ? spare : 50;
        scale = powerOfTwo(most - exponent);
        inverse = powerOfTwo(exponent - most);
    }

private:
    static constexpr int kLeastExponent = -900; // what is smaller would need a scale that no double holds

    static double powerOfTwo(int exponent)
    {
        const std::uint64_t bits = static_cast<std::uint64_t>(exponent + 1023) << 52;
        double power;
        std::memcpy(&power, &bits, sizeof power);
        return power;
    }
};

// The sum of terms that have been scaled.
class IntegerSum {
public:
    explicit IntegerSum(SimdD::D scale) : mScale(scale) {}

    void add(SimdD::D term)
    {
        mSum = SimdD::addBits(mSum, SimdD::add(SimdD::mul(term, mScale), SimdD::set(IntegerScale::kShift)));
    }

    // After so many terms, pads included.
    double value(const IntegerScale& scale, std::uint32_t terms) const
    {
        const std::uint64_t sum = SimdD::sum(mSum) - terms * IntegerScale::kShiftBits;
        return static_cast<double>(static_cast<std::int64_t>(sum)) * scale.inverse;
    }

private:
    SimdD::D mScale;
    SimdD::I mSum = SimdD::zero();
};

template <typename Term>
double sumOfRow(std::uint32_t begin, std::uint32_t count, Term&& term)
{
    using S = SimdD;
    const std::uint32_t end = begin + paddedPairs(count);
    S::D greatest = S::set(0);
    for (std::uint32_t k = begin; k < end; k += S::kLanes) greatest = S::max(greatest, S::abs(term(k)));
    const IntegerScale scale(S::greatest(greatest), count);
    if (!scale.isFinite) return S::greatest(greatest);
    IntegerSum sum(S::set(scale.scale));
    for (std::uint32_t k = begin; k < end; k += S::kLanes) sum.add(term(k));
    return sum.value(scale, end - begin);
}

inline void sums(const PairRows& rows, const double* weight, const double* factor, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < rows.rows; ++r) {
        out[r] =
            factor
                ? sumOfRow(rows.begin[r], rows.count[r],
                           [&](std::uint32_t k) { return S::mul(S::load(weight + k), S::load(factor + k)); })
                : sumOfRow(rows.begin[r], rows.count[r],
                           [&](std::uint32_t k) { return S::load(weight + k); });
    }
}

inline void vectorSums(const PairRows& rows, const double* weight, const double* x, const double* y,
                       const double* z, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < rows.rows; ++r, out += 3) {
        const std::uint32_t begin = rows.begin[r], end = begin + paddedPairs(rows.count[r]);
        S::D greatest = S::set(0);
        for (std::uint32_t k = begin; k < end; k += S::kLanes) {
            const S::D largest =
                S::max(S::max(S::abs(S::load(x + k)), S::abs(S::load(y + k))), S::abs(S::load(z + k)));
            greatest = S::max(greatest, S::mul(S::load(weight + k), largest));
        }
        const IntegerScale scale(S::greatest(greatest), rows.count[r]);
        if (!scale.isFinite) {
            out[0] = out[1] = out[2] = S::greatest(greatest);
            continue;
        }
        const S::D by = S::set(scale.scale);
        IntegerSum sumX(by), sumY(by), sumZ(by);
        for (std::uint32_t k = begin; k < end; k += S::kLanes) {
            const S::D w = S::load(weight + k);
            sumX.add(S::mul(w, S::load(x + k)));
            sumY.add(S::mul(w, S::load(y + k)));
            sumZ.add(S::mul(w, S::load(z + k)));
        }
        out[0] = sumX.value(scale, end - begin);
        out[1] = sumY.value(scale, end - begin);
        out[2] = sumZ.value(scale, end - begin);
    }
}

inline void momentSums(const PairRows& rows, const double* weight, const double* x, const double* y,
                       const double* z, const double* centers, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < rows.rows; ++r, out += 6, centers += 3) {
        const std::uint32_t begin = rows.begin[r], end = begin + paddedPairs(rows.count[r]);
        const S::D cx = S::set(centers[0]), cy = S::set(centers[1]), cz = S::set(centers[2]);
        S::D greatest = S::set(0);
        for (std::uint32_t k = begin; k < end; k += S::kLanes) {
            const S::D dx = S::sub(S::load(x + k), cx), dy = S::sub(S::load(y + k), cy),
                       dz = S::sub(S::load(z + k), cz);
            const S::D square = S::add(S::add(S::mul(dx, dx), S::mul(dy, dy)), S::mul(dz, dz));
            greatest = S::max(greatest, S::mul(S::load(weight + k), square));
        }
        // Each product is at most the square, and its roundings are far below the bits that are left.
        const IntegerScale scale(S::greatest(greatest), rows.count[r]);
        if (!scale.isFinite) {
            for (int p = 0; p < 6; ++p) out[p] = S::greatest(greatest);
            continue;
        }
        const S::D by = S::set(scale.scale);
        IntegerSum xx(by), yy(by), zz(by), xy(by), xz(by), yz(by);
        for (std::uint32_t k = begin; k < end; k += S::kLanes) {
            const S::D dx = S::sub(S::load(x + k), cx), dy = S::sub(S::load(y + k), cy),
                       dz = S::sub(S::load(z + k), cz);
            const S::D w = S::load(weight + k);
            const S::D wx = S::mul(w, dx), wy = S::mul(w, dy), wz = S::mul(w, dz);
            xx.add(S::mul(wx, dx));
            yy.add(S::mul(wy, dy));
            zz.add(S::mul(wz, dz));
            xy.add(S::mul(wx, dy));
            xz.add(S::mul(wx, dz));
            yz.add(S::mul(wy, dz));
        }
        const IntegerSum* const parts[6] = {&xx, &yy, &zz, &xy, &xz, &yz};
        for (int p = 0; p < 6; ++p) out[p] = parts[p]->value(scale, end - begin);
    }
}

template <PairWeight kWeight>
double weigh(std::uint32_t pairs, const double* distance, const double* inverse, std::size_t inverseStep,
             double most, double* out)
{
    using S = SimdD;
    const std::uint32_t end = paddedPairs(pairs);
    const S::D first = S::set(inverse[0]);
    S::D greatest = S::set(most);
    for (std::uint32_t k = 0; k < end; k += S::kLanes) {
        const S::D by = inverseStep == 0 ? first : S::load(inverse + k);
        const S::D q = S::min(S::mul(S::load(distance + k), by), S::set(1));
        const S::D weight = S::first(weightOf<kWeight>(q), std::ptrdiff_t(pairs) - std::ptrdiff_t(k));
        S::store(out + k, weight);
        greatest = S::max(greatest, weight);
    }
    const IntegerScale scale(most > 0 ? most : S::greatest(greatest), pairs);
    IntegerSum sum(S::set(scale.scale));
    for (std::uint32_t k = 0; k < end; k += S::kLanes) sum.add(S::load(out + k));
    return sum.value(scale, end);
}

inline double weights(PairWeight weight, std::uint32_t pairs, const double* distance, const double* inverse,
                      std::size_t inverseStep, double greatest, double* out)
{
    switch (weight) {
    case PairWeight::kCubic:
        return weigh<PairWeight::kCubic>(pairs, distance, inverse, inverseStep, greatest, out);
    case PairWeight::kWendland2:
        return weigh<PairWeight::kWendland2>(pairs, distance, inverse, inverseStep, greatest, out);
    case PairWeight::kPoly6:
        return weigh<PairWeight::kPoly6>(pairs, distance, inverse, inverseStep, greatest, out);
    case PairWeight::kTophat:
        return weigh<PairWeight::kTophat>(pairs, distance, inverse, inverseStep, greatest, out);
    case PairWeight::kPca:
        break;
    }
    return weigh<PairWeight::kPca>(pairs, distance, inverse, inverseStep, greatest, out);
}

inline RowDistances rowDistances(std::uint32_t pairs, const double* distance)
{
    using S = SimdD;
    const std::uint32_t end = paddedPairs(pairs);
    S::D greatest = S::set(0), least = S::set(__builtin_inf());
    for (std::uint32_t k = 0; k < end; k += S::kLanes) { // pads repeat the last pair
        const S::D d = S::load(distance + k);
        greatest = S::max(greatest, d);
        least = S::min(least, d);
    }
    const double most = S::greatest(greatest);
    const double nearest = 0.0 - S::greatest(S::sub(S::set(0), least)); // never a negative zero
    const IntegerScale scale(most, pairs);
    if (!scale.isFinite) return {most, nearest};
    IntegerSum sum(S::set(scale.scale));
    for (std::uint32_t k = 0; k < end; k += S::kLanes)
        sum.add(S::first(S::load(distance + k), std::ptrdiff_t(pairs) - std::ptrdiff_t(k)));
    return {sum.value(scale, end), nearest};
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

inline void eigen(const double* matrices, std::size_t count, double* out)
{
    using S = SimdD;
    constexpr int kSweeps = 6;
    for (std::size_t i = 0; i < count; i += S::kLanes) {
        double lanes[kEigenNumbers][S::kLanes];
        S::D a[6];
        for (int p = 0; p < 6; ++p) {
            for (int l = 0; l < S::kLanes; ++l)
                lanes[p][l] = matrices[6 * (i + static_cast<std::size_t>(l)) + static_cast<std::size_t>(p)];
            a[p] = S::load(lanes[p]);
        }
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
            S::store(lanes[k], a[k]);
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
    rowDistances,
    sums,
    vectorSums,
    momentSums,
    eigen};

} // namespace
} // namespace vdb_nns
