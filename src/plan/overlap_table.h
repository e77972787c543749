// The share of pairs of two cells that are within the radius, when particles are uniform in each: D / V^2 of
// the paper's expectation (Kim et al. 2014). Unit: the cell edge. Knows neither grids nor particles.
//
//   share(dx, dy, dz) = integral over |(u, v, w)| <= rho of t(u - dx) t(v - dy) t(w - dz)
//
// with t(s) = max(0, 1 - |s|), since the difference of two uniform coordinates is triangular. Over all
// offsets the shares sum to (4/3) pi rho^3.
#pragma once

#include "util/cancel.h"

#include <array>
#include <cstdint>

namespace vdb_nns {

class OverlapTable {
public:
    static constexpr int kMaxReach = 3;

    // By quadrature: error <= 1e-9 a share, under a millisecond.
    // radiusCells is above 0 and at most reach, which is 1 to 3.
    static OverlapTable byQuadrature(double radiusCells, int reach);

    // By that many random pairs of points (at least 1) for each class of offsets, as the paper does with 1e6.
    // Deterministic for a seed. Takes the same radii as byQuadrature(). Throws Cancelled.
    static OverlapTable byMonteCarlo(double radiusCells, int reach, std::uint64_t samples, std::uint64_t seed,
                                     const CancelCheck& cancel);

    int reach() const { return mReach; }

    // Offsets from -reach to reach.
    double share(int dx, int dy, int dz) const;

    // Over all offsets.
    double sum() const;

private:
    explicit OverlapTable(int reach) : mReach(reach) {}

    int mReach;
    // By |dx|, |dy|, |dz| in ascending order: the share does not depend on signs or on the order of the axes.
    std::array<double, 20> mShares{};
};

} // namespace vdb_nns
