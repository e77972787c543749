// Whether what a method found in a stability trial is right.
#pragma once

#include "bench/found_neighbors.h"
#include "bench/stability/cases.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct TrialCheck {
    std::uint64_t missing = 0, extra = 0, duplicates = 0;
    std::optional<std::uint64_t> asymmetric;
    std::uint64_t wrongValues = 0; ///< of measures
    std::uint64_t pairSum =
        0; ///< equal for equal pairs (or counts, where there are no rows; or measures), whatever the order
    bool hasStrangers = false; ///< a row has a number that no particle has; nothing more is said then
    std::string message;

    std::uint64_t wrong() const { return missing + extra + duplicates + wrongValues; }
};

/// All rows and counts against the truth; where rows are known, all counts, and as many rows as take a second.
/// @param order number of each particle in the order that the sum is made in; empty: as they are
TrialCheck checkFound(const FoundNeighbors& found, const CaseParticles& particles,
                      const std::vector<std::uint32_t>& order);

} // namespace vdb_nns::cli
