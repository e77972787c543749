// The truth of two sets: the parts of the independent search of `verify`, put together for rows instead of a
// comparison.
#include "bench/truth.h"

#include "machine.h"
#include "vdb_nns/error.h"
#include "verify/distance_order.h"
#include "verify/radius_classes.h"
#include "verify/row_finder.h"
#include "verify/search_clouds.h"
#include "verify/search_judge.h"

#include <algorithm>
#include <atomic>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kFirstSample = 64; // queries that tell whether all can be
constexpr std::uint64_t kSample = 1000;    // where not all can
constexpr double kMostPairs = 4e9;         // before the nearest are chosen: some ten seconds

SearchTerms termsOf(const SetSearch& search)
{
    SearchTerms terms;
    terms.queries = search.queries;
    terms.candidates = search.candidates;
    terms.radius = search.radius;
    terms.nearest = search.nearest;
    return terms;
}

// What finds rows of one search; immutable but for the progress.
class SetTruth {
public:
    SetTruth(const SetSearch& search, Progress* progress)
        : mTerms(termsOf(search)),
          mJudge(mTerms),
          mClouds(makeClouds(mJudge)),
          mBounds(candidateBounds(mJudge, mClouds)),
          mProgress(progress)
    {
    }

    std::uint64_t queryCount() const { return mJudge.queryCount(); }

    // Every query, by cells.
    Truth complete()
    {
        const RadiusClasses classes(mJudge, mClouds);
        std::vector<std::vector<std::uint32_t>> rows(queryCount());
        const RowFinder unused(mJudge, mClouds, mBounds);
        for (const RadiusClasses::Group& group : classes.groups()) {
            const CellHash& cells = *group.queries;
            tbb::parallel_for(tbb::blocked_range<std::size_t>(0, cells.size(), 64), [&](const auto& range) {
                RowFinder finder(unused);
                DistanceOrder order(mJudge);
                const std::size_t begin = cells.begin(range.begin()), end = cells.end(range.end() - 1);
                for (std::size_t at = begin; at < end; ++at) {
                    const std::uint32_t query = cells.numbers()[at];
                    rows[query] = finder.findByCells(query, group.candidates);
                    keepNearest(query, order, rows[query]);
                }
                count(end - begin, queryCount());
            });
        }
        Truth truth;
        truth.complete = true;
        for (std::uint32_t query = 0; query < rows.size(); ++query) append(query, rows[query], truth);
        return truth;
    }

    // Some queries, against all candidates.
    Truth sampled(std::uint64_t sample, std::uint64_t seed)
    {
        const std::vector<std::uint32_t> queries = drawQueries(queryCount(), sample, seed);
        std::vector<std::vector<std::uint32_t>> rows(queries.size());
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, queries.size(), 1), [&](const auto& range) {
            RowFinder finder(mJudge, mClouds, mBounds);
            DistanceOrder order(mJudge);
            for (std::size_t k = range.begin(); k < range.end(); ++k) {
                if (!mJudge.isQuery(queries[k])) continue;
                finder.findAmong(queries[k], 0, mClouds.candidates->x.size(), rows[k]);
                keepNearest(queries[k], order, rows[k]);
            }
            count(range.size(), queries.size());
        });
        Truth truth;
        truth.complete = queries.size() == queryCount();
        for (std::size_t k = 0; k < queries.size(); ++k) append(queries[k], rows[k], truth);
        return truth;
    }

    // Pairs of all queries before the nearest are chosen, from a few of them.
    double guessPairs(std::uint64_t seed)
    {
        const std::uint64_t kept = std::exchange(mTerms.nearest, 0);
        const Truth first = sampled(kFirstSample, seed);
        mTerms.nearest = kept;
        const double queries = static_cast<double>(std::max<std::size_t>(1, first.queries.size()));
        return static_cast<double>(first.pairs()) / queries * static_cast<double>(queryCount());
    }

private:
    void keepNearest(std::uint32_t query, DistanceOrder& order, std::vector<std::uint32_t>& row) const
    {
        if (mTerms.nearest > 0 && row.size() > mTerms.nearest) order.keepNearest(query, mTerms.nearest, row);
    }

    static void append(std::uint32_t query, const std::vector<std::uint32_t>& row, Truth& truth)
    {
        truth.queries.push_back(query);
        truth.neighbors.insert(truth.neighbors.end(), row.begin(), row.end());
        truth.begin.push_back(truth.neighbors.size());
    }

    void count(std::uint64_t done, std::uint64_t all)
    {
        if (!mProgress) return;
        const std::uint64_t sum = mDone += done;
        mProgress->update("truth", static_cast<double>(sum) / static_cast<double>(all));
        if (mProgress->cancelled()) throw Cancelled("bench: cancelled");
    }

    SearchTerms mTerms;
    SearchJudge mJudge;
    SearchClouds mClouds;
    std::vector<Bounds> mBounds;
    Progress* mProgress;
    std::atomic<std::uint64_t> mDone{0};
};

} // namespace

Truth findTruth(const SetSearch& search, const TruthOptions& options)
{
    if (options.sample && *options.sample == 0) return {};
    SetTruth truth(search, options.progress);
    if (options.sample) return truth.sampled(*options.sample, options.seed);
    if (truth.queryCount() > kSample) {
        const double pairs = truth.guessPairs(options.seed);
        const double bytes = 8 * pairs; // rows, and those in one array
        if (pairs > kMostPairs || bytes > 0.25 * static_cast<double>(machineMemoryBytes()))
            return truth.sampled(kSample, options.seed);
    }
    return truth.complete();
}

} // namespace vdb_nns::cli
