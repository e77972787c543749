// The engine against the exact oracle, on every distribution, form of input, cell size, instruction set and encoding, and
// under every way to read the result. The order of lists is checked as well as their contents. And the invariances: order
// of the input, number of threads, symmetry.
#include "agreement/point_views.h"
#include "support/comparator.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <mutex>
#include <set>
#include <string>

namespace vdb_nns::testing {

namespace {

struct Case {
    PointSet set;
    Form form;
};

const std::vector<Case>& cases()
{
    static const std::vector<Case> kCases = [] {
        std::vector<Case> all;
        for (const PointSet& set : arraySets(Precision::kFloat)) {
            all.push_back({roundedToFloats(set), Form::kFloats});
            all.push_back({roundedToFloats(set), Form::kFloatColumns});
        }
        for (const PointSet& set : arraySets(Precision::kDouble, 2)) {
            all.push_back({set, Form::kDoubles});
            all.push_back({set, Form::kStridedDoubles});
            all.push_back({set, Form::kDoubleColumns});
        }
        for (const PointSet& set : gridSets(3)) all.push_back({set, Form::kVoxels});
        return all;
    }();
    return kCases;
}

std::string caseName(const ::testing::TestParamInfo<std::size_t>& info)
{
    const Case& c = cases()[info.param];
    std::string name = nameOf(c.form);
    for (const char letter : " " + c.set.name) {
        name += std::isalnum(static_cast<unsigned char>(letter)) ? letter : '_';
    }
    return name;
}

class Agreement : public ::testing::TestWithParam<std::size_t> {
protected:
    const PointSet& set() const { return cases()[GetParam()].set; }
    SetView input() const { return SetView(set(), cases()[GetParam()].form); }
};

std::uint64_t mixOfPair(std::uint64_t pair)
{
    pair = (pair ^ (pair >> 30)) * 0xbf58476d1ce4e5b9ULL;
    pair = (pair ^ (pair >> 27)) * 0x94d049bb133111ebULL;
    return pair ^ (pair >> 31);
}

std::uint64_t checksumOf(const Lists& lists)
{
    std::uint64_t sum = 0;
    for (std::size_t i = 0; i < lists.size(); ++i) {
        for (const std::uint32_t j : lists[i]) sum += mixOfPair(std::uint64_t(i) << 32 | j);
    }
    return sum;
}

// Every way to read lists tells the same, in the same order.
void expectReadersAgree(const NeighborLists& lists, const Lists& inOrder, const Lists& oracle)
{
    std::mutex mutex;
    Lists visited(lists.size());
    std::vector<int> visits(lists.size());
    lists.visitRows([&](std::uint32_t query, Span<const std::uint32_t> row) {
        const std::lock_guard<std::mutex> lock(mutex);
        visited.at(query).assign(row.begin(), row.end());
        ++visits.at(query);
    });
    EXPECT_EQ(visited, inOrder);
    const Csr csr = lists.toCsr();
    ASSERT_EQ(csr.offsets.size(), lists.size() + 1);
    ASSERT_EQ(csr.offsets.back(), csr.indices.size());
    std::uint64_t pairs = 0;
    for (std::size_t i = 0; i < lists.size(); ++i) {
        EXPECT_LE(visits[i], 1);
        std::vector<std::uint32_t> each;
        lists.forEachNeighbor(i, [&](std::uint32_t j) { each.push_back(j); });
        EXPECT_EQ(each, inOrder[i]);
        EXPECT_EQ(std::vector<std::uint32_t>(csr.indices.begin() + static_cast<long>(csr.offsets[i]),
                                             csr.indices.begin() + static_cast<long>(csr.offsets[i + 1])),
                  oracle[i]);
        EXPECT_EQ(lists.count(i), oracle[i].size());
        pairs += oracle[i].size();
    }
    EXPECT_EQ(lists.pairCount(), pairs);
    EXPECT_EQ(lists.checksum(), checksumOf(oracle));
}

// Cells ascend lexicographically, and numbers inside a cell.
void expectCellOrder(const Lists& lists, const std::vector<Vec3i>& cells)
{
    for (const std::vector<std::uint32_t>& row : lists) {
        for (std::size_t k = 1; k < row.size(); ++k) {
            const auto a = std::make_pair(cells[row[k - 1]], row[k - 1]);
            const auto b = std::make_pair(cells[row[k]], row[k]);
            ASSERT_LT(a, b);
        }
    }
}

// The lists that a visitor is handed, with their distances checked on the way.
Lists visitedLists(SearchEngine& engine, const SparseGrid& grid, const SearchOptions& options)
{
    std::mutex mutex;
    std::multiset<std::uint32_t> queries;
    Lists lists(grid.view().size());
    engine.visit(
        grid,
        [&](std::uint32_t query, Span<const std::uint32_t> row, Span<const double> distances) {
            const std::lock_guard<std::mutex> lock(mutex);
            queries.insert(query);
            lists.at(query).assign(row.begin(), row.end());
            ASSERT_EQ(distances.size(), row.size());
            for (std::size_t k = 0; k < row.size(); ++k) {
                EXPECT_EQ(distances[k], grid.view().distance(query, row[k]));
            }
        },
        options);
    EXPECT_EQ(queries.size(), grid.particleCount());
    EXPECT_EQ(std::set<std::uint32_t>(queries.begin(), queries.end()).size(), queries.size());
    return lists;
}

TEST_P(Agreement, EveryCellSizeLevelAndEncodingMatchesTheOracle)
{
    const SetView input = this->input();
    const Lists oracle = oracleLists(set());
    SearchEngine engine;
    for (const double cellSize : {1.0, 1.0 / 2, 1.0 / 3, 0.8, 1.5, 2.0, 3.0, 4.0, 0.0}) {
        Lists first; // in the order that all others must have
        for (const SimdLevel simd : simdLevels()) {
            SCOPED_TRACE("cells of " + std::to_string(cellSize) + " radii" + ", " + simdLevelName(simd));
            SearchOptions options;
            options.cellSize = cellSize;
            options.simd = simd;
            const SparseGrid grid = engine.buildGrid(input.view(), set().radius, options);
            const NeighborLists index = engine.search(grid, options);
            const Lists indexLists = decoded(index);
            ASSERT_TRUE(sameLists(indexLists, oracle, set()));
            if (simd == SimdLevel::kScalar) {
                first = indexLists;
                expectCellOrder(first, cellsOf(grid));
                expectReadersAgree(index, first, oracle);
            }
            EXPECT_EQ(indexLists, first);
            options.encoding = Encoding::kMask;
            const NeighborLists mask = engine.search(grid, options);
            ASSERT_TRUE(sameLists(mask, oracle, set()));
            expectReadersAgree(mask, first, oracle);
            options.encoding = Encoding::kNone;
            const NeighborLists none = engine.search(grid, options);
            ASSERT_TRUE(sameCounts(none.counts(), oracle));
            EXPECT_EQ(none.pairCount(), index.pairCount());
            EXPECT_EQ(visitedLists(engine, grid, options), first);
        }
    }
}

TEST_P(Agreement, OrderOfTheInputAndThreadsChangeNothing)
{
    const Form form = cases()[GetParam()].form;
    std::vector<std::uint32_t> order;
    const PointSet mixed = shuffled(set(), 77, order);
    const SetView input = this->input(), mixedInput(mixed, form);
    for (const Encoding encoding : {Encoding::kIndex, Encoding::kMask}) {
        SearchOptions options;
        options.encoding = encoding;
        const NeighborLists lists = findNeighbors(input.view(), set().radius, options);
        const Lists rows = decoded(lists);
        for (int threads = 1; threads <= 4; ++threads) {
            runOnThreads(threads, [&] {
                const NeighborLists again = findNeighbors(input.view(), set().radius, options);
                EXPECT_EQ(decoded(again), rows) << threads << " threads";
                EXPECT_EQ(again.checksum(), lists.checksum());
            });
        }
        const Lists mixedRows = decoded(findNeighbors(mixedInput.view(), set().radius, options));
        ASSERT_EQ(mixedRows.size(), rows.size());
        Lists renumbered(rows.size());
        for (std::size_t k = 0; k < rows.size(); ++k) {
            for (const std::uint32_t j : mixedRows[k]) renumbered[order[k]].push_back(order[j]);
        }
        Lists sorted = rows;
        for (auto& row : sorted) std::sort(row.begin(), row.end());
        EXPECT_TRUE(sameLists(renumbered, sorted, set()));
        for (std::uint32_t i = 0; i < sorted.size(); ++i) {
            for (const std::uint32_t j : sorted[i]) {
                ASSERT_TRUE(std::binary_search(sorted[j].begin(), sorted[j].end(), i)) << i << " " << j;
            }
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Sets, Agreement, ::testing::Range(std::size_t(0), cases().size()), caseName);

} // namespace

} // namespace vdb_nns::testing
