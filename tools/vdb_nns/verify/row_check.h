// Compares one row of the file with the neighbors it should have, and gathers what is wrong. Knows lists and exact
// distances, not how the neighbors were found.
#pragma once

#include "independent_search.h"
#include "point_cells.h"

namespace vdb_nns::cli {

// What one task found; merged into the report. Copies are cheap while nothing is wrong.
class RowChecker {
public:
    RowChecker(const ListsFile& lists, const PairJudge& judge, std::uint64_t pointCount,
               std::size_t maxExamples)
        : mLists(&lists), mJudge(&judge), mPointCount(pointCount), mMaxExamples(maxExamples)
    {
    }

    // `expected`: the neighbors of `query`, ascending.
    void check(std::uint32_t query, const std::vector<std::uint32_t>& expected);

    void merge(const RowChecker& other);
    void countExactPairs(std::uint64_t pairs) { mReport.exactPairs += pairs; }

    // With the distances of the examples filled in.
    VerifyReport finish() const;

private:
    void add(Fault fault, std::uint64_t query, std::int64_t neighbor, float fileValue = 0);
    // True iff mListed is the expected row, whatever its order.
    bool compareRow(std::uint32_t query, const std::vector<std::uint32_t>& expected);
    void checkValues(std::uint32_t query);

    const ListsFile* mLists;
    const PairJudge* mJudge;
    std::uint64_t mPointCount;
    std::size_t mMaxExamples;
    VerifyReport mReport;
    std::vector<std::int64_t> mListed; // a row as the file has it
    std::vector<float> mValues;        // and its data
    std::vector<std::uint32_t> mRow;   // its numbers that other particles have, ascending
};

} // namespace vdb_nns::cli
