// A query and its neighbors as measures see them: differences and distances in world units, in long double from the stored
// coordinates.
#pragma once

#include "search_judge.h"
#include "symmetric_eigen.h"

#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

struct Near {
    std::uint32_t number; // of the candidate
    Vector3 offset;       // from the query to it
    Real distance;
    Real radius; // of the pair
    Real error;  // how far the distance, or a component, may be off where it is computed in doubles
};

struct Neighborhood {
    std::uint32_t query = 0;
    std::vector<Near> neighbors; // ascending by number
    std::vector<Near>
        all; // these and, where it is a candidate whose radius reaches somebody, the query: behind them
    bool isQuery = false; // it asks, and is finite
    Vector3 position{};   // world, of a finite query; and what it may be off by, as above
    Real positionError = 0;
};

// @param row the neighbors, ascending
Neighborhood neighborhoodOf(const SearchJudge& judge, std::uint32_t query,
                            const std::vector<std::uint32_t>& row);

} // namespace vdb_nns::cli
