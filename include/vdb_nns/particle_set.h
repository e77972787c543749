// What a search may be about besides all particles of one view within one radius: who asks, among whom, and how far. Plain data.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>

namespace vdb_nns {

/// Particles in one role of a search: those that ask (queries), or those among which neighbors are looked for (candidates).
/// Two sets with the same view are the same particles, so that nobody is a neighbor of itself; in sets of two views nobody is
/// itself. Two views need not share a transform.
struct ParticleSet {
    ParticleView view;
    /// By particle number: not 0 for those that have the role. Empty: all have it. Numbers stay those of the view.
    Span<const std::uint8_t> chosen = {};

    ParticleSet() = default;
    ParticleSet(const ParticleView& particles)
        : view(particles) {} // NOLINT: a view is the set of its particles
    ParticleSet(const ParticleView& particles, Span<const std::uint8_t> mask) : view(particles), chosen(mask)
    {
    }
};

/// Whose radius decides whether the candidate j is a neighbor of the query i.
enum class RadiusMode {
    kGather,   ///< |x_j - x_i| <= r_i
    kScatter,  ///< |x_j - x_i| <= r_j
    kSymmetric ///< |x_j - x_i| <= max(r_i, r_j)
};

/// One radius for all pairs, or one for each particle. World units.
struct Radius {
    /// Of all pairs, > 0 and finite. Not read if particles have radii of their own.
    double value = 0;
    /// By particle number of the queries' view: kGather and kSymmetric read it. One that is NaN, infinite or <= 0 reaches
    /// nobody, and counts as less than any other in a maximum.
    Span<const double> ofQueries = {};
    /// By particle number of the candidates' view: kScatter and kSymmetric read it.
    Span<const double> ofCandidates = {};
    RadiusMode mode = RadiusMode::kGather;

    Radius() = default;
    Radius(double ofAllPairs) : value(ofAllPairs) {} // NOLINT: a number is a radius

    bool isOne() const { return ofQueries.empty() && ofCandidates.empty(); }
};

} // namespace vdb_nns
