#include "exact/exact_test.h"

#include "points/pair_geometry.h"
#include "points/particle_source.h"
#include "util/dyadic.h"

#include <boost/multiprecision/cpp_int.hpp>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace vdb_nns {

namespace {

using boost::multiprecision::cpp_int;
using Int128 = __int128;
using UInt128 = unsigned __int128;

constexpr int kNoExponent = std::numeric_limits<int>::max();

// value = mantissa * 2^exponent with an odd mantissa; 0 has mantissa 0 and kNoExponent.
struct Scaled {
    std::int64_t mantissa;
    int exponent;
    int bits; // of |mantissa|
};

Scaled decompose(double value)
{
    if (value == 0) return {0, kNoExponent, 0};
    std::uint64_t raw;
    std::memcpy(&raw, &value, sizeof raw);
    const int biased = static_cast<int>(raw >> 52 & 2047);
    std::uint64_t mantissa = raw & ((std::uint64_t(1) << 52) - 1);
    if (biased) mantissa |= std::uint64_t(1) << 52;
    const int zeros = __builtin_ctzll(mantissa);
    mantissa >>= zeros;
    const auto odd = static_cast<std::int64_t>(mantissa);
    return {value < 0 ? -odd : odd, (biased ? biased : 1) - 1075 + zeros, 64 - __builtin_clzll(mantissa)};
}

struct UInt256 {
    UInt128 high, low;
};

UInt256 square(UInt128 v)
{
    const auto a = static_cast<std::uint64_t>(v >> 64), b = static_cast<std::uint64_t>(v);
    const UInt128 cross = UInt128(a) * b; // counted twice
    const UInt128 low = UInt128(b) * b, middle = cross << 65;
    UInt256 s{UInt128(a) * a + (cross >> 63), low + middle};
    s.high += s.low < low;
    return s;
}

UInt256 operator+(UInt256 a, UInt256 b)
{
    UInt256 s{a.high + b.high, a.low + b.low};
    s.high += s.low < a.low;
    return s;
}

bool operator<=(UInt256 a, UInt256 b)
{
    return a.high != b.high ? a.high < b.high : a.low <= b.low;
}

int bitsOf(UInt128 v)
{
    const auto high = static_cast<std::uint64_t>(v >> 64), low = static_cast<std::uint64_t>(v);
    return high ? 128 - __builtin_clzll(high) : low ? 64 - __builtin_clzll(low) : 0;
}

} // namespace

struct ExactTest::ExactVector {
    UInt128 w[3];
    int bits = 0; // of the largest
    int exponent = 0;

    void shift(int left)
    {
        for (UInt128& v : w) v <<= left;
    }
    UInt256 square() const { return vdb_nns::square(w[0]) + vdb_nns::square(w[1]) + vdb_nns::square(w[2]); }
};

// The nine terms of a pair's coordinate differences: voxel difference + b - a on each axis.
struct ExactTest::Terms {
    Scaled term[3][3];
    int exponent = kNoExponent;                // the smallest
    int top = std::numeric_limits<int>::min(); // exponent above the largest's highest bit

    Terms(const StoredPosition& a, const StoredPosition& b)
    {
        for (int c = 0; c < 3; ++c) {
            term[c][0] = decompose(static_cast<double>(b.voxel[c] - a.voxel[c])); // below 2^53
            term[c][1] = decompose(b.offset[c]);
            term[c][2] = decompose(-a.offset[c]);
            for (const Scaled& s : term[c]) {
                if (s.mantissa == 0) continue;
                exponent = std::min(exponent, s.exponent);
                top = std::max(top, s.exponent + s.bits);
            }
        }
    }
};

