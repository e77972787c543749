// The estimate: what each leaf of a grid will ask of a search, before the search. Plain data.
#pragma once

#include "vdb_nns/progress.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

/// How the pairs of a leaf are estimated.
enum class Estimator {
    /// Particles taken as uniform in each cell, the overlap of cells by quadrature; each part of the scene
    /// corrected by a small sample.
    kExpected,
    /// The paper's: the same without the correction, the overlap of cells by random samples.
    kMonteCarlo,
    /// A share of the queries counted exactly; the rest follow by the ratio of those to their expectation.
    kSampled,
    /// All queries counted: exact, at the cost of a search.
    kCounted,
    /// The same number of neighbors for every particle.
    kFixed,
    /// Rough and nearly free: 32 leaves stand for all, also for tests and masks. Tells whether everything
    /// fits at once.
    kProbed
};

struct EstimateOptions {
    Estimator estimator = Estimator::kExpected;
    /// Of the search, in world units, at most that of the grid's lattice; 0: the lattice's
    /// (SearchOptions::radius).
    double radius = 0;
    /// Share of the queries that kSampled counts. kExpected counts half as many groups, each of up to 8
    /// queries of one cell, but at least 512 groups.
    double sampleFraction = 0.03;
    std::uint64_t monteCarloSamples = 1'000'000; ///< kMonteCarlo: for each class of cell offsets
    double fixedNeighbors = 64;                  ///< kFixed: of each particle
    bool correctCrowding = true;                 ///< kExpected: correct by the sample
    std::uint64_t seed = 1;                      ///< kMonteCarlo
    Progress* progress = nullptr;
};

/// What the queries of a leaf, or of a range of leaves, ask for.
struct Work {
    std::uint64_t particles = 0;
    double expectedPairs = 0;
    /// Exact: pairs of a query and a particle in the cells within its reach, itself included.
    std::uint64_t candidateTests = 0;
    std::uint64_t maskBytes = 0; ///< exact: mask rows with their padding

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
    std::uint64_t countedQueries = 0; ///< queries that were counted exactly for this
    double correction = 1;            ///< counted over expected pairs of those; closer to 1 if they are few
    /// Share by which the pairs of a block may exceed their estimate, to be reserved for it. From the
    /// standard error of the ratios of the counted queries in the parts of the scene.
    double margin = 0;
    double seconds = 0;
};

/// Estimates the work of every leaf, in parallel.
/// Cost: one pass over the cells (kExpected, kMonteCarlo, kFixed); a search without lists (kCounted).
/// Source of the expectation: Kim et al., Out-of-Core Proximity Computation for Particle-based Fluid
/// Simulations (HPG 2014): E(C_q) = sum over cells C_i of n(C_i) D(C_q, C_i) / (V(C_q) V(C_i)), less the
/// query itself.
/// @throws InvalidInput for a fraction outside (0, 1], no samples, a negative number of neighbors, or a
///         radius above the lattice's
/// @throws Cancelled
WorkEstimate estimateWork(const SparseGrid& grid, const EstimateOptions& options = {});

/// Expected number of neighbors of each particle, by particle number: the E(C_q) of its cell, the same for
/// all particles of a cell; 0 for particles that are not finite. This is the model as it is, never corrected:
/// apart from rounding to float, its sum is that of estimateWork() without a correction. For judging the
/// model; a search needs only the sums.
/// Cost: one pass over the cells, in parallel, and 4 bytes a particle.
/// @param options `estimator`: kExpected for the overlap of cells by quadrature, kMonteCarlo for the overlap
///         by random samples
/// @throws InvalidInput for another estimator, and as estimateWork() does
/// @throws Cancelled
std::vector<float> expectNeighbors(const SparseGrid& grid, const EstimateOptions& options = {});

const char* estimatorName(Estimator estimator);

} // namespace vdb_nns
