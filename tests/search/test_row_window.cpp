// The memory of rows that wait: each chunk is used again once its rows were taken, and not before.
#include "search/row_window.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

namespace vdb_nns {
namespace {

TEST(RowWindow, UsesAChunkAgainOnceItsRowsWereTaken)
{
    RowWindow window(16 * RowWindow::kChunkBytes, {});
    const std::uint32_t chunk = window.take(100);
    EXPECT_EQ(window.heldBytes(), RowWindow::kChunkBytes);
    window.addRows(chunk, 3);
    window.release(chunk); // by who took it
    window.release(chunk, 2);
    EXPECT_NE(window.take(1), chunk);
    window.release(chunk);
    EXPECT_EQ(window.take(1), chunk);
}

TEST(RowWindow, FindsRowsByTheirPlacesInSeveralChunksToo)
{
    RowWindow window(40 * RowWindow::kChunkBytes, {});
    window.take(1);
    const std::size_t entries = 20 * RowWindow::kChunkEntries - 5;
    const std::uint32_t first = window.take(entries);
    EXPECT_EQ(window.heldBytes(), 21 * RowWindow::kChunkBytes);
    EXPECT_EQ(window.end(first) - window.begin(first),
              static_cast<std::ptrdiff_t>(20 * RowWindow::kChunkEntries));
    for (const std::size_t at : {std::size_t(0), RowWindow::kChunkEntries, entries - 1}) {
        window.begin(first)[at] = static_cast<std::uint32_t>(at);
        const std::uint32_t place = window.placeOf(first, window.begin(first) + at);
        EXPECT_EQ(window.rowAt(place), window.begin(first) + at);
        EXPECT_EQ(window.firstOf(place), first);
    }
    // Then they are chunks like others.
    window.release(first);
    EXPECT_EQ(window.heldBytes(), RowWindow::kChunkBytes);
    std::set<std::uint32_t*> begins;
    for (int k = 0; k < 39; ++k) {
        const std::uint32_t chunk = window.take(1);
        EXPECT_EQ(window.firstOf(window.placeOf(chunk, window.begin(chunk))), chunk);
        EXPECT_TRUE(begins.insert(window.begin(chunk)).second);
    }
    EXPECT_THROW(window.take(1), RowWindow::Exceeded);
}

TEST(RowWindow, TakesWhatIsLentFirstAndDoesNotCountIt)
{
    std::vector<std::uint32_t> lent(3 * RowWindow::kChunkEntries + 7);
    RowWindow window(2 * RowWindow::kChunkBytes, {lent.data(), lent.size()});
    for (std::size_t k = 0; k < 3; ++k)
        EXPECT_EQ(window.begin(window.take(1)), lent.data() + k * RowWindow::kChunkEntries);
    EXPECT_THROW(window.take(3 * RowWindow::kChunkEntries), RowWindow::Exceeded);
    const std::uint32_t own = window.take(2 * RowWindow::kChunkEntries);
    EXPECT_EQ(window.rowAt(window.placeOf(own, window.begin(own))), window.begin(own));
    EXPECT_THROW(window.take(1), RowWindow::Exceeded);
}

} // namespace
} // namespace vdb_nns