double radiusOfPair(const Radius& radius, std::uint32_t query, std::uint32_t candidate)
{
    constexpr double kNobody = -std::numeric_limits<double>::infinity();
    const auto of = [](Span<const double> radii, std::uint32_t number) {
        const double r = radii[number];
        return r > 0 && std::isfinite(r) ? r : kNobody;
    };
    if (radius.isOne()) return radius.value;
    switch (radius.mode) {
    case RadiusMode::kGather:
        return of(radius.ofQueries, query);
    case RadiusMode::kScatter:
        return of(radius.ofCandidates, candidate);
    case RadiusMode::kSymmetric:
        break;
    }
    return std::max(of(radius.ofQueries, query), of(radius.ofCandidates, candidate));
}

ExactTest::ExactTest(const ParticleView& queries, const ParticleView& candidates, const Radius& radius,
                     double largest)
    : mQueries(queries),
      mCandidates(candidates),
      mRadius(radius),
      mIsAlike(haveSameCoordinates(queries.source(), candidates.source()))
{
    const Matrix3 &m = queries.linear(), &n = candidates.linear();
    const int exponent = std::ilogb(largest);
    if (exponent > -1000 && exponent < 1000) mScale = std::ldexp(1.0, -exponent);
    int lowest = kNoExponent, top = std::numeric_limits<int>::min();
    for (int k = 0; k < 3; ++k) {
        mScaledTranslation[k] = queries.source().translation()[k] * mScale;
        mScaledCandidateTranslation[k] = candidates.source().translation()[k] * mScale;
        for (int c = 0; c < 3; ++c) {
            mScaledLinear[k][c] = m[k][c] * mScale;
            mScaledCandidateLinear[k][c] = n[k][c] * mScale;
            const Scaled s = decompose(m[k][c]);
            if (s.mantissa == 0) continue;
            lowest = std::min(lowest, s.exponent);
            top = std::max(top, s.exponent + s.bits);
        }
    }
    mSmallMatrix = top - lowest <= 61;
    mMatrixExponent = lowest;
    for (int k = 0; k < 3 && mSmallMatrix; ++k) {
        for (int c = 0; c < 3; ++c) {
            const Scaled s = decompose(m[k][c]);
            mMatrix[k][c] = s.mantissa == 0 ? 0 : s.mantissa * (std::int64_t(1) << (s.exponent - lowest));
        }
    }
}

ExactTest::Square ExactTest::squareOf(const StoredPosition& a, const StoredPosition& b) const
{
    constexpr double u = 0x1p-53;
    if (!mIsAlike) return squareOfTwo(a, b);
    double w2 = 0, error = 0;
    if (mQueries.source().isArray()) {
        for (int c = 0; c < 3; ++c) {
            const double w = (b.offset[c] - a.offset[c]) * mScale;
            w2 += w * w;
        }
        error = 12 * u * w2;
    } else {
        double d[3], size[3];
        for (int c = 0; c < 3; ++c) {
            const auto voxels = static_cast<double>(b.voxel[c] - a.voxel[c]);
            d[c] = voxels + (b.offset[c] - a.offset[c]);
            size[c] = std::fabs(voxels) + std::fabs(a.offset[c]) + std::fabs(b.offset[c]);
        }
        for (int k = 0; k < 3; ++k) {
            double w = 0, s = 0;
            for (int c = 0; c < 3; ++c) {
                w += mScaledLinear[k][c] * d[c];
                s += std::fabs(mScaledLinear[k][c]) * size[c];
            }
            w2 += w * w;
            error += 24 * u * std::fabs(w) * s + 100 * u * u * s * s;
        }
        error += 12 * u * w2;
    }
    return {w2, error};
}

