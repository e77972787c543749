// The kernels of measures (measure_rows.h) for the instruction set of the including file. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

// ---------------------------------------------------------------------------------------------- differences

constexpr std::uint32_t paddedPairs(std::uint32_t count)
{
    return (count + static_cast<std::uint32_t>(kPairPad) - 1) & ~static_cast<std::uint32_t>(kPairPad - 1);
}

#if defined(VDB_NNS_SIMD_AVX2) || defined(VDB_NNS_SIMD_AVX512)

// A query, and its difference to a candidate: x y z and a lane that means nothing.
template <PositionRecord kRecord>
struct QueryPosition;

template <>
struct QueryPosition<PositionRecord::kFloats> {
    using Record = FloatPosition;
    __m256d at;
    explicit QueryPosition(const Record& r) : at(_mm256_cvtps_pd(_mm_loadu_ps(&r.x))) {}
    __m256d to(const Record& r) const { return _mm256_sub_pd(_mm256_cvtps_pd(_mm_loadu_ps(&r.x)), at); }
};

template <>
struct QueryPosition<PositionRecord::kDoubles> {
    using Record = DoublePosition;
    __m256d at;
    explicit QueryPosition(const Record& r) : at(_mm256_loadu_pd(&r.x)) {}
    __m256d to(const Record& r) const { return _mm256_sub_pd(_mm256_loadu_pd(&r.x), at); }
};

template <>
struct QueryPosition<PositionRecord::kVoxels> {
    using Record = VoxelPosition10;
    __m256d offset;
    __m128i voxel;
    explicit QueryPosition(const Record& r)
        : offset(offsetOf(_mm_loadu_ps(&r.x))), voxel(voxelOf(_mm_loadu_ps(&r.x)))
    {
    }
    __m256d to(const Record& r) const
    {
        const __m128 record = _mm_loadu_ps(&r.x);
        // Ten bits at the top: they wrap as the difference does.
        const __m128i voxels = _mm_srai_epi32(_mm_sub_epi32(voxelOf(record), voxel), 22);
        return _mm256_add_pd(_mm256_cvtepi32_pd(voxels), _mm256_sub_pd(offsetOf(record), offset));
    }
    static __m256d offsetOf(__m128 record)
    {
        return _mm256_cvtps_pd(_mm_blend_ps(record, _mm_setzero_ps(), 8)); // the packed voxel may be no float
    }
    static __m128i voxelOf(__m128 record)
    {
        const __m128i packed = _mm_shuffle_epi32(_mm_castps_si128(record), 0xff);
        return _mm_and_si128(_mm_sllv_epi32(packed, _mm_setr_epi32(0, 10, 20, 32)),
                             _mm_set1_epi32(static_cast<int>(0xffc00000u)));
    }
};

template <>
struct QueryPosition<PositionRecord::kWideVoxels> {
    using Record = WideVoxelPosition;
    __m256d offset;
    __m128i voxel;
    explicit QueryPosition(const Record& r)
        : offset(_mm256_cvtps_pd(_mm_loadu_ps(r.offset))),
          voxel(_mm_loadu_si128(reinterpret_cast<const __m128i*>(r.voxel)))
    {
    }
    __m256d to(const Record& r) const
    {
        const __m128i other = _mm_loadu_si128(reinterpret_cast<const __m128i*>(r.voxel));
        const __m256d voxels = _mm256_sub_pd(_mm256_cvtepi32_pd(other), _mm256_cvtepi32_pd(voxel)); // exact
        return _mm256_add_pd(voxels, _mm256_sub_pd(_mm256_cvtps_pd(_mm_loadu_ps(r.offset)), offset));
    }
};

template <PositionRecord kRecord>
void differences(const void* query, const void* candidates, const std::uint32_t* numbers, std::uint32_t count,
                 double* x, double* y, double* z)
{
    using Query = QueryPosition<kRecord>;
    using Record = typename Query::Record;
    const Query q(*static_cast<const Record*>(query));
    const Record* const records = static_cast<const Record*>(candidates);
    const auto four = [&](std::uint32_t k, const std::uint32_t(&n)[4]) {
        const __m256d a = q.to(records[n[0]]), b = q.to(records[n[1]]), c = q.to(records[n[2]]),
                      d = q.to(records[n[3]]);
        const __m256d xzAB = _mm256_unpacklo_pd(a, b), xzCD = _mm256_unpacklo_pd(c, d);
        const __m256d yAB = _mm256_unpackhi_pd(a, b), yCD = _mm256_unpackhi_pd(c, d);
        _mm256_storeu_pd(x + k, _mm256_permute2f128_pd(xzAB, xzCD, 0x20));
        _mm256_storeu_pd(y + k, _mm256_permute2f128_pd(yAB, yCD, 0x20));
        _mm256_storeu_pd(z + k, _mm256_permute2f128_pd(xzAB, xzCD, 0x31));
    };
    std::uint32_t k = 0;
    for (; k + 4 <= count; k += 4) four(k, {numbers[k], numbers[k + 1], numbers[k + 2], numbers[k + 3]});
    const std::uint32_t last = count - 1;
    const auto at = [&](std::uint32_t i) { return numbers[i < last ? i : last]; };
    for (; k < paddedPairs(count); k += 4) four(k, {at(k), at(k + 1), at(k + 2), at(k + 3)});
}

