// Makes the row that a query should have of the candidates within its radius, compares it with that of the file, and gathers
// what is wrong. Knows lists and exact distances, not how the neighbors were found.
#pragma once

#include "distance_order.h"
#include "independent_search.h"
#include "search_judge.h"

namespace vdb_nns::cli {

// What one task found; merged into the report. Copies are cheap while nothing is wrong.
class RowChecker {
public:
    RowChecker(const ListsFile& lists, const SearchJudge& judge, std::size_t maxExamples)
        : mLists(&lists), mJudge(&judge), mOrder(judge), mMaxExamples(maxExamples)
    {
    }

    // `within`: the candidates within the radius of `query`, ascending, itself left out; none of a point that is no query.
    void check(std::uint32_t query, const std::vector<std::uint32_t>& within);

    void merge(const RowChecker& other);
    void countExactPairs(std::uint64_t pairs) { mReport.exactPairs += pairs; }

    // With the distances of the examples filled in.
    VerifyReport finish() const;

private:
    void add(Fault fault, std::uint64_t query, std::int64_t neighbor, float fileValue = 0);
    bool mayListItself() const;
    // Makes mExpected.
    void expect(std::uint32_t query, const std::vector<std::uint32_t>& within);
    void checkOrder(std::uint32_t query);
    // True iff mListed is the expected row, whatever its order.
    bool compareRow(std::uint32_t query);
    void checkValues(std::uint32_t query);

    const ListsFile* mLists;
    const SearchJudge* mJudge;
    DistanceOrder mOrder;
    std::size_t mMaxExamples;
    VerifyReport mReport;
    std::vector<std::uint32_t> mExpected, mInOrder; // the row by number; and by distance where rows are
    std::vector<std::int64_t> mListed;              // a row as the file has it
    std::vector<float> mValues;                     // and its data
    std::vector<std::uint32_t> mRow;                // its numbers that candidates have, ascending
};

} // namespace vdb_nns::cli