ExactTest::Square ExactTest::squareOfTwo(const StoredPosition& query, const StoredPosition& candidate) const
{
    constexpr double u = 0x1p-53;
    double w2 = 0, error = 0;
    for (int k = 0; k < 3; ++k) {
        double x = mScaledTranslation[k], y = mScaledCandidateTranslation[k];
        double size = std::fabs(x) + std::fabs(y);
        for (int c = 0; c < 3; ++c) {
            const auto p = static_cast<double>(query.voxel[c]), q = static_cast<double>(candidate.voxel[c]);
            x += mScaledLinear[k][c] * (p + query.offset[c]);
            y += mScaledCandidateLinear[k][c] * (q + candidate.offset[c]);
            size += std::fabs(mScaledLinear[k][c]) * (std::fabs(p) + std::fabs(query.offset[c])) +
                    std::fabs(mScaledCandidateLinear[k][c]) * (std::fabs(q) + std::fabs(candidate.offset[c]));
        }
        const double w = y - x, e = 8 * u * size;
        w2 += w * w;
        error += 4 * std::fabs(w) * e + 2 * e * e;
    }
    return {w2, error + 12 * u * w2};
}

ExactTest::Verdict ExactTest::doubleTest(const StoredPosition& a, const StoredPosition& b,
                                         double radius) const
{
    constexpr double u = 0x1p-53;
    const Square square = squareOf(a, b);
    const double r2 = (radius * mScale) * (radius * mScale);
    // The radius' own square, and underflow.
    const double error = square.error + 12 * u * r2 + std::numeric_limits<double>::min();
    if (square.value + error < r2) return Verdict::kYes;
    if (square.value - error > r2) return Verdict::kNo;
    return Verdict::kUndecided;
}

Dyadic ExactTest::exactSquare(const StoredPosition& query, const StoredPosition& candidate) const
{
    const ParticleSource &queries = mQueries.source(), &candidates = mCandidates.source();
    Dyadic p[3], q[3];
    for (int c = 0; c < 3; ++c) {
        p[c] = Dyadic(static_cast<double>(query.voxel[c])) + Dyadic(query.offset[c]);
        q[c] = Dyadic(static_cast<double>(candidate.voxel[c])) + Dyadic(candidate.offset[c]);
    }
    Dyadic sum;
    for (int k = 0; k < 3; ++k) {
        Dyadic w = Dyadic(candidates.translation()[k]) - Dyadic(queries.translation()[k]);
        for (int c = 0; c < 3; ++c)
            w = w + Dyadic(candidates.linear()[k][c]) * q[c] - Dyadic(queries.linear()[k][c]) * p[c];
        sum = sum + w * w;
    }
    return sum;
}

ExactTest::Square ExactTest::squareOf(std::uint32_t query, std::uint32_t candidate) const
{
    constexpr double kUnknown = std::numeric_limits<double>::infinity();
    if (mScale == 0) return {0, kUnknown};
    const Square square = squareOf(mQueries.source().stored(query), mCandidates.source().stored(candidate));
    if (!std::isfinite(square.value) || !std::isfinite(square.error)) return {0, kUnknown};
    return {square.value, square.error + std::numeric_limits<double>::min()};
}

// The exact comparison of two distances, where integers of 256 bits hold both squares.
std::optional<int> ExactTest::compareInIntegers(const StoredPosition& query, const StoredPosition& a,
                                                const StoredPosition& b) const
{
    if (!mIsAlike) return std::nullopt;
    const Terms termsA(query, a), termsB(query, b);
    if (termsA.exponent == kNoExponent || termsB.exponent == kNoExponent) return std::nullopt;
    ExactVector vectorA, vectorB;
    if (!exactVector(termsA, vectorA) || !exactVector(termsB, vectorB)) return std::nullopt;
    ExactVector& coarse = vectorA.exponent > vectorB.exponent ? vectorA : vectorB;
    const int shift = std::abs(vectorA.exponent - vectorB.exponent);
    if (coarse.bits + shift > 126) return std::nullopt;
    coarse.shift(shift);
    const UInt256 squareA = vectorA.square(), squareB = vectorB.square();
    return squareA <= squareB ? (squareB <= squareA ? 0 : -1) : 1;
}

