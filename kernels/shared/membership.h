// Who is a neighbor: the float32 filter, its bound and its proof. Any compiler; the one place, with its SIMD twin
// kernels/cpu/membership_simd-inl.h, where the search compares a distance with a radius.
//
// Unit: the cell edge. rho is the radius in cells, u = 2^-24 the rounding unit of float. R = reach, 1 to 3.
//
// 1. Coordinates. A particle's true position about its leaf's centre is stored as a float x, |x| <= 4:
//      error <= E + 2^-23                          E: computing it in double (CellMap); half a float spacing below 4
//    Moved into the frame of the query's leaf, v = fl(x + 8 k), |v| < 8:     error + 2^-22
//    Moved to a centre m inside the query's cell, p = fl(v - m), |p| <= R + 1 <= 4:   error + 2^-23
//    so per axis |p - true| <= eta = E + 2^-21, and for a query q and a candidate c of one frame, with
//      D = |p_c - p_q|^2 of the floats as they are,  d the true distance:    |sqrt(D) - d| <= 2 sqrt(3) eta =: delta
//    m is the centre of the box of the cell's queries, or of the cell itself: then |p_q| <= 1/2 + 2^-20 an axis, as cells
//    are found from rounded coordinates, and |p_c| <= R + 1/2 + 2^-20: far inside what the sums below take. Devices take
//    x + (8 k - m) at once, which rounds once.
//
// 2. Arithmetic. The score of a candidate is s = fl(w_c + K + a.p_c) with w_c = fl(|p_c|^2), a = -2 p_q (exact),
//    K = fl(w_q - far), far = rho^2 + beta rounded to float. In real arithmetic it would be D - (rho^2 + beta). With
//    |p_c|^2 <= W = 3 (R+1)^2, |p_q| <= 1/2 an axis, |a.p_c| <= X = 3 (R+1), |p_q|^2 < 1 and |K|, far <= Q = rho^2 + 1:
//      w_c: three roundings below W                                              3 u W
//      K:   three roundings of w_q below 1, far's and the difference's           3 u + 2 u Q
//      the sum w + K and three sums, each below W + Q + X; the products, where the machine does not fuse them, below X:
//                                                                                4 u (W + Q + X) + u X
//    Their total times 1.001 is at least |s - (D - rho^2 - beta)| (second order terms are below 1e-6 of it). Flushed denormals
//    add less than 1e-36.
//
//    In sparse leaves the score is s = fl(|v_c - v_q|^2 - far), coordinates about the leaf's centre, which carry less error
//    than eta. The differences round once, the three products (if not fused) and sums once each: |s - (D - far)| <=
//    7 u (D + far) up to second order. For D <= 2 far that is below 21 u far, less than the total above; for D > 2 far s
//    is positive, as it should be.
//
// 3. Decision. If d <= rho then D <= (rho + delta)^2, so D - rho^2 <= 2 rho delta + delta^2; if d > rho then
//    D - rho^2 > -(2 rho delta). With beta >= 2 rho delta + delta^2 + total:
//      s >= 0          =>  d > rho        surely not a neighbor
//      s < -2 beta     =>  d < rho        surely a neighbor
//      otherwise       in the band: a double test and, if need be, exact arithmetic decide (exact/exact_test.h)
//    The band is the sign bit and one integer comparison: negative floats of small magnitude are the smallest integers.
//
// 4. Ball and box filter. About the centre m of a cell's queries, |p_c| <= |p_q| + sqrt(D), and a neighbor has sqrt(D) <= rho +
//    delta. With fl(|p_q|^2) <= M for all queries, candidates with fl(|p_c|^2) > keepSquared(M) are dropped: the three
//    roundings of either square are far below the factors of 1e-5 there. The same holds for the distance of p_c from a
//    box that holds all p_q, with M = 0: per axis it is fl(|p_c| - half) or 0, one more rounding.
//
// 5. Radii of particles. All of a search are at most rho, the lattice's, and beta is that of rho: it grows with rho, so steps 2 and
//    3 hold for every smaller radius r with far = r^2 + beta, and so does the band, [-2 beta, 0). A pair that goes by the larger
//    radius of the two has s = fl(fl(w_c + w_q + a.p_c) - max(far_q, far_c)): one more sum below W + Q + X. Neighbors have
//    sqrt(D) <= r + delta <= sqrt(r^2 + beta), as beta >= 2 r delta + delta^2: reachableOf().
//
// 6. Which is nearer. A score is D - far with an error below beta, and D is within 2 rho delta + delta^2, which beta covers
//    too, of the square of the true distance. With one far, scores that are more than 2 beta apart are ordered as the
//    distances are.
//
// 7. Cells of several widths. Edges that are a power of two apart, counted from one corner: a true cell coordinate in the wide
//    lattice is that in the narrow one divided by 2^s, and a query is in the wide cell that holds its narrow one (WidePlace). Its
//    coordinate about the wide leaf's centre, fl(x 2^-s + shift), has the error E 2^-s + 2^-23 2^-s of x, 2^-23 of the sum, and
//    2^-23 where shift itself is rounded, past s = 24. As no query is moved into another leaf's frame, the 2^-22 of that covers
//    what is added, and eta is as in step 1, with E the larger of the candidates' and of the queries' divided by 2^s.
#pragma once

