// Principal axes of measures (measure_rows.h), a matrix in each lane, for the instruction set of the including file. Internal linkage;
// see simd.h.
#pragma once

#include "cpu/measure_rows.h"
#include "cpu/measure_sums-inl.h"
#include "cpu/simd_double.h"

namespace vdb_nns {
namespace {

// A symmetric matrix in each lane, and vectors that it has been turned by.
struct Rotated {
    SimdD::D a[6];    // xx, yy, zz, xy, xz, yz
    SimdD::D v[3][3]; // of each vector x, y and z
};

// One rotation of the plane (p, q), r being the third axis: the off-diagonal apq becomes 0.
VDB_NNS_INLINE void rotate(SimdD::D& app, SimdD::D& aqq, SimdD::D& apq, SimdD::D& arp, SimdD::D& arq,
                           SimdD::D* vp, SimdD::D* vq)
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

// Puts the larger value, and its vector, first.
VDB_NNS_INLINE void sortTwo(Rotated& m, int first, int second)
{
    using S = SimdD;
    const S::M isWrong = S::less(m.a[first], m.a[second]);
    const auto swap = [&](S::D& x, S::D& y) {
        const S::D to = S::where(isWrong, y, x);
        y = S::where(isWrong, x, y);
        x = to;
    };
    swap(m.a[first], m.a[second]);
    for (int c = 0; c < 3; ++c) swap(m.v[first][c], m.v[second][c]);
}

// Turns a vector over where its component of the largest magnitude, the first of several, is negative.
VDB_NNS_INLINE void makePositive(SimdD::D (&v)[3])
{
    using S = SimdD;
    S::D largest = v[0];
    for (int c = 1; c < 3; ++c) largest = S::where(S::less(S::abs(largest), S::abs(v[c])), v[c], largest);
    const S::D sign = S::where(S::less(largest, S::set(0)), S::set(-1), S::set(1));
    for (S::D& x : v) x = S::mul(x, sign);
}

// What brings the largest of six numbers to about 1, so that their squares stay within the range.
inline double scaleOfLargest(double largest)
{
    std::uint64_t bits;
    std::memcpy(&bits, &largest, sizeof bits);
    const int exponent = static_cast<int>(bits >> 52) - 1023;
    return exponent > 1000 || exponent < -1000 ? 1 : powerOfTwo(-exponent);
}

inline void axes(const double* matrices, std::size_t count, double* out)
{
    using S = SimdD;
    // After which off-diagonals of 4 million random and graded matrices were below 1e-19 of the rest.
    constexpr int kSweeps = 4;
    // A rotation waits for roots and quotients one after the other: those of other matrices go meanwhile.
    constexpr std::size_t kAtOnce = 2, kLanes = S::kLanes;
    static_assert(kAxesPad % (kAtOnce * kLanes) == 0, "whole steps");
    for (std::size_t i = 0; i < count; i += kAtOnce * kLanes) {
        Rotated m[kAtOnce];
        S::D inverse[kAtOnce];
        for (std::size_t j = 0; j < kAtOnce; ++j) {
            S::D largest = S::set(0);
            for (std::size_t p = 0; p < 6; ++p) {
                m[j].a[p] = S::load(matrices + p * count + i + j * kLanes);
                largest = S::max(largest, S::abs(m[j].a[p]));
            }
            double scales[kLanes], inverses[kLanes];
            S::store(scales, largest);
            for (std::size_t l = 0; l < kLanes; ++l) {
                scales[l] = scaleOfLargest(scales[l]);
                inverses[l] = 1 / scales[l];
            }
            inverse[j] = S::load(inverses);
            for (S::D& a : m[j].a) a = S::mul(a, S::load(scales));
            for (int k = 0; k < 3; ++k) {
                for (int c = 0; c < 3; ++c) m[j].v[k][c] = S::set(k == c ? 1 : 0);
            }
        }
        for (int sweep = 0; sweep < kSweeps; ++sweep) {
            for (Rotated& r : m) rotate(r.a[0], r.a[1], r.a[3], r.a[4], r.a[5], r.v[0], r.v[1]);
            for (Rotated& r : m) rotate(r.a[0], r.a[2], r.a[4], r.a[3], r.a[5], r.v[0], r.v[2]);
            for (Rotated& r : m) rotate(r.a[1], r.a[2], r.a[5], r.a[3], r.a[4], r.v[1], r.v[2]);
        }
        for (std::size_t j = 0; j < kAtOnce; ++j) {
            Rotated& r = m[j];
            sortTwo(r, 0, 1);
            sortTwo(r, 1, 2);
            sortTwo(r, 0, 1);
            makePositive(r.v[0]);
            makePositive(r.v[1]);
            const auto put = [&](std::size_t n, S::D value) {
                S::store(out + n * count + i + j * kLanes, value);
            };
            for (std::size_t k = 0; k < 3; ++k) // rounding may have gone below 0
                put(k, S::max(S::mul(r.a[k], inverse[j]), S::set(0)));
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t d = (c + 1) % 3, e = (c + 2) % 3;
                put(3 + 3 * c, r.v[0][c]);
                put(4 + 3 * c, r.v[1][c]);
                put(5 + 3 * c, S::sub(S::mul(r.v[0][d], r.v[1][e]), S::mul(r.v[0][e], r.v[1][d])));
            }
        }
    }
}

// 1 / cbrt(x) of x from `least` to 1: the C library's cube root differs from version to version.
VDB_NNS_INLINE SimdD::D inverseCubeRoot(SimdD::D x, double least)
{
    using S = SimdD;
    S::D scale = S::set(1);
    for (; least < 0.125; least *= 8) {
        const S::M isSmall = S::less(x, S::set(0.125));
        x = S::where(isSmall, S::mul(x, S::set(8)), x);
        scale = S::where(isSmall, S::add(scale, scale), scale);
    }
    // Newton's steps, without a division, from within 20 %.
    S::D y = S::sub(S::set(2.1), S::mul(S::set(1.15), x));
    for (int step = 0; step < 6; ++step) {
        const S::D cube = S::mul(S::mul(y, y), y);
        y = S::mul(y, S::mul(S::sub(S::set(4), S::mul(x, cube)), S::set(1.0 / 3)));
    }
    return S::mul(y, scale);
}

inline void stretches(const double* values, std::size_t count, double anisotropy, double* out)
{
    using S = SimdD;
    for (std::size_t i = 0; i < count; i += S::kLanes) {
        const S::D largest = S::load(values + i), least = S::set(anisotropy), one = S::set(1);
        const S::M isPoint = S::equal(largest, S::set(0));
        const auto ratio = [&](std::size_t k) {
            const S::D value = S::max(S::div(S::load(values + k * count + i), largest), least);
            return S::where(isPoint, one, value);
        };
        const S::D second = ratio(1), third = ratio(2);
        const S::D by = S::mul(inverseCubeRoot(second, anisotropy), inverseCubeRoot(third, anisotropy));
        S::store(out + i, by);
        S::store(out + count + i, S::mul(second, by));
        S::store(out + 2 * count + i, S::mul(third, by));
    }
}

} // namespace
} // namespace vdb_nns
