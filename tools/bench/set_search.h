// A search of two sets as methods of `bench` are asked for it.
#pragma once

#include "vdb_nns/particle_set.h"

#include <cmath>
#include <cstddef>
#include <cstdint>

namespace vdb_nns::cli {

/// Who asks, among whom, how far, and how many neighbors are kept. Plain; the arrays that it views must
/// outlive it.
struct SetSearch {
    ParticleSet queries, candidates;
    Radius radius;
    std::uint32_t nearest = 0; ///< of each list; 0: all

    SetSearch() = default;
    /// All particles of a view within one radius.
    SetSearch(const ParticleView& view, double one) : queries(view), candidates(view), radius(one) {}

    /// Whether number i is the same particle in both sets, and nobody's neighbor is itself.
    bool isOneSet() const { return &queries.view.source() == &candidates.view.source(); }

    /// Whether it asks for nothing but all neighbors of all particles within one radius.
    bool isPlain() const
    {
        return isOneSet() && queries.chosen.empty() && candidates.chosen.empty() && radius.isOne() &&
               nearest == 0;
    }

    bool hasQuery(std::size_t i) const { return queries.chosen.empty() || queries.chosen[i] != 0; }
    bool hasCandidate(std::size_t j) const { return candidates.chosen.empty() || candidates.chosen[j] != 0; }

    /// As it is stored, good or bad. Of kScatter there is none.
    double queryRadius(std::size_t i) const { return radius.isOne() ? radius.value : radius.ofQueries[i]; }

    /// What a plain program takes, without a look at whether radii are good.
    double pairRadius(std::size_t i, std::size_t j) const
    {
        if (radius.isOne() || radius.mode == RadiusMode::kGather) return queryRadius(i);
        if (radius.mode == RadiusMode::kScatter) return radius.ofCandidates[j];
        return std::fmax(radius.ofQueries[i], radius.ofCandidates[j]); // the number where the other is NaN
    }

    /// The largest finite one that is read; 0 where there is none.
    double largestRadius() const
    {
        if (radius.isOne()) return radius.value;
        double largest = 0;
        const auto note = [&largest](Span<const double> radii) {
            for (const double r : radii) {
                if (std::isfinite(r) && r > largest) largest = r;
            }
        };
        if (radius.mode != RadiusMode::kScatter) note(radius.ofQueries);
        if (radius.mode != RadiusMode::kGather) note(radius.ofCandidates);
        return largest;
    }
};

} // namespace vdb_nns::cli
