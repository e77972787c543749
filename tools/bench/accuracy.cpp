#include "bench/accuracy.h"

#include "verify/exact_pair.h"
#include "verify/point_cells.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <iterator>
#include <limits>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>
#include <vector>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kMostRead = 4'000'000'000; // numbers of mirror rows: some seconds

constexpr double kNear =
    1e-9; // relative: where a distance in double no longer tells how many ulps are between

// Sums over queries; merged over threads.
struct Sums {
    std::uint64_t missing = 0, extra = 0, duplicates = 0, asymmetric = 0;
    bool isSymmetryKnown = true;
    double maxUlp = 0, countSquares = 0, countMax = 0, densitySquares = 0, densityMax = 0;

    void merge(const Sums& other)
    {
        missing += other.missing;
        extra += other.extra;
        duplicates += other.duplicates;
        asymmetric += other.asymmetric;
        isSymmetryKnown = isSymmetryKnown && other.isSymmetryKnown;
        maxUlp = std::max(maxUlp, other.maxUlp);
        countSquares += other.countSquares;
        countMax = std::max(countMax, other.countMax);
        densitySquares += other.densitySquares;
        densityMax = std::max(densityMax, other.densityMax);
    }
};

// Checks rows one after the other; one a thread.
class Checker {
public:
    // `read` counts the numbers of mirror rows that all threads read.
    Checker(const FoundNeighbors& found, const ParticleView& view, double radius, const Truth& truth,
            std::atomic<std::uint64_t>& read)
        : mFound(found),
          mView(view),
          mRadius(radius),
          mTruth(truth),
          mJudge(view, radius),
          mRead(read),
          mUlp(std::nextafter(radius, std::numeric_limits<double>::infinity()) - radius)
    {
    }

    void check(std::size_t k)
    {
        const std::uint32_t query = mTruth.queries[k];
        const double counted = static_cast<double>(mFound.count(query)),
                     expected = static_cast<double>(mTruth.row(k).size());
        const double error = std::fabs(mFound.countScale() * counted - expected);
        mSums.countSquares += error * error;
        mSums.countMax = std::max(mSums.countMax, error);
        if (mFound.hasRows()) return checkRow(k, query);
        mSums.missing += static_cast<std::uint64_t>(std::max(0.0, expected - counted));
        mSums.extra += static_cast<std::uint64_t>(std::max(0.0, counted - expected));
    }

    const Sums& sums() const { return mSums; }

private:
    void checkRow(std::size_t k, std::uint32_t query)
    {
        mFound.row(query, mRow);
        std::sort(mRow.begin(), mRow.end());
        const auto last = std::unique(mRow.begin(), mRow.end());
        mSums.duplicates += static_cast<std::uint64_t>(mRow.end() - last);
        mRow.erase(last, mRow.end());
        const auto self = std::lower_bound(mRow.begin(), mRow.end(), query);
        if (self != mRow.end() && *self == query) {
            mRow.erase(self);
            ++mSums.duplicates;
        }
        const Span<const std::uint32_t> truth = mTruth.row(k);
        mMissing.clear();
        mExtra.clear();
        std::set_difference(truth.begin(), truth.end(), mRow.begin(), mRow.end(),
                            std::back_inserter(mMissing));
        std::set_difference(mRow.begin(), mRow.end(), truth.begin(), truth.end(), std::back_inserter(mExtra));
        mSums.missing += mMissing.size();
        mSums.extra += mExtra.size();
        // The truth is symmetric: a pair is listed one way only where one of the two ways is wrong.
        double density = mTruth.density[k] - 1;
        for (const std::uint32_t other : mMissing) density -= judgePair(query, other, true);
        for (const std::uint32_t other : mExtra) density += judgePair(query, other, false);
        const double error =
            std::fabs(mFound.countScale() * density + 1 - mTruth.density[k]) / mTruth.density[k];
        mSums.densitySquares += error * error;
        mSums.densityMax = std::max(mSums.densityMax, error);
    }

