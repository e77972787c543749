// The SIMD twin of kernels/shared/membership.h: score, band and box filter of a vector of candidates. The bound proved
// there holds for this arithmetic, fused or not. Internal linkage; see simd.h.
#pragma once

#include "execute/simd.h"
#include "shared/membership.h"

namespace vdb_nns {
namespace {

// A frame is a set of candidates and the score of a query against them, a vector at a time. `base` and `stride` are those
// of HaloScratch; kNumber is where its particle numbers stand.

// The candidates that a cell keeps, about the centre of its queries' box: s = fl(w_c + K + a.p_c).
struct KeptFrame {
    static constexpr std::size_t kNumber = 8;

    struct Query {
        Simd::F ax, ay, az, k;

        Query(const FilterBounds& bounds, const char* own, std::size_t stride)
            : ax(Simd::set(-2 * *floats(own))),
              ay(Simd::set(-2 * *floats(own + stride))),
              az(Simd::set(-2 * *floats(own + 2 * stride))),
              k(Simd::set(*floats(own + 4 * stride) - bounds.far))
        {
        }

        Simd::F score(const char* p, std::size_t stride) const
        {
            const Simd::F sum = Simd::add(Simd::load(floats(p + 4 * stride)), k);
            const Simd::F x = Simd::mulAdd(Simd::load(floats(p)), ax, sum);
            return Simd::mulAdd(Simd::load(floats(p + 2 * stride)), az,
                                Simd::mulAdd(Simd::load(floats(p + stride)), ay, x));
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
};

// A leaf and its halo, about the leaf's centre: s = fl(|v_c - v_q|^2 - far).
struct HaloFrame {
    static constexpr std::size_t kNumber = 4;

    struct Query {
        Simd::F x, y, z, minusFar;

        Query(const FilterBounds& bounds, const char* own, std::size_t stride)
            : x(Simd::set(*floats(own))),
              y(Simd::set(*floats(own + stride))),
              z(Simd::set(*floats(own + 2 * stride))),
              minusFar(Simd::set(-bounds.far))
        {
        }

        Simd::F score(const char* p, std::size_t stride) const
        {
            const Simd::F dx = Simd::sub(Simd::load(floats(p)), x);
            const Simd::F dy = Simd::sub(Simd::load(floats(p + stride)), y);
            const Simd::F dz = Simd::sub(Simd::load(floats(p + 2 * stride)), z);
            return Simd::mulAdd(dz, dz, Simd::mulAdd(dy, dy, Simd::mulAdd(dx, dx, minusFar)));
        }
    };

    const char* base;
    std::size_t stride;
    std::uint32_t count;
};

inline Simd::F squaredLength(Simd::F x, Simd::F y, Simd::F z)
{
    return Simd::mulAdd(z, z, Simd::mulAdd(y, y, Simd::mul(x, x)));
}

// The box of a cell's queries: its centre and half its size, in the frame of the leaf and about the centre.
struct QueryBox {
    Simd::F centerX, centerY, centerZ, halfX, halfY, halfZ, keep;

    // Candidates about the centre that may be neighbors of a query in the box.
    Simd::Mask near(Simd::F px, Simd::F py, Simd::F pz) const
    {
        const Simd::F zero = Simd::set(0.0f);
        return Simd::lessEqual(squaredLength(Simd::max(Simd::sub(Simd::abs(px), halfX), zero),
                                             Simd::max(Simd::sub(Simd::abs(py), halfY), zero),
                                             Simd::max(Simd::sub(Simd::abs(pz), halfZ), zero)),
                               keep);
    }
};

} // namespace
} // namespace vdb_nns
