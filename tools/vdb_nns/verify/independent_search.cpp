#include "independent_search.h"

#include "cell_rows.h"
#include "point_cells.h"
#include "row_check.h"
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

void checkArguments(const ParticleView& view, double radius, const ListsFile& lists)
{
    if (!(radius > 0 && std::isfinite(radius)))
        throw InvalidInput("verify: the radius must be positive and finite");
    if (lists.rowCount() == view.size()) return;
    throw InputError(lists.path() + ": has " + std::to_string(lists.rowCount()) + " rows, but there are " +
                     std::to_string(view.size()) + " points; are these the lists of this file?");
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

RowChecker checkAll(const PointCloud& cloud, const PairJudge& judge, const RowChecker& empty,
                    RowCounter& counter)
{
    const CellHash cells(cloud);
    const auto merge = [](RowChecker a, const RowChecker& b) {
        a.merge(b);
        return a;
    };
    RowChecker result = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, cells.size(), 64), empty,
        [&](const tbb::blocked_range<std::size_t>& range, RowChecker checker) {
            CellRows rows(cloud, cells, judge);
            for (std::size_t cell = range.begin(); cell < range.end(); ++cell) {
                rows.run(cell, [&checker](std::uint32_t query, const std::vector<std::uint32_t>& found) {
                    checker.check(query, found);
                });
            }
            checker.countExactPairs(rows.exactPairs());
            counter.done(cells.end(range.end() - 1) - cells.begin(range.begin()));
            return checker;
        },
        merge);
    // Rows of points that are not finite must be empty.
    for (std::size_t i = 0; i < cloud.x.size(); ++i) {
        if (std::isnan(cloud.x[i])) result.check(static_cast<std::uint32_t>(i), {});
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

// Appends the neighbors of `query` among the points [begin, end) to `found`.
void searchTile(const PointCloud& cloud, const PairJudge& judge, std::uint32_t query, std::size_t begin,
                std::size_t end, std::vector<std::uint32_t>& found, RowChecker& checker)
{
    constexpr std::size_t kPart = 256;
    double squares[kPart];
    for (std::size_t part = begin; part < end; part += kPart) {
        const std::size_t count = std::min(kPart, end - part);
        squaredDistances(&cloud.x[part], &cloud.y[part], &cloud.z[part], count, cloud.x[query],
                         cloud.y[query], cloud.z[query], squares);
        int candidates = 0;
        for (std::size_t k = 0; k < count; ++k)
            candidates += squares[k] <= cloud.sureBeyond; // NaN: not finite
        if (candidates == 0) continue;
        for (std::size_t k = 0; k < count; ++k) {
            const auto number = static_cast<std::uint32_t>(part + k);
            if (!(squares[k] <= cloud.sureBeyond) || number == query) continue;
            if (squares[k] > cloud.sureWithin) {
                checker.countExactPairs(1);
                if (!judge.within(query, number)) continue;
            }
            found.push_back(number);
        }
    }
}

// The neighbors of a few queries, by a pass over all points in tiles that stay in the cache.
std::vector<std::vector<std::uint32_t>> searchAll(const PointCloud& cloud, const PairJudge& judge,
                                                  const std::uint32_t* queries, std::size_t count,
                                                  RowChecker& checker)
{
    constexpr std::size_t kTile = 4096;
    std::vector<std::vector<std::uint32_t>> found(count);
    for (std::size_t tile = 0; tile < cloud.x.size(); tile += kTile) {
        const std::size_t end = std::min(cloud.x.size(), tile + kTile);
        for (std::size_t q = 0; q < count; ++q) {
            searchTile(cloud, judge, queries[q], tile, end, found[q], checker);
        }
    }
    return found;
}

RowChecker checkSample(const PointCloud& cloud, const PairJudge& judge, const RowChecker& empty,
                       const std::vector<std::uint32_t>& sample, RowCounter& counter)
{
    constexpr std::size_t kGroup = 8; // queries a pass over the points
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, (sample.size() + kGroup - 1) / kGroup, 1), empty,
        [&](const tbb::blocked_range<std::size_t>& range, RowChecker checker) {
            for (std::size_t group = range.begin(); group < range.end(); ++group) {
                const std::uint32_t* queries = sample.data() + group * kGroup;
                const std::size_t count = std::min(kGroup, sample.size() - group * kGroup);
                const auto found = searchAll(cloud, judge, queries, count, checker);
                for (std::size_t q = 0; q < count; ++q) checker.check(queries[q], found[q]);
                counter.done(count);
            }
            return checker;
        },
        [](RowChecker a, const RowChecker& b) {
            a.merge(b);
            return a;
        });
}

} // namespace

VerifyReport verifyLists(const ParticleView& view, double radius, const ListsFile& lists,
                         const VerifyOptions& options, Progress* progress)
{
    checkArguments(view, radius, lists);
    const PointCloud cloud = makeCloud(view, radius);
    const PairJudge judge(view, radius);
    const RowChecker empty(lists, judge, view.size(), options.maxExamples);
    if (!options.sample) {
        RowCounter counter(view.size(), progress);
        return checkAll(cloud, judge, empty, counter).finish();
    }
    const auto sample =
        drawSample(view.size(), std::min<std::uint64_t>(*options.sample, view.size()), options.seed);
    RowCounter counter(sample.size(), progress);
    return checkSample(cloud, judge, empty, sample, counter).finish();
}

} // namespace vdb_nns::cli
