// Decides the pairs that the float32 filter leaves: a double test with a bound, then exact arithmetic. The only place
// besides kernels/shared/membership.h and its SIMD twin that compares a distance with the radius.
//
// Double test. Everything is scaled by a power of two that brings the radius into [1, 2), u = 2^-53.
//   arrays: d = b - a has one rounding, so fl(d.d) is within 6 u d.d.
//   grids:  d_c = (voxel difference, exact) + (float difference): error <= 2 u A_c with A_c = |voxel difference| +
//           |P_a| + |P_b|. w = M d: error <= 6 u S_k with S_k = sum |M_kc| A_c, hence fl(w.w) is within
//           12 u sum |w_k| S_k + 36 u^2 S.S + 6 u w.w.
// A pair is left undecided when |fl(w.w) - r^2| is within twice that bound, or anything is not finite.
//
// Exact test. All coordinates of the pair are integers times one power of two, M's entries another, so w is a vector of
// integers; its square and the radius' are compared as 256-bit integers, or as large as need be where they do not fit.
#pragma once

#include "vdb_nns/particle_view.h"

#include "points/particle_source.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

// What one thread remembers between pairs of a VDB grid: positions, which come again with the queries around them; and how
// ties of particles with equal offsets were decided, which depends on the voxel difference alone: on a perfect lattice
// there are few of those.
struct ExactTestMemory {
    // A StoredPosition of a grid is a Coord and floats.
    struct Position {
        std::uint32_t number = 0xffffffffu; // of the particle; no particle has this one
        std::int32_t voxel[3];
        float offset[3];
    };
    struct Tie {
        std::int64_t voxels[3] = {};
        bool known = false, isNeighbor = false;
    };
    // 256 KB, which stays in the second-level cache and holds a leaf of 16 particles a cell.
    static constexpr int kPositionBits = 13;

    Position query;
    std::vector<Position> positions; // by a hash of the number; made at the first pair
    Tie ties[64];

    const Position& positionOf(const ParticleSource& source, std::uint32_t number);
};

class ExactTest {
public:
    ExactTest(const ParticleView& view, double radius);

    // Adds to exactPairs where the double test did not decide. Thread-safe with a memory for each thread, which must be
    // new for each test.
    bool isNeighbor(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                    std::uint64_t& exactPairs) const;

    // The exact test alone.
    bool isNeighborExactly(const StoredPosition& a, const StoredPosition& b) const;

private:
    enum class Verdict { kNo, kYes, kUndecided };
    bool isNeighborInGrid(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                          std::uint64_t& exactPairs) const;
    Verdict doubleTest(const StoredPosition& a, const StoredPosition& b) const;

    ParticleView mView;
    double mRadius;
    double mScale = 0; // 2^-k; 0 where it would not be a normal number: no double test
    double mScaledRadius2 = 0;
    Matrix3 mScaledLinear{};
    std::int64_t mMatrix[3][3]; // linear = mMatrix * 2^mMatrixExponent
    int mMatrixExponent = 0;
    bool mSmallMatrix = false; // mMatrix is valid: entries below 2^61
};

} // namespace vdb_nns
