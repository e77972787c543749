#include "bench/truth.h"

#include "machine.h"
#include "numbers.h"
#include "vdb_nns/error.h"
#include "verify/cell_rows.h"
#include "verify/point_cells.h"

#include <algorithm>
#include <atomic>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kFirstSample = 64; // queries that tell whether all can be
constexpr std::uint64_t kSample = 1000;    // where not all can
constexpr double kMostTests = 4e10;        // of all queries against 27 cells: ten seconds or so of two cores
constexpr double kCandidatesPerRow = 6.5; // 27 cells of the radius hold (27 / (4 pi / 3)) times the neighbors

// Reports how many queries are done, from many threads.
class QueryCounter {
public:
    // `share` is what they are of all that is to be done.
    QueryCounter(std::uint64_t total, Progress* progress, double share)
        : mTotal(static_cast<double>(total) / share), mProgress(progress)
    {
    }

    void done(std::uint64_t queries)
    {
        if (!mProgress) return;
        const std::uint64_t all = mDone += queries;
        mProgress->update("truth", static_cast<double>(all) / mTotal);
        if (mProgress->cancelled()) throw Cancelled("bench: cancelled");
    }

private:
    double mTotal;
    Progress* mProgress;
    std::atomic<std::uint64_t> mDone{0};
};

using Rows = std::vector<std::vector<std::uint32_t>>;

void appendRows(const Rows& rows, Truth& truth)
{
    std::uint64_t pairs = 0;
    for (const std::vector<std::uint32_t>& row : rows) pairs += row.size();
    truth.neighbors.reserve(pairs);
    for (const std::vector<std::uint32_t>& row : rows) {
        truth.neighbors.insert(truth.neighbors.end(), row.begin(), row.end());
        truth.begin.push_back(truth.neighbors.size());
    }
}

double densityOf(std::uint32_t query, Span<const std::uint32_t> row, const ParticleView& view, double radius)
{
    double sum = 1;
    for (const std::uint32_t other : row) sum += densityWeight(view.distance(query, other), radius);
    return sum;
}

void setDensities(const ParticleView& view, double radius, Truth& truth)
{
    truth.density.resize(truth.queries.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, truth.queries.size(), 256), [&](const auto& range) {
        for (std::size_t k = range.begin(); k < range.end(); ++k)
            truth.density[k] = densityOf(truth.queries[k], truth.row(k), view, radius);
    });
}

std::vector<std::uint32_t> neighborsOf(std::uint32_t query, const PointCloud& cloud, const PairJudge& judge)
{
    std::vector<std::uint32_t> found;
    const double x = cloud.x[query], y = cloud.y[query], z = cloud.z[query];
    for (std::size_t j = 0; j < cloud.x.size(); ++j) {
        const double dx = cloud.x[j] - x, dy = cloud.y[j] - y, dz = cloud.z[j] - z;
        const double square = dx * dx + dy * dy + dz * dz;
        if (!(square <= cloud.sureBeyond) || j == query) continue; // a NaN is a point that is not finite
        const auto number = static_cast<std::uint32_t>(j);
        if (square <= cloud.sureWithin || judge.within(query, number)) found.push_back(number);
    }
    return found;
}

// `share`: see QueryCounter.
Truth sampleTruth(const PointCloud& cloud, const PairJudge& judge, std::uint64_t sample,
                  const TruthOptions& options, double share)
{
    Truth truth;
    const std::uint64_t size = cloud.x.size();
    sample = std::min<std::uint64_t>(sample, size);
    truth.complete = sample == size;
    truth.queries = drawQueries(size, sample, options.seed);
    Rows rows(sample);
    QueryCounter counter(sample, options.progress, share);
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, sample, 1), [&](const auto& range) {
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
            rows[k] = neighborsOf(truth.queries[k], cloud, judge);
            counter.done(1);
        }
    });
    appendRows(rows, truth);
    return truth;
}

// Rows go straight to their place: one pass counts, one fills. Nothing where they are more than a quarter of the memory, which
// the first may have missed.
std::optional<Truth> completeTruth(const PointCloud& cloud, const PairJudge& judge,
                                   const TruthOptions& options)
{
    Truth truth;
    truth.complete = true;
    const std::size_t size = cloud.x.size();
    truth.queries.resize(size);
    for (std::size_t i = 0; i < size; ++i) truth.queries[i] = static_cast<std::uint32_t>(i);
    truth.begin.assign(size + 1, 0);
    const CellHash cells(cloud);
    QueryCounter counter(2 * size, options.progress, 1);
    const auto forRows = [&](auto&& onRow) {
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, cells.size(), 64), [&](const auto& range) {
            CellRows rows(cloud, cells, judge);
            for (std::size_t cell = range.begin(); cell < range.end(); ++cell) rows.run(cell, onRow);
            counter.done(cells.end(range.end() - 1) - cells.begin(range.begin()));
        });
    };
    forRows([&](std::uint32_t query, const auto& row) { truth.begin[query + 1] = row.size(); });
    for (std::size_t i = 0; i < size; ++i) truth.begin[i + 1] += truth.begin[i];
    if (truth.begin[size] * sizeof(std::uint32_t) > machineMemoryBytes() / 4) return std::nullopt;
    truth.neighbors.resize(truth.begin[size]);
    forRows([&](std::uint32_t query, const auto& row) {
        std::copy(row.begin(), row.end(),
                  truth.neighbors.begin() + static_cast<std::ptrdiff_t>(truth.begin[query]));
    });
    return truth;
}

// From a few queries: what all would take.
bool allAreFew(const PointCloud& cloud, const PairJudge& judge, const TruthOptions& options)
{
    const auto size = static_cast<double>(cloud.x.size());
    if (cloud.x.size() <= kSample) return true;
    const Truth first = sampleTruth(cloud, judge, kFirstSample, options, 0.02);
    const double pairs = static_cast<double>(first.pairs()) / static_cast<double>(kFirstSample) * size;
    return kCandidatesPerRow * (pairs + size) <= kMostTests &&
           4 * pairs + 8 * size <= 0.25 * static_cast<double>(machineMemoryBytes());
}

} // namespace

std::vector<std::uint32_t> drawQueries(std::uint64_t size, std::uint64_t sample, std::uint64_t seed)
{
    sample = std::min(sample, size);
    std::vector<std::uint32_t> queries;
    for (std::uint64_t k = 0; k < sample; ++k) {
        const std::uint64_t low = size * k / sample, high = size * (k + 1) / sample;
        queries.push_back(static_cast<std::uint32_t>(low + mix64(mix64(seed) + k) % (high - low)));
    }
    return queries;
}

Truth findTruth(const ParticleView& view, double radius, const TruthOptions& options)
{
    if (options.sample && *options.sample == 0) return {};
    const PointCloud cloud = makeCloud(view, radius);
    const PairJudge judge(view, radius);
    std::optional<Truth> complete;
    if (!options.sample && allAreFew(cloud, judge, options)) complete = completeTruth(cloud, judge, options);
    Truth truth = complete ? std::move(*complete)
                           : sampleTruth(cloud, judge, options.sample.value_or(kSample), options, 1);
    setDensities(view, radius, truth);
    return truth;
}

} // namespace vdb_nns::cli
