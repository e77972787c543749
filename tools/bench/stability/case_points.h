// Points for stability cases: made as doubles in units in which the spacing is 1 and the radius 2, then moved to arrays.
#pragma once

#include "bench/stability/cases.h"
#include "numbers.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Random numbers that are the same everywhere.
class CaseRandom {
public:
    explicit CaseRandom(std::uint64_t seed) : mState(mix64(seed)) {}

    std::uint64_t bits() { return mix64(mState += 0x9e3779b97f4a7c15ull); }
    double uniform(double low, double high)
    {
        return low + (high - low) * static_cast<double>(bits() >> 11) * 0x1p-53;
    }
    Vec3d point(double half) { return {uniform(-half, half), uniform(-half, half), uniform(-half, half)}; }

private:
    std::uint64_t mState;
};

struct CasePoints {
    std::vector<Vec3d> at;
    double radius = 2;
    KnownRows known = KnownRows::kUnknown;
};

/// Who asks, among whom, and how far.
struct SetPoints {
    CasePoints candidates;           ///< its radius is that of all pairs, where there are no radii
    std::vector<Vec3d> queries = {}; ///< of a set of their own; empty: the candidates
    std::vector<double> queryRadii = {}, candidateRadii = {};
    std::vector<std::uint8_t> queryChosen = {}, candidateChosen = {};
    RadiusMode mode = RadiusMode::kGather;
    std::uint32_t nearest = 0;
};

constexpr double kJitter = 0.2; // of the spacing, as the scenes have it

/// Adds a lattice of n particles along each axis about `center`.
void addLattice(std::vector<Vec3d>& points, const Vec3d& center, const Vec3i& n, double jitter,
                CaseRandom& random);

/// A jittered cube of edge^3 particles about `center`.
CasePoints blockPoints(int edge, const Vec3d& center = {0, 0, 0});

/// Of a scene, in its own units.
CasePoints scenePoints(const std::string& name, std::uint64_t count);

/// Everything by that factor.
CasePoints scaled(CasePoints points, double factor);

CaseParticles asFloats(const CasePoints& points);
CaseParticles asDoubles(const CasePoints& points);

/// A search of sets of floats.
CaseParticles asSets(SetPoints points);

} // namespace vdb_nns::cli
