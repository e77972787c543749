// The positions of both sets of a search in doubles about one place, with a certified bound of their error, and the bounds
// between which doubles cannot decide. Shares nothing with the engine.
#pragma once

#include "search_judge.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns::cli {

// World positions about a common reference, in units of a power of two near the largest cell edge. Points that are not
// finite or do not have the role are NaN, whose comparisons are all false.
struct SearchCloud {
    std::vector<double> x, y, z;        // by particle number
    std::vector<std::uint32_t> numbers; // of the others, ascending
};

// Squared distances of computed positions up to `within` are within a radius, those above `beyond` are not.
struct Bounds {
    double within = -1, beyond = -1;
};

struct SearchClouds {
    std::shared_ptr<SearchCloud> queries, candidates; // one where all have both roles
    double error = 0;                                 // each coordinate is within this of the true one
    double largestRadius = 0;                         // 0: nobody reaches anybody
    double cap = 0;                                   // world units: no two points are as far apart
    int scale = 0; // a length in world units times 2^scale is one of the cloud

    // A radius of any size in units of the cloud; one beyond the cap decides as the cap does. 0 for those that reach nobody.
    double scaled(double radius) const;
    // Of a radius in world units.
    Bounds bounds(double radius) const;
    // Of cells whose points have no neighbor beyond the adjacent ones, for radii (of the cloud) up to this.
    double cellEdge(double scaledRadius) const;
};

// @throws InputError when positions are too large for double arithmetic
SearchClouds makeClouds(const SearchJudge& judge);

} // namespace vdb_nns::cli
