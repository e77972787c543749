// List comparison for tests; see comparator.h.
#include "comparator.h"

#include <algorithm>
#include <limits>
#include <sstream>

namespace vdb_nns::testing {

namespace {

constexpr int kMaxExamples = 10;

class Mismatches {
public:
    explicit Mismatches(const PointSet& set) : mSet(set) { mText.precision(17); }

    void add(const char* kind, std::size_t i, std::uint32_t j)
    {
        if (++mCount > kMaxExamples) return;
        mText << "\n  " << kind << " pair (" << i << ", " << j << ")";
        if (j >= mSet.points.size()) {
            mText << ": no such particle";
            return;
        }
        const PairReport pair = describePair(mSet, i, j);
        mText << ": distance " << pair.distance << ", distance - radius = " << pair.ulps << " ulps";
    }

    ::testing::AssertionResult result() const
    {
        if (mCount == 0) return ::testing::AssertionSuccess();
        return ::testing::AssertionFailure()
               << mSet.name << ": " << mCount << " wrong pairs, radius " << mSet.radius << mText.str();
    }

private:
    const PointSet& mSet;
    std::ostringstream mText;
    std::uint64_t mCount = 0;
};

void compareRow(Mismatches& mismatches, std::size_t i, std::vector<std::uint32_t> actual,
                const std::vector<std::uint32_t>& expected)
{
    std::sort(actual.begin(), actual.end());
    auto a = actual.begin();
    auto e = expected.begin();
    while (a != actual.end() || e != expected.end()) {
        if (a != actual.begin() && a != actual.end() && *a == *(a - 1)) {
            mismatches.add("double", i, *a++);
        } else if (e == expected.end() || (a != actual.end() && *a < *e)) {
            mismatches.add("extra", i, *a++);
        } else if (a == actual.end() || *e < *a) {
            mismatches.add("missing", i, *e++);
        } else {
            ++a, ++e;
        }
    }
}

} // namespace

::testing::AssertionResult sameLists(const Lists& actual, const Lists& expected, const PointSet& set)
{
    if (actual.size() != expected.size()) {
        return ::testing::AssertionFailure()
               << set.name << ": " << actual.size() << " rows, expected " << expected.size();
    }
    Mismatches mismatches(set);
    for (std::size_t i = 0; i < actual.size(); ++i) compareRow(mismatches, i, actual[i], expected[i]);
    return mismatches.result();
}

::testing::AssertionResult sameLists(const NeighborLists& actual, const Lists& expected, const PointSet& set)
{
    return sameLists(decoded(actual), expected, set);
}

::testing::AssertionResult sameCounts(const std::vector<std::uint32_t>& actual, const Lists& expected)
{
    if (actual.size() != expected.size()) {
        return ::testing::AssertionFailure() << actual.size() << " counts, expected " << expected.size();
    }
    for (std::size_t i = 0; i < actual.size(); ++i) {
        if (actual[i] == expected[i].size()) continue;
        return ::testing::AssertionFailure()
               << "particle " << i << " has count " << actual[i] << ", expected " << expected[i].size();
    }
    return ::testing::AssertionSuccess();
}

Lists decoded(const NeighborLists& lists)
{
    Lists rows(lists.size());
    for (std::size_t i = 0; i < rows.size(); ++i) lists.neighbors(i, rows[i]);
    return rows;
}

} // namespace vdb_nns::testing
