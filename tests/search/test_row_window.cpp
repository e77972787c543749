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

TEST(RowWindow, UsesChunksInSeveralAgain)
{
    RowWindow window(6 * RowWindow::kChunkBytes, {});
    for (int k = 0; k < 100; ++k) {
        const std::uint32_t first = window.take(3 * RowWindow::kChunkEntries);
        window.release(first);
        const std::uint32_t single = window.take(1); // not the middle of what is asked for next
        window.release(window.take(4 * RowWindow::kChunkEntries));
        window.release(single);
    }
    EXPECT_EQ(window.heldBytes(), 0u);
    // Released one by one in any order, they are one piece again.
    std::vector<std::uint32_t> chunks(6);
    for (std::uint32_t& chunk : chunks) chunk = window.take(1);
    for (const int k : {3, 0, 5, 1, 4, 2}) window.release(chunks[static_cast<std::size_t>(k)]);
    const std::uint32_t all = window.take(6 * RowWindow::kChunkEntries);
    EXPECT_THROW(window.take(1), RowWindow::Exceeded);
    // What its rows did not need serves others while they are held.
    window.shrink(all, window.begin(all) + RowWindow::kChunkEntries + 1);
    EXPECT_EQ(window.heldBytes(), 2 * RowWindow::kChunkBytes);
    EXPECT_EQ(window.end(all) - window.begin(all), static_cast<std::ptrdiff_t>(2 * RowWindow::kChunkEntries));
    const std::uint32_t rest = window.take(4 * RowWindow::kChunkEntries);
    EXPECT_EQ(window.begin(rest), window.end(all));
    window.shrink(rest, window.begin(rest)); // none made: one chunk stays
    EXPECT_EQ(window.heldBytes(), 3 * RowWindow::kChunkBytes);
    window.shrink(rest, window.end(rest));
    EXPECT_EQ(window.heldBytes(), 3 * RowWindow::kChunkBytes);
}

// Chunks of two pieces of memory are no row's, however they were released.
TEST(RowWindow, KeepsPiecesOfMemoryApart)
{
    std::vector<std::uint32_t> lent(2 * RowWindow::kChunkEntries);
    RowWindow window(2 * RowWindow::kChunkBytes, {lent.data(), lent.size()});
    std::vector<std::uint32_t> chunks(4);
    for (std::uint32_t& chunk : chunks) chunk = window.take(1);
    if (window.begin(chunks[2]) == lent.data() + lent.size()) GTEST_SKIP() << "one lies behind the other";
    for (const std::uint32_t chunk : chunks) window.release(chunk);
    EXPECT_THROW(window.take(3 * RowWindow::kChunkEntries), RowWindow::Exceeded);
    for (int k = 0; k < 2; ++k) {
        const std::uint32_t first = window.take(2 * RowWindow::kChunkEntries);
        EXPECT_EQ(window.begin(first) + RowWindow::kChunkEntries, window.begin(first + 1));
    }
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
