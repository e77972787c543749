#include "bench/accuracy.h"

#include "numbers.h"
#include "vdb_nns/error.h"
#include "verify/exact_pair.h"
#include "verify/point_cells.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kMirrorChecks =
    200000; // a mirror costs the decoding of a list, and a cluster has 10^8 of them

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

// Distances of wrong pairs from the radius; non-finite points have none.
double largestUlp(std::uint32_t query, const std::vector<std::uint32_t>& wrong, const PairJudge& judge)
{
    double largest = 0;
    for (const std::uint32_t other : wrong) {
        const PairDistance pair =
            describeDistance(judge.point(query), judge.point(other), judge.linear(), judge.radius());
        if (std::isfinite(pair.ulps)) largest = std::max(largest, std::abs(pair.ulps));
    }
    return largest;
}

void compareLists(std::vector<std::uint32_t> listed, const std::vector<std::uint32_t>& truth,
                  std::uint32_t query, const PairJudge& judge, AccuracyReport& report)
{
    std::sort(listed.begin(), listed.end());
    std::vector<std::uint32_t> missing, extra;
    std::set_difference(truth.begin(), truth.end(), listed.begin(), listed.end(),
                        std::back_inserter(missing));
    std::set_difference(listed.begin(), listed.end(), truth.begin(), truth.end(), std::back_inserter(extra));
    report.missing += missing.size();
    report.extra += extra.size();
    report.maxUlp =
        std::max({report.maxUlp, largestUlp(query, missing, judge), largestUlp(query, extra, judge)});
}

std::uint64_t countAsymmetric(const NeighborLists& lists, std::uint32_t query,
                              const std::vector<std::uint32_t>& listed, std::uint64_t& budget)
{
    std::uint64_t asymmetric = 0;
    std::vector<std::uint32_t> mirror;
    for (const std::uint32_t other : listed) {
        if (budget == 0) break;
        --budget;
        lists.neighbors(other, mirror);
        asymmetric += std::find(mirror.begin(), mirror.end(), query) == mirror.end();
    }
    return asymmetric;
}

} // namespace

TrueNeighbors findTrueNeighbors(const ParticleView& view, double radius, std::uint64_t sample,
                                std::uint64_t seed, Progress* progress)
{
    TrueNeighbors truth;
    sample = std::min<std::uint64_t>(sample, view.size());
    if (sample == 0) return truth;
    for (std::uint64_t k = 0; k < sample; ++k) {
        // Every point once it is all of them, else a point of each of `sample` equal shares.
        const std::uint64_t low = view.size() * k / sample, high = view.size() * (k + 1) / sample;
        truth.queries.push_back(static_cast<std::uint32_t>(low + mix64(mix64(seed) + k) % (high - low)));
    }
    truth.neighbors.resize(truth.queries.size());
    const PointCloud cloud = makeCloud(view, radius);
    const PairJudge judge(view, radius);
    std::atomic<std::uint64_t> done{0};
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, truth.queries.size(), 1), [&](const auto& range) {
        for (std::size_t k = range.begin(); k < range.end(); ++k) {
            if (progress && progress->cancelled()) throw Cancelled("bench: cancelled");
            truth.neighbors[k] = neighborsOf(truth.queries[k], cloud, judge);
            if (progress)
                progress->update("check", static_cast<double>(++done) / static_cast<double>(sample));
        }
    });
    return truth;
}

AccuracyReport checkAccuracy(const NeighborLists& lists, const ParticleView& view, double radius,
                             const TrueNeighbors& truth)
{
    AccuracyReport report;
    report.checkedQueries = truth.queries.size();
    const bool hasLists = lists.encoding() != Encoding::kNone;
    if (hasLists) report.asymmetric = 0;
    const PairJudge judge(view, radius);
    std::uint64_t mirrorBudget = kMirrorChecks;
    std::vector<std::uint32_t> listed;
    for (std::size_t k = 0; k < truth.queries.size(); ++k) {
        const std::uint32_t query = truth.queries[k];
        const std::uint64_t expected = truth.neighbors[k].size(), counted = lists.count(query);
        if (!hasLists) {
            report.missing += expected > counted ? expected - counted : 0;
            report.extra += counted > expected ? counted - expected : 0;
            continue;
        }
        lists.neighbors(query, listed);
        compareLists(listed, truth.neighbors[k], query, judge, report);
        *report.asymmetric += countAsymmetric(lists, query, listed, mirrorBudget);
    }
    return report;
}

} // namespace vdb_nns::cli
