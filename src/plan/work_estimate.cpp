//
// One pass over the cells: each takes a weighted sum of the particles of the cells in its reach. That expectation is wrong
// where particles are not uniform in their cell: by a constant share in a regular fluid, by anything where they crowd. So a
// sample of the queries is counted, and corrects every part of the scene by its own ratio of counted to expected pairs.
//
// How the sample is drawn was chosen on the scenes of docs/workload.md, which has the figures:
//   * a few queries of one cell at a time: finding the candidates of one is what costs, and neighbors in a cell differ
//   * between parts by the root of their particles: in proportion the small parts are wrong, with equal numbers the large
//   * of as many places as a part needs on average, and fewer where they would cost more than a small share of the search
#include "vdb_nns/planning/work_estimate.h"

#include "cpu/kernels.h"
#include "cpu/leaves_in_reach-inl.h"
#include "cpu/search_task.h"
#include "grid/lattice.h"
#include "grid/sparse_grid_data.h"
#include "lists/cell_candidates.h"
#include "plan/occupancy_sample.h"
#include "plan/overlap_table.h"
#include "search/count_queries.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

namespace vdb_nns {

namespace {

// Queries of one cell that are counted together. More tell little: they have most of their candidates in common.
constexpr std::uint32_t kGroupSize = 8;
// A group tells about as much as two queries of different cells.
constexpr double kQueriesWorth = 2;
// Groups of each smallest part, on average, past which more tell little; and of all, so that small scenes have enough.
constexpr std::size_t kGroupsEachPart = 128, kFewestGroups = 512;
// Of a part's queries no more than this share begins a group.
constexpr double kMostOfPart = 0.25;
// A part's own ratio counts as much as its parent's when it has that many samples. Where particles crowd, the ratio of one
// sample varies about three times as much as those of parts.
constexpr double kPriorSamples = 8;
// Parts that have a ratio of their own: nodes of 2^k cells.
constexpr int kPartLog2Cells[] = {9, 7, 6};

double now()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void checkOptions(const EstimateOptions& options)
{
    requireKnown(options.estimator, Estimator::kProbed, "estimator");
    if (!(options.sampleFraction > 0 && options.sampleFraction <= 1)) {
        throw InvalidInput("a sample of " + std::to_string(options.sampleFraction) +
                           " of the queries is not possible: use a share above 0, at most 1");
    }
    if (options.monteCarloSamples == 0) {
        throw InvalidInput("an overlap of cells by 0 random samples is not possible: use 1 or more");
    }
    if (!(options.fixedNeighbors >= 0 && std::isfinite(options.fixedNeighbors))) {
        throw InvalidInput(std::to_string(options.fixedNeighbors) +
                           " neighbors for every particle is not possible: use 0 or more");
    }
}

// The node of 2^log2Cells cells that a leaf is in.
Vec3i nodeOf(const SparseGridData& grid, std::size_t leaf, int log2Cells)
{
    const Vec3i& o = grid.leafOrigins[leaf];
    return {o[0] >> log2Cells, o[1] >> log2Cells, o[2] >> log2Cells};
}

// First leaf of each smallest part, and the end. Leaves of a node stand together.
std::vector<std::size_t> partsOf(const SparseGridData& grid)
{
    std::vector<std::size_t> begin;
    for (std::size_t l = 0; l < grid.leafCount(); ++l) {
        if (l == 0 || nodeOf(grid, l, kPartLog2Cells[2]) != nodeOf(grid, l - 1, kPartLog2Cells[2]))
            begin.push_back(l);
    }
    begin.push_back(grid.leafCount());
    return begin;
}

// A slot that was drawn; the queries that are counted for it, and what the model expects of each of them.
struct Sample {
    std::uint32_t slot, part;
    double weight; // queries that it stands for
    QueryRange queries{};
    float expected = 0;
};

// Slots in ascending order, `share(particles)` of each smallest part. Spread evenly, but for a jitter that keeps them from
// falling in step with the rows of a lattice.
template <typename Share>
std::vector<Sample> drawSamples(const SparseGridData& grid, const std::vector<std::size_t>& parts,
                                const Share& share)
{
    std::vector<Sample> samples;
    for (std::size_t p = 0; p + 1 < parts.size(); ++p) {
        const std::uint32_t first = grid.leaves[parts[p]].firstSlot;
        const std::uint32_t particles = grid.leaves[parts[p + 1]].firstSlot - first;
        const double count = std::clamp(std::floor(share(particles)), 1.0, static_cast<double>(particles));
        const double stride = particles / count;
        for (std::uint32_t k = 0; k < static_cast<std::uint32_t>(count); ++k) {
            constexpr std::uint32_t kGolden = 0x9e3779b9u; // 2^32 / golden ratio: multiples spread evenly
            const double jitter = static_cast<std::uint32_t>(samples.size()) * kGolden * 0x1p-32;
            const auto slot = static_cast<std::uint32_t>((k + jitter) * stride);
            samples.push_back({first + std::min(slot, particles - 1), static_cast<std::uint32_t>(p), stride});
        }
    }
    return samples;
}

std::vector<Sample> drawSamples(const SparseGridData& grid, const std::vector<std::size_t>& parts,
                                const EstimateOptions& options)
{
    if (options.estimator == Estimator::kSampled) {
        return drawSamples(grid, parts,
                           [&](std::uint32_t particles) { return options.sampleFraction * particles; });
    }
    if (options.estimator != Estimator::kExpected || !options.correctCrowding) return {};
    double roots = 0;
    for (std::size_t p = 0; p + 1 < parts.size(); ++p)
        roots += std::sqrt(grid.leaves[parts[p + 1]].firstSlot - grid.leaves[parts[p]].firstSlot);
    const double groups = std::max(
        static_cast<double>(kFewestGroups),
        std::min(static_cast<double>(kGroupsEachPart * (parts.size() - 1)),
                 options.sampleFraction * static_cast<double>(grid.particleCount()) / kQueriesWorth));
    return drawSamples(grid, parts, [&](std::uint32_t particles) {
        return std::min(groups * std::sqrt(particles) / roots, kMostOfPart * particles);
    });
}

// The expectation, cell by cell.
class Model {
public:
    Model(const SparseGridData& grid, const OverlapTable& overlap) : mGrid(grid), mBlock(blockViewOf(grid))
    {
        const int reach = grid.reach();
        for (int x = -reach; x <= reach; ++x) {
            for (int y = -reach; y <= reach; ++y) {
                for (int z = -reach; z <= reach; ++z) {
                    mShares.push_back(static_cast<float>(overlap.share(x, y, z)));
                }
            }
        }
        mSelf = static_cast<float>(overlap.share(0, 0, 0));
    }

