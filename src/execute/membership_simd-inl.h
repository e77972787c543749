// The SIMD twin of kernels/shared/membership.h: score, band and box filter of a vector of candidates. The bound proved
// there holds for this arithmetic, fused or not. Internal linkage; see simd.h.
#pragma once

#include "execute/simd.h"
#include "shared/membership.h"

namespace vdb_nns {
namespace {

struct QueryVectors {
    Simd::F ax, ay, az, k; // -2 p_q, and K

    QueryVectors(const FilterBounds& bounds, float px, float py, float pz, float squaredLength)
        : ax(Simd::set(-2 * px)),
          ay(Simd::set(-2 * py)),
          az(Simd::set(-2 * pz)),
          k(Simd::set(squaredLength - bounds.far))
    {
    }

    // s of the kept candidates at `p`; see HaloScratch for the offsets.
    Simd::F score(const char* p, std::size_t stride) const
    {
        const Simd::F sum = Simd::add(Simd::load(floats(p + 4 * stride)), k);
        const Simd::F x = Simd::mulAdd(Simd::load(floats(p)), ax, sum);
        return Simd::mulAdd(Simd::load(floats(p + 2 * stride)), az,
                            Simd::mulAdd(Simd::load(floats(p + stride)), ay, x));
    }
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
