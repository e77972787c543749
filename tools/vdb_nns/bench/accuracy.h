// Is a method right? Its lists against the independent search that `verify` uses, at sampled queries.
#pragma once

#include "bench/bench_report.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

/// Queries and the neighbors that they have by definition, ascending.
struct TrueNeighbors {
    std::vector<std::uint32_t> queries;
    std::vector<std::vector<std::uint32_t>> neighbors;
};

/// Draws up to `sample` different queries and tests each against all points, in double and exact arithmetic.
/// @throws Cancelled
TrueNeighbors findTrueNeighbors(const ParticleView& view, double radius, std::uint64_t sample,
                                std::uint64_t seed, Progress* progress);

/// Checks the lists of a method, or its counts where there are no lists.
AccuracyReport checkAccuracy(const NeighborLists& lists, const ParticleView& view, double radius,
                             const TrueNeighbors& truth);

} // namespace vdb_nns::cli