    // use(leaf, first slot, end slot, neighbors expected of each query, candidates of each) for every occupied cell of the
    // leaves from `begin` on, in order.
    template <typename Use>
    void forEachCell(std::size_t begin, std::size_t end, const Use& use) const
    {
        CellCounts cube;
        std::vector<LeafNeighborhood> neighborhoods(end - begin);
        mGrid.neighborhoodsInReach(begin, end, neighborhoods.data());
        const ExpectCellsFunction expectCells = kernelsFor(SimdLevel::kBest).expectCells;
        float expected[512];
        std::uint32_t candidates[512];
        for (std::size_t l = begin; l < end; ++l) {
            const auto leaf = static_cast<std::uint32_t>(l);
            expectCells(mBlock, leaf, neighborhoods[l - begin].leaf, mShares.data(), cube, expected,
                        candidates);
            const std::uint32_t* const cell = mGrid.cellStart.data() + mGrid.leaves[l].firstCell;
            const std::uint32_t cells = mGrid.leaves[l + 1].firstCell - mGrid.leaves[l].firstCell;
            for (std::uint32_t c = 0; c < cells; ++c) {
                const float neighbors = std::max(0.0f, expected[c] - mSelf); // a query is not its own
                use(leaf, cell[c], cell[c + 1], neighbors, candidates[c]);
            }
        }
    }

    // Sums the work of the leaves from `begin` on, and completes their samples, with `groupSize` queries each at most.
    void sum(std::size_t begin, std::size_t end, std::uint32_t groupSize, std::vector<Work>& leaves,
             std::vector<Sample>& samples) const
    {
        auto sample = std::lower_bound(samples.begin(), samples.end(), mGrid.leaves[begin].firstSlot,
                                       [](const Sample& s, std::uint32_t slot) { return s.slot < slot; });
        forEachCell(begin, end,
                    [&](std::uint32_t leaf, std::uint32_t firstSlot, std::uint32_t endSlot, float neighbors,
                        std::uint32_t candidates) {
                        const std::uint64_t queries = endSlot - firstSlot;
                        leaves[leaf] +=
                            {queries, static_cast<double>(queries) * static_cast<double>(neighbors),
                             queries * candidates,
                             queries * ((std::uint64_t(candidates) + 31) / 32) * sizeof(std::uint32_t)};
                        for (; sample != samples.end() && sample->slot < endSlot; ++sample) {
                            const std::uint32_t last = std::max(endSlot, groupSize) - groupSize;
                            const std::uint32_t first = std::max(firstSlot, std::min(sample->slot, last));
                            sample->queries = {leaf, first, first + std::min(groupSize, endSlot - first)};
                            sample->expected = neighbors;
                        }
                    });
    }

private:
    const SparseGridData& mGrid;
    BlockView mBlock;
    std::vector<float> mShares;
    float mSelf = 0;
};

// Counted and expected pairs of some samples.
struct Ratio {
    double counted = 0, expected = 0, samples = 0;