bool ExactTest::isNearer(std::uint32_t query, std::uint32_t a, std::uint32_t b,
                         std::uint64_t& exactPairs) const
{
    const StoredPosition from = mQueries.source().stored(query), toA = mCandidates.source().stored(a),
                         toB = mCandidates.source().stored(b);
    if (mScale != 0) {
        const Square squareA = squareOf(from, toA), squareB = squareOf(from, toB);
        const double error = squareA.error + squareB.error + std::numeric_limits<double>::min();
        if (squareA.value + error < squareB.value) return true;
        if (squareB.value + error < squareA.value) return false;
    }
    if (toA == toB) return a < b;
    exactPairs += 2;
    const std::optional<int> inIntegers = compareInIntegers(from, toA, toB);
    const int order = inIntegers ? *inIntegers : (exactSquare(from, toA) - exactSquare(from, toB)).sign();
    return order != 0 ? order < 0 : a < b;
}

const ExactTestMemory::Position& ExactTestMemory::positionOf(const ParticleSource& source,
                                                             std::uint32_t number)
{
    if (positions.empty()) positions.resize(std::size_t(1) << kPositionBits);
    Position& position = positions[number * 0x9E3779B1u >> (32 - kPositionBits)];
    if (position.number == number) return position;
    const StoredPosition stored = source.stored(number);
    position.number = number;
    for (int k = 0; k < 3; ++k) {
        position.voxel[k] = static_cast<std::int32_t>(stored.voxel[k]);
        position.offset[k] = static_cast<float>(stored.offset[k]);
    }
    return position;
}

bool ExactTest::isNeighbor(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                           std::uint64_t& exactPairs) const
{
    const ParticleSource &queries = mQueries.source(), &candidates = mCandidates.source();
    if (mRadius.isOne() && &queries == &candidates && !queries.isArray())
        return isNeighborInGrid(query, candidate, memory, exactPairs);
    const double radius = radiusOfPair(mRadius, query, candidate);
    if (!(radius > 0))
        return query == candidate && &queries == &candidates; // asked for in its own list alone
    const StoredPosition a = queries.stored(query), b = candidates.stored(candidate);
    const Verdict verdict = mScale != 0 ? doubleTest(a, b, radius) : Verdict::kUndecided;
    if (verdict != Verdict::kUndecided) return verdict == Verdict::kYes;
    ++exactPairs;
    if (mIsAlike) return isNeighborExactly(a, b, radius);
    return (exactSquare(a, b) - Dyadic(radius) * Dyadic(radius)).sign() <= 0;
}

bool ExactTest::isNeighborInGrid(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                                 std::uint64_t& exactPairs) const
{
    const ParticleSource& source = mQueries.source();
    if (memory.query.number != query) memory.query = memory.positionOf(source, query);
    const ExactTestMemory::Position &a = memory.query, &b = memory.positionOf(source, candidate);
    const bool sameOffsets = std::memcmp(a.offset, b.offset, sizeof a.offset) == 0;
    const std::int64_t d[3] = {std::int64_t(b.voxel[0]) - a.voxel[0], std::int64_t(b.voxel[1]) - a.voxel[1],
                               std::int64_t(b.voxel[2]) - a.voxel[2]};
    ExactTestMemory::Tie& tie = memory.ties[(d[0] * 25 + d[1] * 5 + d[2]) & 63];
    const std::int64_t otherTie = (tie.voxels[0] ^ d[0]) | (tie.voxels[1] ^ d[1]) | (tie.voxels[2] ^ d[2]);
    if (sameOffsets && tie.known && otherTie == 0) {
        ++exactPairs;
        return tie.isNeighbor;
    }
    const auto storedOf = [](const ExactTestMemory::Position& p) {
        return StoredPosition{{p.voxel[0], p.voxel[1], p.voxel[2]}, {p.offset[0], p.offset[1], p.offset[2]}};
    };
    const StoredPosition storedA = storedOf(a), storedB = storedOf(b);
    const Verdict verdict = mScale != 0 ? doubleTest(storedA, storedB, mRadius.value) : Verdict::kUndecided;
    if (verdict != Verdict::kUndecided) return verdict == Verdict::kYes;
    ++exactPairs;
    const bool isNeighbor = isNeighborExactly(storedA, storedB, mRadius.value);
    if (sameOffsets) tie = {{d[0], d[1], d[2]}, true, isNeighbor};
    return isNeighbor;
}

