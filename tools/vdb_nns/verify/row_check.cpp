#include "row_check.h"

#include <algorithm>
#include <limits>
#include <unordered_map>

namespace vdb_nns::cli {

const char* faultName(Fault fault)
{
    static constexpr const char* kNames[kFaultKinds] = {
        "missing", "extra", "self", "duplicate", "unsorted", "out of range", "wrong distance"};
    return kNames[static_cast<std::size_t>(fault)];
}

std::uint64_t VerifyReport::faultCount() const
{
    std::uint64_t count = 0;
    for (const FaultFinding& finding : findings) count += finding.count;
    return count;
}

namespace {

bool before(const FaultExample& a, const FaultExample& b)
{
    return a.query != b.query ? a.query < b.query : a.neighbor < b.neighbor;
}

// Keeps the first `most` examples in order.
void keepExample(std::vector<FaultExample>& examples, const FaultExample& example, std::size_t most)
{
    if (examples.size() >= most && (most == 0 || !before(example, examples.back()))) return;
    examples.insert(std::upper_bound(examples.begin(), examples.end(), example, before), example);
    if (examples.size() > most) examples.pop_back();
}

} // namespace

void RowChecker::add(Fault fault, std::uint64_t query, std::int64_t neighbor, float fileValue)
{
    FaultFinding& finding = mReport.findings[static_cast<std::size_t>(fault)];
    ++finding.count;
    FaultExample example{query, neighbor};
    example.fileValue = fileValue;
    keepExample(finding.examples, example, mMaxExamples);
}

void RowChecker::check(std::uint32_t query, const std::vector<std::uint32_t>& within)
{
    expect(query, within);
    mLists->readRow(query, mListed, mValues);
    ++mReport.queries;
    mReport.listedPairs += mListed.size();
    mReport.expectedPairs += mExpected.size();
    checkOrder(query);
    if (!compareRow(query)) {
        // The values of true neighbors alone can be judged.
        std::size_t kept = 0;
        for (std::size_t k = 0; k < mListed.size(); ++k) {
            if (!std::binary_search(mExpected.begin(), mExpected.end(), mListed[k])) continue;
            mListed[kept] = mListed[k];
            mValues[kept++] = mValues[k];
        }
        mListed.resize(kept);
        mValues.resize(kept);
    }
    checkValues(query);
}

bool RowChecker::mayListItself() const
{
    return !mJudge->isOneSet() || mJudge->terms().includeSelf;
}

void RowChecker::expect(std::uint32_t query, const std::vector<std::uint32_t>& within)
{
    const SearchTerms& terms = mJudge->terms();
    mExpected = within;
    if (terms.nearest > 0) mOrder.keepNearest(query, terms.nearest, mExpected);
    if (terms.includeSelf && mJudge->isOneSet() && mJudge->isQuery(query) && mJudge->isCandidate(query))
        mExpected.insert(std::lower_bound(mExpected.begin(), mExpected.end(), query), query);
    if (!terms.byDistance) return;
    mInOrder = mExpected;
    mOrder.sort(query, mInOrder);
}

// By number any entry that is smaller than the one before it is out of order; by distance, of those that are expected, one
// that should stand before the last of them.
void RowChecker::checkOrder(std::uint32_t query)
{
    if (!mJudge->terms().byDistance) {
        for (std::size_t k = 1; k < mListed.size(); ++k) {
            if (mListed[k] < mListed[k - 1]) add(Fault::kUnsorted, query, mListed[k]);
        }
        return;
    }
    const bool isAsExpected = mListed.size() == mInOrder.size() &&
                              std::equal(mListed.begin(), mListed.end(), mInOrder.begin(),
                                         [](std::int64_t a, std::uint32_t b) { return a == b; });
    if (isAsExpected) return;
    std::unordered_map<std::int64_t, std::size_t> places;
    for (std::size_t k = 0; k < mInOrder.size(); ++k) places[mInOrder[k]] = k;
    std::size_t last = 0;
    for (const std::int64_t neighbor : mListed) {
        const auto found = places.find(neighbor);
        if (found == places.end()) continue;
        if (found->second < last) add(Fault::kUnsorted, query, neighbor);
        last = found->second;
    }
}

bool RowChecker::compareRow(std::uint32_t query)
{
    const std::vector<std::uint32_t>& expected = mExpected;
    mRow.clear();
    for (const std::int64_t neighbor : mListed) {
        if (neighbor < 0 || static_cast<std::uint64_t>(neighbor) >= mJudge->candidateCount()) {
            add(Fault::kOutOfRange, query, neighbor);
        } else if (neighbor == query && !mayListItself()) {
            add(Fault::kSelf, query, neighbor);
        } else {
            mRow.push_back(static_cast<std::uint32_t>(neighbor));
        }
    }
    if (!std::is_sorted(mRow.begin(), mRow.end())) std::sort(mRow.begin(), mRow.end());
    if (mRow == expected) return mRow.size() == mListed.size();
    auto wanted = expected.begin();
    for (std::size_t k = 0; k < mRow.size(); ++k) {
        const std::uint32_t listed = mRow[k];
        if (k > 0 && listed == mRow[k - 1]) {
            add(Fault::kDuplicate, query, listed);
            continue;
        }
        for (; wanted != expected.end() && *wanted < listed; ++wanted) add(Fault::kMissing, query, *wanted);
        if (wanted != expected.end() && *wanted == listed) {
            ++wanted;
        } else {
            add(Fault::kExtra, query, listed);
        }
    }
    for (; wanted != expected.end(); ++wanted) add(Fault::kMissing, query, *wanted);
    return false;
}

// The entries of mListed are true neighbors.
void RowChecker::checkValues(std::uint32_t query)
{
    if (!mLists->holdsDistances()) {
        for (std::size_t k = 0; k < mListed.size(); ++k) {
            if (mValues[k] != 1) add(Fault::kWrongDistance, query, mListed[k], mValues[k]);
        }
        return;
    }
    for (std::size_t k = 0; k < mListed.size(); ++k) {
        const Interval distance = mJudge->distance(query, static_cast<std::uint64_t>(mListed[k]));
        const bool right = mValues[k] >= static_cast<float>(distance.low) &&
                           mValues[k] <= static_cast<float>(distance.high); // a NaN is wrong
        if (!right) add(Fault::kWrongDistance, query, mListed[k], mValues[k]);
    }
}

void RowChecker::merge(const RowChecker& other)
{
    mReport.queries += other.mReport.queries;
    mReport.listedPairs += other.mReport.listedPairs;
    mReport.expectedPairs += other.mReport.expectedPairs;
    mReport.exactPairs += other.mReport.exactPairs;
    for (std::size_t kind = 0; kind < kFaultKinds; ++kind) {
        mReport.findings[kind].count += other.mReport.findings[kind].count;
        for (const FaultExample& example : other.mReport.findings[kind].examples) {
            keepExample(mReport.findings[kind].examples, example, mMaxExamples);
        }
    }
}

VerifyReport RowChecker::finish() const
{
    VerifyReport report = mReport;
    for (FaultFinding& finding : report.findings) {
        for (FaultExample& example : finding.examples) {
            example.distance = example.ulps = std::numeric_limits<double>::quiet_NaN();
            const auto neighbor = static_cast<std::uint64_t>(example.neighbor);
            if (example.neighbor < 0 || neighbor >= mJudge->candidateCount()) continue;
            if (!mJudge->isFiniteQuery(example.query) || !mJudge->isFiniteCandidate(neighbor)) continue;
            const PairDistance pair = mJudge->describe(example.query, neighbor);
            example.distance = pair.distance;
            example.ulps = pair.ulps;
        }
    }
    return report;
}

} // namespace vdb_nns::cli
