// The SIMD twin of kernels/shared/membership.h: score, band and ball filter of a vector of candidates. The bound proved
// there holds for this arithmetic, fused or not. Internal linkage; see simd.h.
#pragma once

#include "cpu/simd.h"
#include "shared/membership.h"

namespace vdb_nns {
namespace {

// A frame is a set of candidates and the score of a query against them, a vector at a time. `base` and `stride` are those
// of HaloScratch; kNumber is where its particle numbers stand. kIsHalf: a query is tested only against the candidates that stand before it.

// The candidates that a cell keeps, in a half frame the queries last, about the centre of its queries' box: s = fl(w_c + K + a.p_c).
template <bool kIsHalfOf>
struct CellFrame {
    static constexpr std::size_t kNumber = 8;
    static constexpr bool kIsHalf = kIsHalfOf;

    struct Candidates {
        Simd::F x, y, z, w;

        Candidates(const char* p, std::size_t stride)
            : x(Simd::load(floats(p))),
              y(Simd::load(floats(p + stride))),
              z(Simd::load(floats(p + 2 * stride))),
              w(Simd::load(floats(p + 4 * stride)))
        {
        }
    };

    struct Query {
        Simd::F ax, ay, az, k;

        Query(const FilterBounds& bounds, const char* own, std::size_t stride)
            : ax(Simd::set(-2 * *floats(own))),
              ay(Simd::set(-2 * *floats(own + stride))),
              az(Simd::set(-2 * *floats(own + 2 * stride))),
              k(Simd::set(*floats(own + 4 * stride) - bounds.far))
        {
        }

        Simd::F score(const Candidates& c) const
        {
            return Simd::mulAdd(c.z, az, Simd::mulAdd(c.y, ay, Simd::mulAdd(c.x, ax, Simd::add(c.w, k))));
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
};

// A leaf and its halo, about the leaf's centre: s = fl(|v_c - v_q|^2 - far).
struct HaloFrame {
    static constexpr std::size_t kNumber = 4;
    static constexpr bool kIsHalf = false;

    struct Candidates {
        Simd::F x, y, z;

        Candidates(const char* p, std::size_t stride)
            : x(Simd::load(floats(p))),
              y(Simd::load(floats(p + stride))),
              z(Simd::load(floats(p + 2 * stride)))
        {
        }
    };

    struct Query {
        Simd::F x, y, z, minusFar;

        Query(const FilterBounds& bounds, const char* own, std::size_t stride)
            : x(Simd::set(*floats(own))),
              y(Simd::set(*floats(own + stride))),
              z(Simd::set(*floats(own + 2 * stride))),
              minusFar(Simd::set(-bounds.far))
        {
        }

        Simd::F score(const Candidates& c) const
        {
            const Simd::F dx = Simd::sub(c.x, x), dy = Simd::sub(c.y, y), dz = Simd::sub(c.z, z);
            return Simd::mulAdd(dz, dz, Simd::mulAdd(dy, dy, Simd::mulAdd(dx, dx, minusFar)));
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
};

inline NarrowSimd::F squaredLength(NarrowSimd::F x, NarrowSimd::F y, NarrowSimd::F z)
{
    return NarrowSimd::mulAdd(z, z, NarrowSimd::mulAdd(y, y, NarrowSimd::mul(x, x)));
}

// Where a cell's queries are, in the frame of the leaf: a box, its centre, and how far from the centre and from the box
// neighbors of theirs can be.
struct QueryBounds {
    NarrowSimd::F centerX, centerY, centerZ, halfX, halfY, halfZ;
    NarrowSimd::F ballKeep, boxKeep; // squared
    float center[3];                 // the same as above

    // Candidates about the centre that may be neighbors of a query, by the ball around the queries, and if kBox by their
    // box too, which costs as much again and keeps fewer.
    template <bool kBox>
    NarrowSimd::Mask near(NarrowSimd::F px, NarrowSimd::F py, NarrowSimd::F pz, NarrowSimd::F length) const
    {
        const NarrowSimd::Mask inBall = NarrowSimd::lessEqual(length, ballKeep);
        if constexpr (!kBox) return inBall;
        const NarrowSimd::F zero = NarrowSimd::set(0.0f);
        return inBall & NarrowSimd::lessEqual(
                            squaredLength(NarrowSimd::max(NarrowSimd::sub(NarrowSimd::abs(px), halfX), zero),
                                          NarrowSimd::max(NarrowSimd::sub(NarrowSimd::abs(py), halfY), zero),
                                          NarrowSimd::max(NarrowSimd::sub(NarrowSimd::abs(pz), halfZ), zero)),
                            boxKeep);
    }
};

} // namespace
} // namespace vdb_nns
