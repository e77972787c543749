// How accurate the estimators are, and what they cost: each against a full count, by blocks of 64^3 cells.
#pragma once

#include "vdb_nns/progress.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Expected against true neighbors of each particle, all particles alike. The RMSE of a fixed number is the standard deviation
/// of the true ones.
struct ParticleErrors {
    double bias = 0, rmse = 0;         ///< neighbors; of expected - true
    std::optional<double> correlation; ///< Pearson's; none where either is the same for all
};

/// Errors are (expected - true) / true of the pairs of a block. Blocks of fewer than 10^4 pairs are pooled in Morton order;
/// quantiles are weighted by true pairs.
struct EstimatorResult {
    std::string scene, estimator;
    double seconds = 0;       ///< median
    double searchSeconds = 0; ///< of a count of all, for comparison
    std::uint64_t blocks = 0, countedQueries = 0;
    double bias = 0;                         ///< of all pairs
    std::optional<ParticleErrors> particles; ///< none where single particles have no expectation
    double rmse = 0, p50 = 0, p99 = 0, most = 0;
    double overflowRate = 0;     ///< blocks whose lists pass what is reserved for them, by their pairs
    double reservedOverUsed = 0; ///< bytes of lists, all blocks
    double reservedBytes = 0, usedBytes = 0;
};

const std::vector<std::string>& estimatorNames();

/// Names from a list with commas, checked; none for an empty list, all for "all". paper:N takes N samples for each overlap of
/// cells, sampled:P counts P percent of the queries.
/// @throws InvalidInput
std::vector<std::string> parseEstimators(const std::string& list);

/// @throws Cancelled
std::vector<EstimatorResult> measureEstimators(const std::string& scene,
                                               const std::vector<std::string>& names, const SparseGrid& grid,
                                               std::uint64_t repeat, Progress* progress);

} // namespace vdb_nns::cli