#else

inline void takeDifference(const FloatPosition& a, const FloatPosition& b, double (&d)[3])
{
    d[0] = static_cast<double>(b.x) - static_cast<double>(a.x);
    d[1] = static_cast<double>(b.y) - static_cast<double>(a.y);
    d[2] = static_cast<double>(b.z) - static_cast<double>(a.z);
}
inline void takeDifference(const DoublePosition& a, const DoublePosition& b, double (&d)[3])
{
    d[0] = b.x - a.x;
    d[1] = b.y - a.y;
    d[2] = b.z - a.z;
}
inline void takeDifference(const VoxelPosition10& a, const VoxelPosition10& b, double (&d)[3])
{
    constexpr std::uint32_t kTop = 0xffc00000u;
    const float from[3] = {a.x, a.y, a.z}, to[3] = {b.x, b.y, b.z};
    for (int c = 0; c < 3; ++c) {
        const std::uint32_t top = (b.voxel << 10 * c & kTop) - (a.voxel << 10 * c & kTop);
        d[c] = static_cast<double>(static_cast<std::int32_t>(top) >> 22) +
               (static_cast<double>(to[c]) - static_cast<double>(from[c]));
    }
}
inline void takeDifference(const WideVoxelPosition& a, const WideVoxelPosition& b, double (&d)[3])
{
    for (int c = 0; c < 3; ++c) {
        d[c] = static_cast<double>(std::int64_t(b.voxel[c]) - a.voxel[c]) +
               (static_cast<double>(b.offset[c]) - static_cast<double>(a.offset[c]));
    }
}

template <PositionRecord kRecord>
struct RecordOf;
template <>
struct RecordOf<PositionRecord::kFloats> {
    using Type = FloatPosition;
};
template <>
struct RecordOf<PositionRecord::kDoubles> {
    using Type = DoublePosition;
};
template <>
struct RecordOf<PositionRecord::kVoxels> {
    using Type = VoxelPosition10;
};
template <>
struct RecordOf<PositionRecord::kWideVoxels> {
    using Type = WideVoxelPosition;
};

template <PositionRecord kRecord>
void differences(const void* query, const void* candidates, const std::uint32_t* numbers, std::uint32_t count,
                 double* x, double* y, double* z)
{
    using Record = typename RecordOf<kRecord>::Type;
    const Record& from = *static_cast<const Record*>(query);
    const Record* const records = static_cast<const Record*>(candidates);
    for (std::uint32_t k = 0; k < paddedPairs(count); ++k) {
        double d[3];
        takeDifference(from, records[numbers[k < count ? k : count - 1]], d);
        x[k] = d[0];
        y[k] = d[1];
        z[k] = d[2];
    }
}

#endif

template <PairMap::Kind kKind>
void mapDifferences(const PairMap& map, std::size_t pairs, double* x, double* y, double* z, double* distance)
{
    using S = SimdD;
    S::D m[3][3];
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) m[r][c] = S::set(map.m[r][c]);
    }
    for (std::size_t k = 0; k < pairs; k += S::kLanes) {
        const S::D d[3] = {S::load(x + k), S::load(y + k), S::load(z + k)};
        S::D w[3] = {d[0], d[1], d[2]};
        for (int r = 0; r < 3; ++r) {
            if (kKind == PairMap::Kind::kDiagonal) w[r] = S::mul(m[r][r], d[r]);
            if (kKind == PairMap::Kind::kGeneral) {
                w[r] = S::add(S::add(S::mul(m[r][0], d[0]), S::mul(m[r][1], d[1])), S::mul(m[r][2], d[2]));
            }
        }
        if (kKind != PairMap::Kind::kIdentity) {
            S::store(x + k, w[0]);
            S::store(y + k, w[1]);
            S::store(z + k, w[2]);
        }
        const S::D square = S::add(S::add(S::mul(w[0], w[0]), S::mul(w[1], w[1])), S::mul(w[2], w[2]));
        S::store(distance + k, S::sqrt(square));
    }
}

