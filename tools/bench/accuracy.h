// How far a method is from the truth.
#pragma once

#include "bench/found_neighbors.h"
#include "bench/truth.h"
#include "vdb_nns/particle_view.h"

#include <cstdint>
#include <optional>

namespace vdb_nns::cli {

/// Against the truth, on its queries. Ordered pairs.
struct AccuracyReport {
    bool complete = false; ///< all particles were queries
    std::uint64_t checkedQueries = 0, truePairs = 0;
    std::uint64_t missing = 0, extra = 0; ///< where there are counts alone, differences of counts
    std::uint64_t duplicates = 0;         ///< listed more than once, or the query itself
    /// Of wrong pairs, those listed one way only; empty without rows, and where finding out would read more than 4 * 10^9 numbers.
    std::optional<std::uint64_t> asymmetric;
    double maxUlp = 0; ///< farthest wrong pair from the radius, in ulps of the radius (double)
    double countRmse = 0,
           countMax = 0; ///< neighbors; counts are scaled where candidates were left out on purpose
    std::optional<double> densityRmse, densityMax; ///< relative, of Truth::density; empty without rows

    std::uint64_t wrong() const { return missing + extra + duplicates; }
    double missingPerMillion() const { return perMillion(missing); }
    double extraPerMillion() const { return perMillion(extra + duplicates); }

private:
    double perMillion(std::uint64_t pairs) const
    {
        return truePairs > 0 ? 1e6 * static_cast<double>(pairs) / static_cast<double>(truePairs)
               : pairs > 0   ? 1e6
                             : 0;
    }
};

/// Ordered pairs that are not as the truth has them.
struct WrongPairs {
    std::uint64_t missing = 0, extra = 0; ///< where there are counts alone, differences of counts
    std::uint64_t duplicates = 0;         ///< listed more than once
    std::uint64_t checkedQueries = 0;

    std::uint64_t wrong() const { return missing + extra + duplicates; }
};

/// Of the truth of a search of sets, whose rows need not be symmetric.
/// @param asked not 0 for the queries that are looked at; empty: all that the truth has
WrongPairs findWrongPairs(const FoundNeighbors& found, const Truth& truth,
                          Span<const std::uint8_t> asked = {});

/// Reads every row of the truth's queries once, in parallel. A wrong pair costs the look-up of its mirror.
/// Distances of wrong pairs are exact near the radius, else rounded to double.
AccuracyReport checkAccuracy(const FoundNeighbors& found, const ParticleView& view, double radius,
                             const Truth& truth);

} // namespace vdb_nns::cli
