#include "row_check.h"

#include <algorithm>
#include <cmath>
#include <limits>

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

bool isFinite(const StoredPoint& point)
{
    return std::isfinite(point.offset[0]) && std::isfinite(point.offset[1]) && std::isfinite(point.offset[2]);
}

struct Interval {
    double low, high;
};

// Encloses the world distance. With u = 2^-53: a difference of offsets errs by u of itself, adding the integer difference
// of voxels by u of the sum, product and sums by 4 u of the terms, squares, sums and root by 4 u of the result, so that
// 16 u of all terms is more than enough; the last term covers denormal steps.
Interval distanceInterval(const StoredPoint& a, const StoredPoint& b, const Matrix3& m)
{
    double component[3] = {0, 0, 0}, terms = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto voxels = static_cast<double>(b.voxel[c] - a.voxel[c]);
        const double offset = b.offset[c] - a.offset[c];
        for (std::size_t k = 0; k < 3; ++k) {
            component[k] += m[k][c] * (voxels + offset);
            terms += std::fabs(m[k][c]) * (std::fabs(voxels + offset) + std::fabs(offset));
        }
    }
    const double distance = std::hypot(component[0], component[1], component[2]);
    const double error = 16 * 0x1p-53 * terms + 0x1p-1068;
    return {std::max(0.0, distance - error), distance + error};
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

void RowChecker::check(std::uint32_t query, const std::vector<std::uint32_t>& expected)
{
    mLists->readRow(query, mListed, mValues);
    ++mReport.queries;
    mReport.listedPairs += mListed.size();
    mReport.expectedPairs += expected.size();
    if (!compareRow(query, expected)) {
        // The values of true neighbors alone can be judged.
        std::size_t kept = 0;
        for (std::size_t k = 0; k < mListed.size(); ++k) {
            if (!std::binary_search(expected.begin(), expected.end(), mListed[k])) continue;
            mListed[kept] = mListed[k];
            mValues[kept++] = mValues[k];
        }
        mListed.resize(kept);
        mValues.resize(kept);
    }
    checkValues(query);
}

bool RowChecker::compareRow(std::uint32_t query, const std::vector<std::uint32_t>& expected)
{
    mRow.clear();
    bool sorted = true;
    for (std::size_t k = 0; k < mListed.size(); ++k) {
        const std::int64_t neighbor = mListed[k];
        if (k > 0 && neighbor < mListed[k - 1]) {
            add(Fault::kUnsorted, query, neighbor);
            sorted = false;
        }
        if (neighbor < 0 || static_cast<std::uint64_t>(neighbor) >= mPointCount) {
            add(Fault::kOutOfRange, query, neighbor);
        } else if (neighbor == query) {
            add(Fault::kSelf, query, neighbor);
        } else {
            mRow.push_back(static_cast<std::uint32_t>(neighbor));
        }
    }
    if (!sorted) std::sort(mRow.begin(), mRow.end());
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
    if (mListed.empty()) return;
    const StoredPoint point = mJudge->point(query);
    for (std::size_t k = 0; k < mListed.size(); ++k) {
        const StoredPoint other = mJudge->point(static_cast<std::uint64_t>(mListed[k]));
        const Interval distance = distanceInterval(point, other, mJudge->linear());
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
            if (example.neighbor < 0 || neighbor >= mPointCount) continue;
            const StoredPoint a = mJudge->point(example.query), b = mJudge->point(neighbor);
            if (!isFinite(a) || !isFinite(b)) continue;
            const PairDistance pair = describeDistance(a, b, mJudge->linear(), mJudge->radius());
            example.distance = pair.distance;
            example.ulps = pair.ulps;
        }
    }
    return report;
}

} // namespace vdb_nns::cli
