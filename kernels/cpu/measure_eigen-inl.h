// Eigenvalues and eigenvectors of measures (measure_rows.h), a matrix in each lane, for the instruction set of the including file.
// Internal linkage; see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/measure_sums-inl.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

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

} // namespace
} // namespace vdb_nns
