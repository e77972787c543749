// Weights and sums of measures (measure_rows.h) for the instruction set of the including file. Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

// -------------------------------------------------------------------------------------------------- weights

template <PairWeight kWeight>
SimdD::D weightOf(SimdD::D q)
{
    using S = SimdD;
    const S::D one = S::set(1);
    if (kWeight == PairWeight::kCubic) { // 2 (1 - q)^3, less (1 - 2q)^3 below 1/2
        const S::D left = S::sub(one, q), near = S::max(S::sub(left, q), S::set(0));
        const S::D whole = S::mul(S::mul(left, left), S::add(left, left));
        return S::sub(whole, S::mul(S::mul(near, near), near));
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

// A vector of pairs.
struct PairPlace {
    std::size_t group, lane; // its first
    std::size_t k() const { return group * kGroup + lane; }
};

VDB_NNS_INLINE SimdD::D maskOf(const PairGroups& groups, PairPlace at)
{
    return SimdD::load(kPairMasks.lane[groups.pairs[at.group]] + at.lane);
}

// ----------------------------------------------------------------------------------------------------- sums

// 1.5 * 2^52 + an integer below 2^51 has the integer as its lowest bits.
constexpr double kShift = 6755399441055744.0;

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

// Adds up the scaled terms of all groups, `kSums` at once: term(at, scale, t) writes those of the pairs there. A row's sum is then the
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
            term(PairPlace{g, lane}, scale, terms);
            for (int n = 0; n < kSums; ++n)
                running[n] = S::addBits(running[n], S::add(terms[n], S::set(kShift)));
        }
        note(g + 1);
    }
    // Four sums at a time, of as many rows or of one; the last ones more than once.
    constexpr std::size_t kSumsOfRow = kSums, kRows = kSums < 4 ? 4 : 1;
    for (std::size_t r = 0; r < groups.rows; r += kRows) {
        for (std::size_t n = 0; n < kSumsOfRow; n += 4 / kRows) {
            S::I four[4];
            std::size_t row[4], of[4];
            std::uint64_t bits[4];
            for (std::size_t l = 0; l < 4; ++l) {
                row[l] = kRows == 1 || r + l < groups.rows ? r + l % kRows : groups.rows - 1;
                of[l] = kRows == 4 ? n : n + l < kSumsOfRow ? n + l : kSumsOfRow - 1;
                const std::size_t first = groups.firstGroup[row[l]], end = groups.firstGroup[row[l] + 1];
                four[l] = S::difference(S::loadBits(scratch + (end * kSumsOfRow + of[l]) * S::kLanes),
                                        S::loadBits(scratch + (first * kSumsOfRow + of[l]) * S::kLanes));
                bits[l] = (end - first) * kGroup * kShiftBits;
            }
            std::uint64_t sums[4];
            S::sumFour(four, sums);
            for (std::size_t l = 0; l < 4; ++l) {
                const RowScale& scale = scales[row[l]];
                // Without a scale terms are infinite.
                out[row[l] * kSumsOfRow + of[l]] =
                    scale.scale > 0
                        ? static_cast<double>(static_cast<std::int64_t>(sums[l] - bits[l])) * scale.inverse
                        : scale.inverse;
            }
        }
    }
}

// Times the inverse of the radius, and at most 1. Distances come in place of their squares.
template <bool kSquares>
VDB_NNS_INLINE SimdD::D relativeDistance(double* distance, SimdD::D inverse)
{
    using S = SimdD;
    S::D d = S::load(distance);
    if (kSquares) {
        d = S::sqrt(d);
        S::store(distance, d);
    }
    return S::min(S::mul(d, inverse), S::set(1));
}

template <PairWeight kWeight, bool kSquares>
void weigh(const PairGroups& groups, double* distance, const PairRadii& radii, const RowScale* scales,
           std::uint64_t* scratch, double* out, double* sums)
{
    using S = SimdD;
    const S::D first = S::set(radii.inverse[0]);
    sumRows<1>(groups, scales, scratch, sums, [&](PairPlace at, S::D scale, S::D(&terms)[1]) {
        const S::D by = radii.areAlike ? first : S::load(radii.inverse + at.k());
        const S::D q = relativeDistance<kSquares>(distance + at.k(), by);
        const S::D w = S::mul(weightOf<kWeight>(q), maskOf(groups, at));
        S::store(out + at.k(), w);
        terms[0] = S::mul(w, scale);
    });
}