    // Of a wrong pair: symmetry, distance from the radius, weight in the density.
    double judgePair(std::uint32_t query, std::uint32_t other, bool isMissing)
    {
        if (other >= mView.size()) return 0; // no particle at all
        if (mRead < kMostRead) {
            mFound.row(other, mMirror);
            mRead += mMirror.size();
            const bool isMirrored = std::find(mMirror.begin(), mMirror.end(), query) != mMirror.end();
            mSums.asymmetric += isMirrored == isMissing;
        } else {
            mSums.isSymmetryKnown = false;
        }
        const double distance = mView.distance(query, other);
        if (!std::isfinite(distance)) return 0; // a non-finite particle has no distance
        double ulps = (distance - mRadius) / mUlp;
        if (std::fabs(distance - mRadius) <= kNear * mRadius) {
            ulps = describeDistance(mJudge.point(query), mJudge.point(other), mJudge.linear(), mRadius).ulps;
        }
        mSums.maxUlp = std::max(mSums.maxUlp, std::fabs(ulps));
        return densityWeight(distance, mRadius);
    }

    const FoundNeighbors& mFound;
    const ParticleView& mView;
    double mRadius;
    const Truth& mTruth;
    PairJudge mJudge;
    std::atomic<std::uint64_t>& mRead;
    double mUlp; // of the radius
    Sums mSums;
    std::vector<std::uint32_t> mRow, mMissing, mExtra, mMirror;
};

} // namespace

namespace {

void addWrong(const FoundNeighbors& found, std::uint32_t query, Span<const std::uint32_t> expected,
              std::vector<std::uint32_t>& row, WrongPairs& sum)
{
    ++sum.checkedQueries;
    if (found.hasRows()) {
        found.row(query, row);
        std::sort(row.begin(), row.end());
        const auto last = std::unique(row.begin(), row.end());
        sum.duplicates += static_cast<std::uint64_t>(row.end() - last);
        row.erase(last, row.end());
        std::uint64_t common = 0;
        auto next = row.begin();
        for (const std::uint32_t number : expected) {
            next = std::lower_bound(next, row.end(), number);
            common += next != row.end() && *next == number;
        }
        sum.missing += expected.size() - common;
        sum.extra += row.size() - common;
        return;
    }
    const std::uint64_t counted = found.count(query);
    sum.missing += expected.size() - std::min<std::uint64_t>(expected.size(), counted);
    sum.extra += counted - std::min<std::uint64_t>(expected.size(), counted);
}

} // namespace

WrongPairs findWrongPairs(const FoundNeighbors& found, const Truth& truth, Span<const std::uint8_t> asked)
{
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, truth.queries.size(), 256), WrongPairs{},
        [&](const auto& range, WrongPairs sum) {
            std::vector<std::uint32_t> row;
            for (std::size_t k = range.begin(); k < range.end(); ++k) {
                const std::uint32_t query = truth.queries[k];
                if (asked.empty() || asked[query] != 0) addWrong(found, query, truth.row(k), row, sum);
            }
            return sum;
        },
        [](WrongPairs a, const WrongPairs& b) {
            a.missing += b.missing;
            a.extra += b.extra;
            a.duplicates += b.duplicates;
            a.checkedQueries += b.checkedQueries;
            return a;
        });
}

AccuracyReport checkAccuracy(const FoundNeighbors& found, const ParticleView& view, double radius,
                             const Truth& truth)
{
    const std::size_t queries = truth.queries.size();
    std::atomic<std::uint64_t> read{0};
    const Sums sums = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, queries, 256), Sums(),
        [&](const auto& range, Sums sums) {
            Checker checker(found, view, radius, truth, read);
            for (std::size_t k = range.begin(); k < range.end(); ++k) checker.check(k);
            sums.merge(checker.sums());
            return sums;
        },
        [](Sums a, const Sums& b) {
            a.merge(b);
            return a;
        });
    AccuracyReport report;
    report.complete = truth.complete;
    report.checkedQueries = queries;
    report.truePairs = truth.pairs();
    report.missing = sums.missing;
    report.extra = sums.extra;
    report.duplicates = sums.duplicates;
    report.maxUlp = sums.maxUlp;
    const double count = static_cast<double>(std::max<std::size_t>(queries, 1));
    report.countRmse = std::sqrt(sums.countSquares / count);
    report.countMax = sums.countMax;
    if (!found.hasRows()) return report;
    if (sums.isSymmetryKnown) report.asymmetric = sums.asymmetric;
    report.densityRmse = std::sqrt(sums.densitySquares / count);
    report.densityMax = sums.densityMax;
    return report;
}

} // namespace vdb_nns::cli
