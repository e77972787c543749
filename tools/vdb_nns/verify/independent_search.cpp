#include "independent_search.h"

#include "radius_classes.h"
#include "row_check.h"
#include "row_finder.h"
#include "search_clouds.h"
#include "throw_if_cancelled.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <unordered_set>

namespace vdb_nns::cli {

namespace {

void checkRadii(Span<const double> radii, std::size_t count)
{
    if (radii.size() != count)
        throw InvalidInput("verify: " + std::to_string(radii.size()) + " radii for " + std::to_string(count) +
                           " particles");
}

void checkArguments(const SearchTerms& terms, const ListsFile& lists)
{
    const Radius& radius = terms.radius;
    const std::size_t rows = terms.queries.view.size(), columns = terms.candidates.view.size();
    if (radius.isOne()) {
        if (!(radius.value > 0 && std::isfinite(radius.value)))
            throw InvalidInput("verify: the radius must be positive and finite");
    } else {
        if (radius.mode != RadiusMode::kScatter) checkRadii(radius.ofQueries, rows);
        if (radius.mode != RadiusMode::kGather) checkRadii(radius.ofCandidates, columns);
    }
    const std::string end = "; are these the lists of this file?";
    if (lists.rowCount() != rows) {
        throw InputError(lists.path() + ": has " + std::to_string(lists.rowCount()) +
                         " rows, but there are " + std::to_string(rows) +
                         (terms.isOneSet() ? " points" : " queries") + end);
    }
    if (lists.columnCount() != columns) {
        throw InputError(lists.path() + ": has " + std::to_string(lists.columnCount()) +
                         " columns, but there are " + std::to_string(columns) + " points" + end);
    }
}

// Counts rows from many threads for the progress and asks whether to stop.
class RowCounter {
public:
    RowCounter(std::uint64_t total, Progress* progress) : mTotal(total), mProgress(progress) {}

    void done(std::uint64_t rows)
    {
        if (!mProgress) return;
        const std::uint64_t all = mDone += rows;
        mProgress->update("verify", static_cast<double>(all) / static_cast<double>(mTotal));
        throwIfCancelled(mProgress);
    }

private:
    std::uint64_t mTotal;
    Progress* mProgress;
    std::atomic<std::uint64_t> mDone{0};
};

// ---- all rows, by cells -------------------------------------------------------------------------------------------

RowChecker merged(RowChecker a, const RowChecker& b)
{
    a.merge(b);
    return a;
}

// Checks the rows of a group; marks them in `done`, a byte a query.
RowChecker checkGroup(const RadiusClasses::Group& group, const RowFinder& empty, const RowChecker& none,
                      RowCounter& counter, std::vector<std::uint8_t>& done)
{
    const CellHash& cells = *group.queries;
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, cells.size(), 64), none,
        [&](const tbb::blocked_range<std::size_t>& range, RowChecker checker) {
            RowFinder finder(empty);
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

RowChecker checkAll(const SearchJudge& judge, const SearchClouds& clouds, const RowFinder& finder,
                    const RowChecker& empty, RowCounter& counter)
{
    const RadiusClasses classes(judge, clouds);
    std::vector<std::uint8_t> done(judge.queryCount());
    RowChecker result = empty;
    for (const RadiusClasses::Group& group : classes.groups())
        result.merge(checkGroup(group, finder, empty, counter, done));
    // Those that are no queries, and those that reach nobody.
    for (std::size_t i = 0; i < done.size(); ++i) {
        if (!done[i]) result.check(static_cast<std::uint32_t>(i), {});
    }
    return result;
}

// ---- a sample, against all points ---------------------------------------------------------------------------------

// `count` different numbers below `size`, drawn by SplitMix64 from the seed; ascending.
std::vector<std::uint32_t> drawSample(std::uint64_t size, std::uint64_t count, std::uint64_t seed)
{
    std::unordered_set<std::uint32_t> drawn;
    std::uint64_t state = seed;
    // Floyd's method (Bentley, Programming Pearls): each subset is equally likely.
    for (std::uint64_t last = size - count; last < size; ++last) {
        std::uint64_t z = (state += 0x9e3779b97f4a7c15ULL);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
        const auto number = static_cast<std::uint32_t>((z ^ (z >> 31)) % (last + 1));
        if (!drawn.insert(number).second) drawn.insert(static_cast<std::uint32_t>(last));
    }
    std::vector<std::uint32_t> sample(drawn.begin(), drawn.end());
    std::sort(sample.begin(), sample.end());
    return sample;
}

// The neighbors of a few queries, by a pass over all candidates in tiles that stay in the cache.
std::vector<std::vector<std::uint32_t>> searchAll(const SearchClouds& clouds, RowFinder& finder,
                                                  const std::uint32_t* queries, std::size_t count)
{
    constexpr std::size_t kTile = 4096;
    const std::size_t size = clouds.candidates->x.size();
    std::vector<std::vector<std::uint32_t>> found(count);
    for (std::size_t tile = 0; tile < size; tile += kTile) {
        const std::size_t end = std::min(size, tile + kTile);
        for (std::size_t q = 0; q < count; ++q) finder.findAmong(queries[q], tile, end, found[q]);
    }
    return found;
}

RowChecker checkSample(const SearchClouds& clouds, const RowFinder& unused, const RowChecker& empty,
                       const std::vector<std::uint32_t>& sample, RowCounter& counter)
{
    constexpr std::size_t kGroup = 8; // queries a pass over the points
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, (sample.size() + kGroup - 1) / kGroup, 1), empty,
        [&](const tbb::blocked_range<std::size_t>& range, RowChecker checker) {
            RowFinder finder(unused);
            for (std::size_t group = range.begin(); group < range.end(); ++group) {
                const std::uint32_t* queries = sample.data() + group * kGroup;
                const std::size_t count = std::min(kGroup, sample.size() - group * kGroup);
                const auto found = searchAll(clouds, finder, queries, count);
                for (std::size_t q = 0; q < count; ++q) checker.check(queries[q], found[q]);
                counter.done(count);
            }
            checker.countExactPairs(finder.exactPairs());
            return checker;
        },
        merged);
}

} // namespace

VerifyReport verifyLists(const SearchTerms& terms, const ListsFile& lists, const VerifyOptions& options,
                         Progress* progress)
{
    checkArguments(terms, lists);
    const SearchJudge judge(terms);
    const SearchClouds clouds = makeClouds(judge);
    const std::vector<Bounds> bounds = candidateBounds(judge, clouds);
    const RowFinder finder(judge, clouds, bounds);
    const RowChecker empty(lists, judge, options.maxExamples);
    const std::uint64_t rows = judge.queryCount();
    if (!options.sample) {
        RowCounter counter(rows, progress);
        return checkAll(judge, clouds, finder, empty, counter).finish();
    }
    const auto sample = drawSample(rows, std::min<std::uint64_t>(*options.sample, rows), options.seed);
    RowCounter counter(sample.size(), progress);
    return checkSample(clouds, finder, empty, sample, counter).finish();
}

VerifyReport verifyLists(const ParticleView& view, double radius, const ListsFile& lists,
                         const VerifyOptions& options, Progress* progress)
{
    SearchTerms terms;
    terms.queries = terms.candidates = view;
    terms.radius = radius;
    return verifyLists(terms, lists, options, progress);
}

} // namespace vdb_nns::cli
