// Clusters of points by definition: connected components of the pairs, or DBSCAN (Ester, Kriegel, Sander, Xu 1996).
#pragma once

#include "search_judge.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

struct ClusterLabels {
    std::vector<std::int64_t> labels; // by particle number; -1: of none
    std::vector<std::int64_t> sizes;  // points of the particle's cluster; 0: of none
};

// Of one set without groups and without a bound on the neighbors of each. A pair counts whichever way it goes. With
// `minNeighbors`, points with so many neighbors are cores; another point goes with the smallest core that is its neighbor or has
// it as one. Labels are the ranks of the clusters by their smallest core; without `minNeighbors`, by their smallest point.
// @param from, to the part of the progress, which may be null
ClusterLabels findClusters(const SearchJudge& judge, const std::optional<std::uint32_t>& minNeighbors,
                           Progress* progress, double from, double to);

} // namespace vdb_nns::cli