    Ratio& operator+=(const Ratio& other)
    {
        counted += other.counted;
        expected += other.expected;
        samples += other.samples;
        return *this;
    }
};

// Shrinks a ratio towards `parent`, which counts as much as kPriorSamples samples.
double shrunk(const Ratio& own, double parent)
{
    if (own.expected <= 0) return parent;
    const double prior = kPriorSamples * own.expected / own.samples;
    return (own.counted + prior * parent) / (own.expected + prior);
}

// What each sample was counted to have: the mean of its queries. Adds the queries to `countedQueries`.
std::vector<double> countSamples(const SparseGridData& grid, double radius,
                                 const std::vector<Sample>& samples, const CancelCheck& cancel,
                                 std::uint64_t& countedQueries)
{
    std::vector<QueryRange> ranges;
    ranges.reserve(samples.size());
    for (const Sample& sample : samples) ranges.push_back(sample.queries);
    const std::vector<std::uint32_t> counts = countQueries(grid, radius, ranges, cancel);
    countedQueries += counts.size();
    std::vector<double> means;
    means.reserve(samples.size());
    auto count = counts.begin();
    for (const QueryRange& range : ranges) {
        const std::uint32_t queries = range.endSlot - range.firstSlot;
        means.push_back(std::accumulate(count, count + queries, 0.0) / queries);
        count += queries;
    }
    return means;
}

// Counts the samples and corrects every part by the ratio of its own, as far as it has any, and else by that of the part
// around it.
void correctParts(const SparseGridData& grid, const std::vector<std::size_t>& parts,
                  const std::vector<Sample>& samples, const CancelCheck& cancel, WorkEstimate& estimate)
{
    const std::vector<double> counted =
        countSamples(grid, estimate.radius, samples, cancel, estimate.countedQueries);
    const std::size_t partCount = parts.size() - 1;
    std::vector<Ratio> own(partCount);
    Ratio all;
    for (std::size_t k = 0; k < samples.size(); ++k) {
        const double weight = samples[k].weight;
        own[samples[k].part] += {weight * counted[k], weight * static_cast<double>(samples[k].expected), 1};
    }
    for (const Ratio& part : own) all += part;
    estimate.correction = shrunk(all, 1);
    std::vector<double> ratio(partCount, estimate.correction);
    for (const int log2Cells : kPartLog2Cells) {
        for (std::size_t first = 0, end; first < partCount; first = end) {
            Ratio node;
            const Vec3i origin = nodeOf(grid, parts[first], log2Cells);
            for (end = first; end < partCount && nodeOf(grid, parts[end], log2Cells) == origin; ++end)
                node += own[end];
            std::fill(ratio.begin() + static_cast<std::ptrdiff_t>(first),
                      ratio.begin() + static_cast<std::ptrdiff_t>(end), shrunk(node, ratio[first]));
        }
    }
    double variance = 0; // of the parts' pairs, by the scatter of their samples
    for (std::size_t k = 0; k < samples.size(); ++k) {
        const std::uint32_t part = samples[k].part;
        const double rest = counted[k] - ratio[part] * static_cast<double>(samples[k].expected);
        variance += std::pow(samples[k].weight * rest, 2) / std::max(own[part].counted, 1.0);
    }
    for (std::size_t p = 0; p < partCount; ++p) {
        for (std::size_t l = parts[p]; l < parts[p + 1]; ++l) estimate.leaves[l].expectedPairs *= ratio[p];
    }
    estimate.corrected = true;
    estimate.margin = all.counted > 0 ? std::sqrt(variance / all.counted) : 1;
}

OverlapTable overlapOf(const SparseGridData& grid, const EstimateOptions& options, const CancelCheck& cancel)
{
    const double radiusCells = radiusInCells(grid.lattice, searchRadius(grid.lattice, options.radius));
    return options.estimator == Estimator::kMonteCarlo
               ? OverlapTable::byMonteCarlo(radiusCells, grid.reach(), options.monteCarloSamples,
                                            options.seed, cancel)
               : OverlapTable::byQuadrature(radiusCells, grid.reach());
}

void countAll(const SparseGrid& grid, Progress* progress, WorkEstimate& estimate)
{
    SearchOptions options;
    options.encoding = Encoding::kNone;
    options.radius = estimate.radius;
    options.progress = progress;
    const std::vector<std::uint32_t> counts = SearchEngine().search(grid, options).counts();
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    const std::vector<LeafRecord>& leaves = grid.data().leaves;
    tbb::parallel_for(std::size_t(0), estimate.leaves.size(), [&](std::size_t l) {
        std::uint64_t pairs = 0;
        for (std::uint32_t s = leaves[l].firstSlot; s < leaves[l + 1].firstSlot; ++s)
            pairs += counts[numbers[s]];
        estimate.leaves[l].expectedPairs = static_cast<double>(pairs);
    });
    estimate.countedQueries = grid.particleCount();
}

WorkEstimate estimateLeaves(const SparseGrid& sparseGrid, const EstimateOptions& options)
{
    const double start = now();
    const SparseGridData& grid = sparseGrid.data();
    const CancelCheck cancel(options.progress, "estimate");
    WorkEstimate estimate;
    estimate.estimator = options.estimator;
    estimate.radius = searchRadius(grid.lattice, options.radius);
    estimate.leaves.resize(grid.leafCount());
    if (grid.particleCount() == 0) return estimate;
    const auto finish = [&] {
        for (const Work& leaf : estimate.leaves) estimate.total += leaf;
        estimate.seconds = now() - start;
        return std::move(estimate);
    };
    if (options.estimator == Estimator::kProbed) {
        probeWork(grid, estimate.radius, estimate);
        return finish();
    }

    const std::vector<std::size_t> parts = partsOf(grid);
    std::vector<Sample> samples = drawSamples(grid, parts, options);
    const Model model(grid, overlapOf(grid, options, cancel));
    const std::uint32_t groupSize = options.estimator == Estimator::kExpected ? kGroupSize : 1;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, estimate.leaves.size(), 64), [&](const auto& range) {
        cancel.check();
        model.sum(range.begin(), range.end(), groupSize, estimate.leaves, samples);
    });

