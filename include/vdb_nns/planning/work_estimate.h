// The estimate: what each leaf of a grid asks of a search, before the search. Plain data.
#pragma once

#include "vdb_nns/progress.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

/// How the pairs of a leaf are estimated.
enum class Estimator {
    kExpected, ///< particles uniform in each cell, overlap of cells by quadrature; each part corrected by a small sample
    kMonteCarlo, ///< the paper's: the same without the correction, overlap of cells by random samples
    kSampled,    ///< a share of the queries counted exactly, the rest by their ratio to the expectation
    kCounted,    ///< all queries counted: exact, at the price of a search
    kFixed,      ///< the same number of neighbors for every particle
    kProbed ///< rough and nearly free: 32 leaves stand for all, tests and masks included; for asking whether all fits at once
};

struct EstimateOptions {
    Estimator estimator = Estimator::kExpected;
    /// Of the search, in world units, at most that of the grid's lattice; 0: the lattice's (SearchOptions::radius).
    double radius = 0;
    /// Of the queries, for kSampled. kExpected counts half as many groups of up to 8 queries of a cell at most, but 512 of them.
    double sampleFraction = 0.03;
    std::uint64_t monteCarloSamples = 1'000'000; ///< of each class of cell offsets; kMonteCarlo
    double fixedNeighbors = 64;                  ///< of each particle; kFixed
    bool correctCrowding = true;                 ///< kExpected: by the sample
    std::uint64_t seed = 1;                      ///< kMonteCarlo
    Progress* progress = nullptr;
};

/// What the queries of a leaf, or of a range of leaves, ask for.
struct Work {
    std::uint64_t particles = 0;
    double expectedPairs = 0;
    std::uint64_t candidateTests =
        0; ///< exact: pairs of a query and a particle of the cells in reach, itself included
    std::uint64_t maskBytes = 0; ///< exact: mask rows, padded

    Work& operator+=(const Work& other)
    {
        particles += other.particles;
        expectedPairs += other.expectedPairs;
        candidateTests += other.candidateTests;
        maskBytes += other.maskBytes;
        return *this;
    }
};

struct WorkEstimate {
    Estimator estimator = Estimator::kExpected;
    double radius =
        0; ///< of the search that it is for, in world units; tests and masks follow from the lattice alone
    std::vector<Work> leaves; ///< by leaf of the grid
    Work total;
    bool corrected = false;           ///< the expectation was corrected by a sample
    std::uint64_t countedQueries = 0; ///< counted exactly for it
    double correction = 1; ///< counted over expected pairs of those, shrunk towards 1 where they are few
    /// Share by which the pairs of a block may pass their estimate: what to reserve for it, from the standard error of the
    /// counted queries' ratios in the parts of the scene.
    double margin = 0;
    double seconds = 0;
};

/// Estimates the work of every leaf, in parallel.
/// Cost: one pass over the cells (kExpected, kMonteCarlo, kFixed); a search without lists (kCounted).
/// Source of the expectation: Kim et al., Out-of-Core Proximity Computation for Particle-based Fluid Simulations (HPG 2014):
/// E(C_q) = sum over cells C_i of n(C_i) D(C_q, C_i) / (V(C_q) V(C_i)), less the query itself.
/// @throws InvalidInput for a fraction outside (0, 1], no samples, a negative number of neighbors, or a radius above the
///         lattice's
/// @throws Cancelled
WorkEstimate estimateWork(const SparseGrid& grid, const EstimateOptions& options = {});

/// Expected number of neighbors of each particle, by particle number: E(C_q) of its cell, the same for all particles of a
/// cell; 0 for particles that are not finite. Never corrected, so it is the model as it is; its sum is that of estimateWork()
/// without a correction, but for rounding to float. For judging the model: a search needs only the sums.
/// Cost: one pass over the cells, 4 bytes a particle. In parallel.
/// @param options `estimator`: kExpected for the overlap of cells by quadrature, kMonteCarlo for that by random samples
/// @throws InvalidInput for another estimator, and as estimateWork() does
/// @throws Cancelled
std::vector<float> expectNeighbors(const SparseGrid& grid, const EstimateOptions& options = {});

const char* estimatorName(Estimator estimator);

} // namespace vdb_nns