// The exact comparison in integers of any size. A microsecond.
bool ExactTest::isWithin(const Terms& terms, const Matrix3& m, double radius)
{
    cpp_int d[3];
    int matrixExponent = kNoExponent;
    for (const auto& row : m) {
        for (const double v : row) matrixExponent = std::min(matrixExponent, decompose(v).exponent);
    }
    for (int c = 0; c < 3; ++c) {
        for (const Scaled& s : terms.term[c]) {
            if (s.mantissa) d[c] += cpp_int(s.mantissa) * (cpp_int(1) << (s.exponent - terms.exponent));
        }
    }
    cpp_int sum = 0;
    for (int k = 0; k < 3; ++k) {
        cpp_int w = 0;
        for (int c = 0; c < 3; ++c) {
            const Scaled s = decompose(m[k][c]);
            if (s.mantissa) w += cpp_int(s.mantissa) * (cpp_int(1) << (s.exponent - matrixExponent)) * d[c];
        }
        sum += w * w;
    }
    const Scaled r = decompose(radius);
    cpp_int r2 = cpp_int(r.mantissa) * r.mantissa;
    const int shift = 2 * (r.exponent - terms.exponent - matrixExponent);
    if (shift >= 0) {
        r2 <<= shift;
    } else {
        sum <<= -shift;
    }
    return sum <= r2;
}

// M (b - a) as magnitudes of integers, and the exponent of their unit. False where they could pass 2^126.
bool ExactTest::exactVector(const Terms& terms, ExactVector& vector) const
{
    // Below 2^61 each term, so below 2^63 their sum, 2^124 a product with an entry of M, and 2^126 three of those.
    if (!mSmallMatrix || terms.top - terms.exponent > 61) return false;
    std::int64_t d[3];
    for (int c = 0; c < 3; ++c) {
        d[c] = 0;
        for (const Scaled& s : terms.term[c]) {
            if (s.mantissa) d[c] += s.mantissa * (std::int64_t(1) << (s.exponent - terms.exponent));
        }
    }
    for (int k = 0; k < 3; ++k) {
        Int128 sum = 0;
        for (int c = 0; c < 3; ++c) sum += Int128(mMatrix[k][c]) * d[c];
        vector.w[k] = sum < 0 ? -UInt128(sum) : UInt128(sum);
        vector.bits = std::max(vector.bits, bitsOf(vector.w[k]));
    }
    vector.exponent = terms.exponent + mMatrixExponent;
    return true;
}

bool ExactTest::isNeighborExactly(const StoredPosition& a, const StoredPosition& b, double radius) const
{
    const Terms terms(a, b);
    if (terms.exponent == kNoExponent) return true; // the same place
    const Scaled r = decompose(radius);
    ExactVector vector;
    if (!exactVector(terms, vector)) return isWithin(terms, mQueries.linear(), radius);
    int shift = r.exponent - vector.exponent; // radius = r.mantissa << shift in units of w
    UInt128 scaledRadius = static_cast<UInt128>(r.mantissa);
    if (shift < 0) {
        if (vector.bits - shift > 126) return isWithin(terms, mQueries.linear(), radius);
        vector.shift(-shift);
        shift = 0;
    }
    if (r.bits + shift > 127) return true; // radius >= 2^127 > sqrt(3) * 2^126
    scaledRadius <<= shift;
    return vector.square() <= square(scaledRadius);
}

} // namespace vdb_nns