template <bool kSquares>
void weightsOf(PairWeight weight, const PairGroups& groups, double* distance, const PairRadii& radii,
               const RowScale* scales, std::uint64_t* scratch, double* out, double* sums)
{
    switch (weight) {
    case PairWeight::kCubic:
        return weigh<PairWeight::kCubic, kSquares>(groups, distance, radii, scales, scratch, out, sums);
    case PairWeight::kWendland2:
        return weigh<PairWeight::kWendland2, kSquares>(groups, distance, radii, scales, scratch, out, sums);
    case PairWeight::kPoly6:
        return weigh<PairWeight::kPoly6, kSquares>(groups, distance, radii, scales, scratch, out, sums);
    case PairWeight::kTophat:
        return weigh<PairWeight::kTophat, kSquares>(groups, distance, radii, scales, scratch, out, sums);
    case PairWeight::kPca:
        return weigh<PairWeight::kPca, kSquares>(groups, distance, radii, scales, scratch, out, sums);
    }
}

inline void weights(PairWeight weight, const PairGroups& groups, double* distance, bool areSquares,
                    const PairRadii& radii, const RowScale* scales, std::uint64_t* scratch, double* out,
                    double* sums)
{
    if (areSquares) {
        weightsOf<true>(weight, groups, distance, radii, scales, scratch, out, sums);
    } else {
        weightsOf<false>(weight, groups, distance, radii, scales, scratch, out, sums);
    }
}

inline void sums(const PairGroups& groups, const RowScale* scales, const double* weight,
                 const double* const* factors, int factorCount, std::uint64_t* scratch, double* out)
{
    using S = SimdD;
    if (factorCount == 0) {
        sumRows<1>(groups, scales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[1]) {
            terms[0] = S::mul(S::load(weight + at.k()), scale);
        });
    } else if (factorCount == 1) {
        sumRows<1>(groups, scales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[1]) {
            terms[0] = S::mul(S::mul(S::load(weight + at.k()), scale), S::load(factors[0] + at.k()));
        });
    } else {
        sumRows<3>(groups, scales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[3]) {
            const S::D w = S::mul(S::load(weight + at.k()), scale);
            for (int f = 0; f < 3; ++f) terms[f] = S::mul(w, S::load(factors[f] + at.k()));
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
    sumRows<6>(groups, rowScales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[6]) {
        S::D d[3];
        fromCenter(at.k(), d);
        const S::D w = S::mul(S::load(weight + at.k()), scale);
        const S::D wx = S::mul(w, d[0]), wy = S::mul(w, d[1]), wz = S::mul(w, d[2]);
        terms[0] = S::mul(wx, d[0]);
        terms[1] = S::mul(wy, d[1]);
        terms[2] = S::mul(wz, d[2]);
        terms[3] = S::mul(wx, d[1]);
        terms[4] = S::mul(wx, d[2]);
        terms[5] = S::mul(wy, d[2]);
    });
}

template <bool kSquares>
void pcaSumsOf(const PairGroups& groups, double* distance, const double* x, const double* y, const double* z,
               const PairRadii& radii, const RowScale* rowScales, std::uint64_t* scratch, double* out)
{
    using S = SimdD;
    const S::D first = S::set(radii.inverse[0]);
    sumRows<kPcaNumbers>(
        groups, rowScales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[kPcaNumbers]) {
            const std::size_t k = at.k();
            const S::D by = radii.areAlike ? first : S::load(radii.inverse + k);
            const S::D q = relativeDistance<kSquares>(distance + k, by);
            const S::D w = S::mul(weightOf<PairWeight::kPca>(q), S::mul(maskOf(groups, at), scale));
            const S::D ux = S::mul(S::load(x + k), by), uy = S::mul(S::load(y + k), by),
                       uz = S::mul(S::load(z + k), by);
            const S::D wx = S::mul(w, ux), wy = S::mul(w, uy), wz = S::mul(w, uz);
            terms[0] = w;
            terms[1] = wx;
            terms[2] = wy;
            terms[3] = wz;
            terms[4] = S::mul(wx, ux);
            terms[5] = S::mul(wy, uy);
            terms[6] = S::mul(wz, uz);
            terms[7] = S::mul(wx, uy);
            terms[8] = S::mul(wx, uz);
            terms[9] = S::mul(wy, uz);
        });
}

inline void pcaSums(const PairGroups& groups, double* distance, bool areSquares, const double* x,
                    const double* y, const double* z, const PairRadii& radii, const RowScale* rowScales,
                    std::uint64_t* scratch, double* out)
{
    if (areSquares) {
        pcaSumsOf<true>(groups, distance, x, y, z, radii, rowScales, scratch, out);
    } else {
        pcaSumsOf<false>(groups, distance, x, y, z, radii, rowScales, scratch, out);
    }
}

inline void least(const PairGroups& groups, const double* values, double* out)
{
    using S = SimdD;
    for (std::size_t r = 0; r < groups.rows; ++r) {
        S::D nearest = S::set(__builtin_inf());
        const std::size_t end = groups.firstGroup[r + 1] * kGroup;
        for (std::size_t k = groups.firstGroup[r] * kGroup; k < end; k += S::kLanes)
            nearest = S::min(nearest, S::load(values + k));     // pads repeat the last pair
        out[r] = 0.0 - S::greatest(S::sub(S::set(0), nearest)); // never a negative zero
    }
}

