// Decides the pairs that the float32 filter leaves, and which of two candidates is nearer: a double test with a bound, then exact
// arithmetic. The only place besides kernels/shared/membership.h and its SIMD twins that compares a distance with the radius.
//
// Double test. Everything is scaled by a power of two that brings the radius into [1, 2), u = 2^-53.
//   arrays: d = b - a has one rounding, so fl(d.d) is within 6 u d.d.
//   grids:  d_c = (voxel difference, exact) + (float difference): error <= 2 u A_c with A_c = |voxel difference| +
//           |P_a| + |P_b|. w = M d: error <= 6 u S_k with S_k = sum |M_kc| A_c, hence fl(w.w) is within
//           12 u sum |w_k| S_k + 36 u^2 S.S + 6 u w.w.
//   two transforms: each position x = M p + t has an error <= 5 u S_k with S_k = sum |M_kc| (|voxel_c| + |P_c|) + |t_k|, their
//           difference w one <= 6 u (S_k + S'_k) =: e_k, hence fl(w.w) is within 2 sum |w_k| e_k + e.e + 4 u w.w.
// A pair is left undecided when |fl(w.w) - r^2| is within twice that bound, or anything is not finite. Of two candidates, none is
// nearer as long as their squares are within both bounds.
//
// Exact test. All coordinates of the pair are integers times one power of two, M's entries another, so w is a vector of
// integers; its square and the radius' are compared as 256-bit integers, or as large as need be where they do not fit. Two
// transforms take integers of any size at once (util/dyadic.h).
#pragma once

#include "points/particle_source.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/particle_view.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns {

class Dyadic;

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

// The radius that decides a pair; not above 0 where it reaches nobody.
double radiusOfPair(const Radius& radius, std::uint32_t query, std::uint32_t candidate);

class ExactTest {
public:
    // The particles of one view, within one radius.
    ExactTest(const ParticleView& view, double radius) : ExactTest(view, view, radius, radius) {}
    // `largest`: of all radii.
    ExactTest(const ParticleView& queries, const ParticleView& candidates, const Radius& radius,
              double largest);

    // Adds to exactPairs where the double test did not decide. Thread-safe with a memory for each thread, which must be
    // new for each test.
    bool isNeighbor(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                    std::uint64_t& exactPairs) const;

    // Whether candidate `a` is nearer to the query than `b`, or as near with a smaller number.
    bool isNearer(std::uint32_t query, std::uint32_t a, std::uint32_t b, std::uint64_t& exactPairs) const;

    // A square of the distance in units of the largest radius squared, about, and a bound on its error; infinite where doubles
    // do not hold it.
    struct Square {
        double value, error;
    };
    Square squareOf(std::uint32_t query, std::uint32_t candidate) const;

    // The exact test alone, of positions with one transform.
    bool isNeighborExactly(const StoredPosition& a, const StoredPosition& b, double radius) const;

private:
    enum class Verdict { kNo, kYes, kUndecided };
    bool isNeighborInGrid(std::uint32_t query, std::uint32_t candidate, ExactTestMemory& memory,
                          std::uint64_t& exactPairs) const;
    Square squareOf(const StoredPosition& query, const StoredPosition& candidate) const;
    Square squareOfTwo(const StoredPosition& query, const StoredPosition& candidate) const;
    Verdict doubleTest(const StoredPosition& a, const StoredPosition& b, double radius) const;
    struct Terms;
    struct ExactVector;
    bool exactVector(const Terms& terms, ExactVector& vector) const;
    static bool isWithin(const Terms& terms, const Matrix3& m, double radius);
    std::optional<int> compareInIntegers(const StoredPosition& query, const StoredPosition& a,
                                         const StoredPosition& b) const;
    Dyadic exactSquare(const StoredPosition& query, const StoredPosition& candidate) const;

    ParticleView mQueries, mCandidates;
    Radius mRadius;
    bool mIsAlike;     // one transform for both
    double mScale = 0; // 2^-k; 0 where it would not be a normal number: no double test
    Matrix3 mScaledLinear{}, mScaledCandidateLinear{};
    Vec3d mScaledTranslation{}, mScaledCandidateTranslation{};
    std::int64_t mMatrix[3][3]; // linear = mMatrix * 2^mMatrixExponent
    int mMatrixExponent = 0;
    bool mSmallMatrix = false; // mMatrix is valid: entries below 2^61
};

} // namespace vdb_nns