inline void distances(const PairMap& map, std::size_t pairs, double* x, double* y, double* z,
                      double* distance)
{
    switch (map.kind) {
    case PairMap::Kind::kIdentity:
        return mapDifferences<PairMap::Kind::kIdentity>(map, pairs, x, y, z, distance);
    case PairMap::Kind::kDiagonal:
        return mapDifferences<PairMap::Kind::kDiagonal>(map, pairs, x, y, z, distance);
    case PairMap::Kind::kGeneral:
        return mapDifferences<PairMap::Kind::kGeneral>(map, pairs, x, y, z, distance);
    }
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

template <PairWeight kWeight>
void weigh(std::size_t pairs, const double* distance, const double* inverse, std::size_t inverseStep,
           const double* valid, double* out)
{
    using S = SimdD;
    const S::D first = S::set(inverse[0]);
    for (std::size_t k = 0; k < pairs; k += S::kLanes) {
        const S::D by = inverseStep == 0 ? first : S::load(inverse + k);
        const S::D q = S::min(S::mul(S::load(distance + k), by), S::set(1));
        S::store(out + k, S::mul(weightOf<kWeight>(q), S::load(valid + k)));
    }
}

inline void weights(PairWeight weight, std::size_t pairs, const double* distance, const double* inverse,
                    std::size_t inverseStep, const double* valid, double* out)
{
    switch (weight) {
    case PairWeight::kCubic:
        return weigh<PairWeight::kCubic>(pairs, distance, inverse, inverseStep, valid, out);
    case PairWeight::kWendland2:
        return weigh<PairWeight::kWendland2>(pairs, distance, inverse, inverseStep, valid, out);
    case PairWeight::kPoly6:
        return weigh<PairWeight::kPoly6>(pairs, distance, inverse, inverseStep, valid, out);
    case PairWeight::kTophat:
        return weigh<PairWeight::kTophat>(pairs, distance, inverse, inverseStep, valid, out);
    case PairWeight::kPca:
        return weigh<PairWeight::kPca>(pairs, distance, inverse, inverseStep, valid, out);
    }
}

// ----------------------------------------------------------------------------------------------------- sums

inline double greatestLane(SimdD::D v)
{
    double lane[SimdD::kLanes];
    SimdD::store(lane, v);
    double greatest = lane[0];
    for (int i = 1; i < SimdD::kLanes; ++i) greatest = lane[i] > greatest ? lane[i] : greatest;
    return greatest;
}

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
        std::uint64_t lane[SimdD::kLanes], sum = 0;
        SimdD::storeBits(lane, mSum);
        for (const std::uint64_t part : lane) sum += part;
        sum -= terms * IntegerScale::kShiftBits;
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
    const IntegerScale scale(greatestLane(greatest), count);
    if (!scale.isFinite) return greatestLane(greatest);
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
                       const double* z, const double* distance, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < rows.rows; ++r, out += 3) {
        const std::uint32_t begin = rows.begin[r], end = begin + paddedPairs(rows.count[r]);
        S::D greatest = S::set(0);
        for (std::uint32_t k = begin; k < end; k += S::kLanes)
            greatest = S::max(greatest, S::mul(S::load(weight + k), S::load(distance + k)));
        const IntegerScale scale(greatestLane(greatest), rows.count[r]);
        if (!scale.isFinite) {
            out[0] = out[1] = out[2] = greatestLane(greatest);
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
        const IntegerScale scale(greatestLane(greatest), rows.count[r]);
        if (!scale.isFinite) {
            for (int p = 0; p < 6; ++p) out[p] = greatestLane(greatest);
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

inline void least(const PairRows& rows, const double* distance, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < rows.rows; ++r) {
        const std::uint32_t begin = rows.begin[r], end = begin + paddedPairs(rows.count[r]);
        S::D nearest = S::set(__builtin_inf());
        for (std::uint32_t k = begin; k < end; k += S::kLanes)
            nearest = S::min(nearest, S::load(distance + k));    // pads repeat the last pair
        out[r] = 0.0 - greatestLane(S::sub(S::set(0), nearest)); // never a negative zero
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

constexpr MeasureKernels kMeasureKernels = {
    {differences<PositionRecord::kFloats>, differences<PositionRecord::kDoubles>,
     differences<PositionRecord::kVoxels>, differences<PositionRecord::kWideVoxels>},
    distances,
    weights,
    sums,
    vectorSums,
    momentSums,
    least,
    eigen};

} // namespace
} // namespace vdb_nns