#include "shared/annotation.h"

#include <cmath>
#include <cstdint>
#include <cstring>

namespace vdb_nns {

struct FilterBounds {
    float far;       // rho^2 + beta
    float reachable; // rho + delta, rounded up
    std::int32_t
        bandTop; // bits of -2 beta, rounded away from zero: s is in the band iff negative and bits <= bandTop
};

VDB_NNS_HOST_DEVICE static inline std::int32_t floatBits(float value)
{
    std::int32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

// Of the filter's error.
struct FilterError {
    double delta; // of a distance
    double beta;  // of a score
};

/// @param radiusCells rho, with a relative error of at most 1e-14
/// @param coordinateError E, in cells
/// @param sums of a score, each below W + Q + X: 4, or 5 with a radius of each candidate
static inline FilterError filterError(double radiusCells, int reach, double coordinateError, int sums)
{
    const double u = 0x1p-24, rho2 = radiusCells * radiusCells;
    const double delta = 2 * 1.7320508075688774 * (coordinateError + 0x1p-21);
    const double w = 3.0 * (reach + 1) * (reach + 1), x = 3.0 * (reach + 1), q = rho2 + 1;
    const double arithmetic = u * (3 * w + 3 + 2 * q + sums * (w + q + x) + x) * 1.001;
    return {delta, (2 * radiusCells * delta + delta * delta + arithmetic + 1e-13 * rho2) * 1.001};
}

static inline FilterBounds makeFilterBounds(double radiusCells, int reach, double coordinateError,
                                            int sums = 4)
{
    const FilterError error = filterError(radiusCells, reach, coordinateError, sums);
    FilterBounds bounds;
    bounds.far = static_cast<float>(radiusCells * radiusCells + error.beta);
    bounds.reachable = std::nextafter(static_cast<float>(radiusCells + error.delta), 1e30f);
    bounds.bandTop = floatBits(std::nextafter(static_cast<float>(-2 * error.beta), -1e30f));
    return bounds;
}

/// FilterBounds::far of a particle's own radius, in a search whose largest radius has the error `error`. One that is not positive
/// and finite reaches nobody, and counts as 0: of those at the same place the exact test decides.
static inline float farOf(double radiusCells, const FilterError& error)
{
    const double rho = radiusCells > 0 && radiusCells <= 1e6 ? radiusCells : 0;
    return static_cast<float>(rho * rho + error.beta);
}

/// FilterBounds::reachable of particles of which the largest has this farOf().
static inline float reachableOf(float far)
{
    return far > 0 ? sqrtf(far) * 1.00001f : 0;
}

/// What a query brings to its tests, about a centre m. The scalar test, for the host and for devices.
struct QueryTerms {
    float ax, ay, az, k;
};

// One rounding or two: the bound holds for both. Never left to the compiler, so that a test that is made twice comes out
// the same.
VDB_NNS_HOST_DEVICE static inline float mulAdd(float a, float b, float c)
{
#if defined(__CUDA_ARCH__)
    return fmaf(a, b, c);
#else
    return a * b + c;
#endif
}

VDB_NNS_HOST_DEVICE static inline float squaredNorm(float x, float y, float z)
{
    return mulAdd(z, z, mulAdd(y, y, x * x));
}

VDB_NNS_HOST_DEVICE static inline QueryTerms queryTerms(const FilterBounds& bounds, float x, float y, float z)
{
    return {-2 * x, -2 * y, -2 * z, squaredNorm(x, y, z) - bounds.far};
}

/// @param w squaredNorm() of the candidate; infinite for no candidate
/// @return bits of s: negative for a neighbor and for a candidate in the band
VDB_NNS_HOST_DEVICE static inline std::int32_t scoreBits(const QueryTerms& query, float x, float y, float z,
                                                         float w)
{
    return floatBits(mulAdd(z, query.az, mulAdd(y, query.ay, mulAdd(x, query.ax, w + query.k))));
}

/// Squared distance from the centre of a cell's queries past which nothing is their neighbor.
/// @param reachable FilterBounds::reachable
/// @param mostSquared largest squared distance of a query from that centre
VDB_NNS_HOST_DEVICE static inline float keepSquared(float reachable, float mostSquared)
{
    const float most = sqrtf(mostSquared) * 1.00001f + reachable;
    return most * most * 1.00001f;
}

} // namespace vdb_nns
