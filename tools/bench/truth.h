// Exact truth: who is a neighbor by definition, from the independent search that `verify` uses.
#pragma once

#include "bench/set_search.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

/// Queries, ascending, and the neighbors that they have by definition.
struct Truth {
    bool complete = false; ///< every particle is a query
    std::vector<std::uint32_t> queries;
    std::vector<std::uint64_t> begin{0};  ///< of each row in `neighbors`; one more than queries
    std::vector<std::uint32_t> neighbors; ///< ascending in each row
    /// Of each query: 1 + the sum of (1 - (d/r)^2)^3 over its neighbors, a particle density without its factor (Mueller,
    /// Charypar, Gross: Particle-Based Fluid Simulation for Interactive Applications, SCA 2003).
    std::vector<double> density;

    Span<const std::uint32_t> row(std::size_t k) const
    {
        return {neighbors.data() + begin[k], static_cast<std::size_t>(begin[k + 1] - begin[k])};
    }
    std::uint64_t pairs() const { return neighbors.size(); }
};

struct TruthOptions {
    /// Queries drawn, each tested against all candidates; 0: none. Empty: every particle is a query, found by
    /// cells, where that takes no more than some ten seconds and a quarter of the memory, else 1000 are
    /// drawn.
    std::optional<std::uint64_t> sample;
    std::uint64_t seed = 1;
    Progress* progress = nullptr;
};

/// Double arithmetic with a certified bound, exact arithmetic inside it.
/// @throws InputError when positions are too large for double arithmetic; Cancelled
Truth findTruth(const ParticleView& view, double radius, const TruthOptions& options);

/// The same of two sets, radii of particles and the nearest, by the search of `verify` for these. Every
/// particle of the queries' view has a row, empty for those without the role; the densities are left out.
/// @throws as above
Truth findTruth(const SetSearch& search, const TruthOptions& options);

/// Every particle once `sample` is all of them, else one of each of `sample` equal shares; ascending. The
/// same seed draws the same.
std::vector<std::uint32_t> drawQueries(std::uint64_t size, std::uint64_t sample, std::uint64_t seed);

/// What a pair at this distance adds to Truth::density; 0 beyond the radius.
inline double densityWeight(double distance, double radius)
{
    const double q = distance / radius, w = 1 - q * q;
    return w > 0 ? w * w * w : 0;
}

} // namespace vdb_nns::cli