template <bool kSquares>
void distanceSumsOf(const PairGroups& groups, double* distance, const RowScale* rowScales,
                    std::uint64_t* scratch, double* out)
{
    using S = SimdD;
    sumRows<1>(groups, rowScales, scratch, out, [&](PairPlace at, S::D scale, S::D(&terms)[1]) {
        const S::D d = S::load(distance + at.k());
        const S::D distances = S::mul(kSquares ? S::sqrt(d) : d, maskOf(groups, at));
        S::store(distance + at.k(), distances);
        terms[0] = S::mul(distances, scale);
    });
}

inline void distanceSums(const PairGroups& groups, double* distance, bool areSquares,
                         const RowScale* rowScales, std::uint64_t* scratch, double* out)
{
    if (areSquares) {
        distanceSumsOf<true>(groups, distance, rowScales, scratch, out);
    } else {
        distanceSumsOf<false>(groups, distance, rowScales, scratch, out);
    }
}

// Particles are added to one number at a time: to load what was just stored takes longer in vectors.
template <PairWeight kWeight, bool kWeights, bool kDistances>
void addOncePairsOf(const OncePairs& once, const PairGroups& groups, const std::uint32_t* places,
                    std::uint32_t firstPlace, const double* square, ParticleSums* sums)
{
    using S = SimdD;
    const S::D inverse = S::set(once.inverseRadius), shift = S::set(kShift);
    const S::D weightScale = S::set(once.weightScale), distanceScale = S::set(once.distanceScale);
    const auto storeShifted = [&](std::uint64_t* to, S::D v, S::D scale) {
        S::storeBits(to, S::addBits(S::zero(), S::add(S::mul(v, scale), shift)));
    };
    for (std::size_t g = 0; g < groups.groups; ++g) {
        alignas(64) std::uint64_t weight[kGroup], distance[kGroup];
        const double* const squares = square + g * kGroup;
        S::D least = S::load(squares);
        for (std::size_t lane = 0; lane < kGroup; lane += S::kLanes) {
            const S::D mask = maskOf(groups, {g, lane}), s = S::load(squares + lane), d = S::sqrt(s);
            const S::D q = S::min(S::mul(d, inverse), S::set(1));
            if (kWeights) storeShifted(weight + lane, S::mul(weightOf<kWeight>(q), mask), weightScale);
            if (!kDistances) continue;
            storeShifted(distance + lane, S::mul(d, mask), distanceScale);
            least = S::min(least, s); // pads repeat the last pair
        }
        std::uint64_t weights = 0, distances = 0;
        for (std::size_t k = 0; k < kGroup; ++k) {
            ParticleSums& other = sums[places[g * kGroup + k]];
            ++other.pairs;
            if (kWeights) {
                weights += weight[k];
                other.weight += weight[k];
            }
            if (kDistances) {
                distances += distance[k];
                other.distance += distance[k];
                other.leastSquare = squares[k] < other.leastSquare ? squares[k] : other.leastSquare;
            }
        }
        ParticleSums& own = sums[firstPlace + groups.row[g]];
        if (kWeights) own.weight += weights - kGroup * kShiftBits;
        if (!kDistances) continue;
        own.distance += distances - kGroup * kShiftBits;
        const double nearest = 0.0 - S::greatest(S::sub(S::set(0), least));
        own.leastSquare = nearest < own.leastSquare ? nearest : own.leastSquare;
    }
}

template <PairWeight kWeight>
void addOncePairsWeighted(const OncePairs& once, const PairGroups& groups, const std::uint32_t* places,
                          std::uint32_t firstPlace, const double* square, ParticleSums* sums)
{
    if (once.wantsDistances) {
        addOncePairsOf<kWeight, true, true>(once, groups, places, firstPlace, square, sums);
    } else {
        addOncePairsOf<kWeight, true, false>(once, groups, places, firstPlace, square, sums);
    }
}

inline void addOncePairs(const OncePairs& once, const PairGroups& groups, const std::uint32_t* places,
                         std::uint32_t firstPlace, const double* square, ParticleSums* sums)
{
    if (!once.wantsWeights)
        return addOncePairsOf<PairWeight::kTophat, false, true>(once, groups, places, firstPlace, square,
                                                                sums);
    switch (once.weight) {
    case PairWeight::kCubic:
        return addOncePairsWeighted<PairWeight::kCubic>(once, groups, places, firstPlace, square, sums);
    case PairWeight::kWendland2:
        return addOncePairsWeighted<PairWeight::kWendland2>(once, groups, places, firstPlace, square, sums);
    case PairWeight::kPoly6:
        return addOncePairsWeighted<PairWeight::kPoly6>(once, groups, places, firstPlace, square, sums);
    case PairWeight::kTophat:
    case PairWeight::kPca:
        return addOncePairsWeighted<PairWeight::kTophat>(once, groups, places, firstPlace, square, sums);
    }
}

} // namespace
} // namespace vdb_nns
