// Rows sorted in vectors, by every instruction set of this processor, against std::sort.
#include "cpu/kernels.h"
#include "vdb_nns/search.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <random>
#include <vector>

namespace vdb_nns {
namespace {

constexpr std::uint32_t kGuard = 0xABCDEF01u;

void expectSorted(SortRowFunction sort, const std::vector<std::uint32_t>& row)
{
    // The last entry of the row is the last one that may be read.
    std::vector<std::uint32_t> expected = row, out(row.size() + kSortOverrun + 1, kGuard),
                               scratch(sortScratchEntries(row.size()) + 1, kGuard);
    sort(row.data(), row.size(), out.data(), scratch.data());
    std::sort(expected.begin(), expected.end());
    EXPECT_TRUE(std::equal(expected.begin(), expected.end(), out.begin())) << row.size();
    EXPECT_EQ(out.back(), kGuard) << row.size();
    EXPECT_EQ(scratch.back(), kGuard) << row.size();
}

TEST(SortRow, SortsAsStdSortDoes)
{
    std::mt19937 random(1);
    for (int level = 0; level <= static_cast<int>(bestSimdLevel()); ++level) {
        SCOPED_TRACE(simdLevelName(static_cast<SimdLevel>(level)));
        const SortRowFunction sort = kernelsFor(static_cast<SimdLevel>(level)).sortRow;
        for (std::size_t size = 0; size < 5000; size += size < 300 ? 1 : 97) {
            std::vector<std::uint32_t> row(size);
            std::iota(row.begin(), row.end(),
                      0xFFFFFFFFu - static_cast<std::uint32_t>(size)); // to the largest number
            expectSorted(sort, row);
            std::rotate(row.begin(), row.begin() + static_cast<std::ptrdiff_t>(size / 3), row.end());
            expectSorted(sort, row);
            std::shuffle(row.begin(), row.end(), random);
            expectSorted(sort, row);
            std::sort(row.begin(), row.end(), std::greater<>());
            expectSorted(sort, row);
            for (std::uint32_t& number : row) number = random();
            expectSorted(sort, row);
        }
    }
}

// As rows are whose particles are numbered along space.
TEST(SortRow, SortsRowsOfAFewAscendingRuns)
{
    std::mt19937 random(2);
    for (int level = 0; level <= static_cast<int>(bestSimdLevel()); ++level) {
        SCOPED_TRACE(simdLevelName(static_cast<SimdLevel>(level)));
        const SortRowFunction sort = kernelsFor(static_cast<SimdLevel>(level)).sortRow;
        for (int k = 0; k < 4000; ++k) {
            std::vector<std::uint32_t> row;
            for (std::size_t runs = 1 + random() % 12; runs > 0; --runs) { // more than are merged, too
                std::vector<std::uint32_t> run(1 + random() % (k % 3 ? 40 : 700));
                for (std::uint32_t& number : run) number = random() % 2 ? random() : random() % 1000;
                std::sort(run.begin(), run.end());
                row.insert(row.end(), run.begin(), run.end());
            }
            for (std::uint32_t& number : row) number -= number == 0xFFFFFFFFu; // fills up
            expectSorted(sort, row);
        }
    }
}

} // namespace
} // namespace vdb_nns
