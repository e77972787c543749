// A pass over the rows that queries have by definition: all of them by cells, or a sample against all points. What is done with
// them is a checker's, of which each task has a copy.
#pragma once

#include "radius_classes.h"
#include "row_finder.h"
#include "search_clouds.h"
#include "search_judge.h"
#include "vdb_nns/progress.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

// Which rows: `count` seeded queries, or all.
struct RowSample {
    std::optional<std::uint64_t> count;
    std::uint64_t seed = 1;
};

// Where a pass stands in the whole of a check.
struct PassProgress {
    Progress* progress = nullptr; // may be null
    double from = 0, to = 1;
};

// @throws InvalidInput for a radius of all pairs that is not positive and finite, and for radii that are not as many as the
//         particles
void checkRadius(const SearchTerms& terms);

// `count` different numbers below `size`, drawn from the seed; ascending.
std::vector<std::uint32_t> drawSample(std::uint64_t size, std::uint64_t count, std::uint64_t seed);

// The neighbors of a few queries, by a pass over all candidates.
std::vector<std::vector<std::uint32_t>> searchAll(const SearchClouds& clouds, RowFinder& finder,
                                                  const std::uint32_t* queries, std::size_t count);

// Counts rows from many threads for the progress and asks whether to stop.
class RowCounter {
public:
    RowCounter(std::uint64_t total, const PassProgress& progress) : mTotal(total), mProgress(progress) {}

    void done(std::uint64_t rows);

private:
    std::uint64_t mTotal;
    PassProgress mProgress;
    std::atomic<std::uint64_t> mDone{0};
};

// Checker has
//   void check(std::uint32_t query, const std::vector<std::uint32_t>& within)
//     of each query once: the candidates within its radius, ascending, itself left out; none of a point that is no query
//   void merge(const Checker& other)
//   void countExactPairs(std::uint64_t pairs)
// and is cheap to copy while nothing is wrong.
template <typename Checker>
class RowPass {
public:
    // `empty`: a checker that has seen nothing.
    RowPass(const SearchJudge& judge, const Checker& empty)
        : mJudge(judge),
          mEmpty(empty),
          mClouds(makeClouds(judge)),
          mBounds(candidateBounds(judge, mClouds)),
          mFinder(judge, mClouds, mBounds)
    {
    }

    Checker run(const RowSample& sample, const PassProgress& progress) const
    {
        const std::uint64_t rows = mJudge.queryCount();
        if (!sample.count) {
            RowCounter counter(rows, progress);
            return checkAll(counter);
        }
        const auto queries = drawSample(rows, std::min<std::uint64_t>(*sample.count, rows), sample.seed);
        RowCounter counter(queries.size(), progress);
        return checkSample(queries, counter);
    }

private:
    static Checker merged(Checker a, const Checker& b)
    {
        a.merge(b);
        return a;
    }

    // Checks the rows of a group; marks them in `done`, a byte a query.
    Checker checkGroup(const RadiusClasses::Group& group, RowCounter& counter,
                       std::vector<std::uint8_t>& done) const
    {
        const CellHash& cells = *group.queries;
        return tbb::parallel_reduce(
            tbb::blocked_range<std::size_t>(0, cells.size(), 64), mEmpty,
            [&](const tbb::blocked_range<std::size_t>& range, Checker checker) {
                RowFinder finder(mFinder);
                const std::size_t begin = cells.begin(range.begin()), end = cells.end(range.end() - 1);
                for (std::size_t at = begin; at < end; ++at) {
                    const std::uint32_t query = cells.numbers()[at];
                    checker.check(query, finder.findByCells(query, group.candidates));
                    done[query] = 1;
                }
                checker.countExactPairs(finder.exactPairs());
                counter.done(end - begin);
                return checker;
            },
            merged);
    }

    Checker checkAll(RowCounter& counter) const
    {
        const RadiusClasses classes(mJudge, mClouds);
        std::vector<std::uint8_t> done(mJudge.queryCount());
        Checker result = mEmpty;
        for (const RadiusClasses::Group& group : classes.groups())
            result.merge(checkGroup(group, counter, done));
        // Those that are no queries, and those that reach nobody.
        for (std::size_t i = 0; i < done.size(); ++i) {
            if (!done[i]) result.check(static_cast<std::uint32_t>(i), {});
        }
        return result;
    }

    Checker checkSample(const std::vector<std::uint32_t>& sample, RowCounter& counter) const
    {
        constexpr std::size_t kGroup = 8; // queries a pass over the points
        return tbb::parallel_reduce(
            tbb::blocked_range<std::size_t>(0, (sample.size() + kGroup - 1) / kGroup, 1), mEmpty,
            [&](const tbb::blocked_range<std::size_t>& range, Checker checker) {
                RowFinder finder(mFinder);
                for (std::size_t group = range.begin(); group < range.end(); ++group) {
                    const std::uint32_t* queries = sample.data() + group * kGroup;
                    const std::size_t count = std::min(kGroup, sample.size() - group * kGroup);
                    const auto found = searchAll(mClouds, finder, queries, count);
                    for (std::size_t q = 0; q < count; ++q) checker.check(queries[q], found[q]);
                    counter.done(count);
                }
                checker.countExactPairs(finder.exactPairs());
                return checker;
            },
            merged);
    }

    const SearchJudge& mJudge;
    Checker mEmpty;
    SearchClouds mClouds;
    std::vector<Bounds> mBounds;
    RowFinder mFinder;
};

} // namespace vdb_nns::cli