    switch (options.estimator) {
    case Estimator::kExpected:
    case Estimator::kSampled:
        if (!samples.empty()) correctParts(grid, parts, samples, cancel, estimate);
        break;
    case Estimator::kCounted:
        countAll(sparseGrid, options.progress, estimate);
        break;
    case Estimator::kFixed:
        for (Work& leaf : estimate.leaves) {
            leaf.expectedPairs = static_cast<double>(leaf.particles) * options.fixedNeighbors;
        }
        break;
    case Estimator::kMonteCarlo:
    case Estimator::kProbed:
        break;
    }
    return finish();
}

} // namespace

WorkEstimate estimateWork(const SparseGrid& grid, const EstimateOptions& options)
{
    checkOptions(options);
    return isolatedIeee([&] { return estimateLeaves(grid, options); });
}

std::vector<float> expectNeighbors(const SparseGrid& sparseGrid, const EstimateOptions& options)
{
    checkOptions(options);
    if (options.estimator != Estimator::kExpected && options.estimator != Estimator::kMonteCarlo) {
        throw InvalidInput(std::string("the estimator ") + estimatorName(options.estimator) +
                           " has no expectation of each particle: use expected or montecarlo");
    }
    const SparseGridData& grid = sparseGrid.data();
    const CancelCheck cancel(options.progress, "estimate");
    std::vector<float> neighborsOf(sparseGrid.view().size(), 0.0f);
    if (grid.particleCount() == 0) return neighborsOf;

    const Model model(grid, overlapOf(grid, options, cancel));
    const Span<const std::uint32_t> numbers = sparseGrid.particleNumbers();
    const auto leaves = tbb::blocked_range<std::size_t>(0, grid.leafCount(), 64);
    isolatedIeee([&] {
        tbb::parallel_for(leaves, [&](const auto& range) {
            cancel.check();
            model.forEachCell(range.begin(), range.end(),
                              [&](std::uint32_t, std::uint32_t firstSlot, std::uint32_t endSlot,
                                  float neighbors, std::uint32_t) {
                                  for (std::uint32_t s = firstSlot; s < endSlot; ++s)
                                      neighborsOf[numbers[s]] = neighbors;
                              });
        });
    });
    return neighborsOf;
}

const char* estimatorName(Estimator estimator)
{
    switch (estimator) {
    case Estimator::kExpected:
        return "expected";
    case Estimator::kMonteCarlo:
        return "montecarlo";
    case Estimator::kSampled:
        return "sampled";
    case Estimator::kCounted:
        return "counted";
    case Estimator::kProbed:
        return "probed";
    case Estimator::kFixed:
        break;
    }
    return "fixed";
}

} // namespace vdb_nns
