// The work of some leaves, counted from their cells, and its mean for all.
#include "plan/occupancy_sample.h"

#include "grid/lattice.h"
#include "lists/cell_candidates.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kProbes = 32;

// `share`: of the particles of the cells in reach, those that are neighbors.
Work workOf(const SparseGridData& grid, double share, std::uint32_t leaf)
{
    LeafNeighborhood neighborhood;
    grid.topology.neighborhoods({&grid.leafOrigins[leaf], 1}, &neighborhood);
    Work work;
    forEachOccupiedCell(blockViewOf(grid), leaf, neighborhood, [&](const OccupiedCell& cell) {
        const std::uint64_t queries = cell.end - cell.begin, tests = queries * cell.candidates;
        work += {queries, share * static_cast<double>(tests), tests,
                 queries * cell.rowWords() * sizeof(std::uint32_t)};
    });
    return work;
}

} // namespace

void probeWork(const SparseGridData& grid, double radius, WorkEstimate& estimate)
{
    // As of the volume of those cells.
    constexpr double kBall = 4.18879020478639098;
    const double share = kBall * std::pow(radiusInCells(grid.lattice, radius) / (2 * grid.reach() + 1), 3);
    const std::size_t particles = grid.particleCount(), count = std::min(particles, kProbes);
    std::vector<Work> probes(count);
    tbb::parallel_for(std::size_t(0), count, [&](std::size_t k) {
        const auto slot = static_cast<std::uint32_t>((2 * k + 1) * particles / (2 * count));
        const auto next =
            std::upper_bound(grid.leaves.begin(), grid.leaves.end(), slot,
                             [](std::uint32_t s, const LeafRecord& leaf) { return s < leaf.firstSlot; });
        probes[k] = workOf(grid, share, static_cast<std::uint32_t>(next - grid.leaves.begin() - 1));
    });
    const auto mean = [&](auto&& value) {
        double sum = 0;
        for (const Work& probe : probes)
            sum += static_cast<double>(value(probe)) / static_cast<double>(probe.particles);
        return sum / static_cast<double>(count);
    };
    const double pairs = mean([](const Work& work) { return work.expectedPairs; });
    const double tests = mean([](const Work& work) { return work.candidateTests; });
    const double masks = mean([](const Work& work) { return work.maskBytes; });
    for (std::size_t l = 0; l < grid.leafCount(); ++l) {
        const std::uint64_t own = grid.leaves[l + 1].firstSlot - grid.leaves[l].firstSlot;
        const double n = static_cast<double>(own);
        estimate.leaves[l] = {own, n * pairs, static_cast<std::uint64_t>(std::llround(n * tests)),
                              static_cast<std::uint64_t>(std::llround(n * masks))};
    }
    estimate.margin = 1;
}

} // namespace vdb_nns
