// Lists in memory as the rows of an .npz file: all of them, or those of a tile.
#include "io/npz_writer.h"
#include "io/set_geometry.h"
#include "lists/neighbor_lists_data.h"
#include "util/known_value.h"
#include "vdb_nns/error.h"
#include "vdb_nns/tiles.h"

#include <algorithm>

namespace vdb_nns {
namespace {

// Rows of lists in either encoding.
class ListRows final : public NpzRows {
public:
    explicit ListRows(const NeighborLists& lists) : mLists(lists), mGeometry(lists.sets()) {}

    std::size_t size() const override { return mLists.size(); }
    std::uint64_t pairCount() const override { return mLists.pairCount(); }
    std::size_t columnCount() const override { return mLists.sets().columnCount(); }
    std::uint32_t count(std::size_t row) const override { return mLists.data().entriesOf(row); }

    void copyRow(std::size_t row, std::uint32_t* out) const override
    {
        if (mLists.encoding() == Encoding::kIndex) {
            const Span<const std::uint32_t> list = mLists.indices(row);
            std::copy(list.begin(), list.end(), out);
            return;
        }
        thread_local std::vector<std::uint32_t> list;
        mLists.neighbors(row, list);
        std::copy(list.begin(), list.end(), out);
    }

    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return mGeometry.distance(row, neighbor);
    }

    void order(std::size_t row, std::uint32_t* numbers, std::size_t count) const override
    {
        mGeometry.order(row, numbers, count);
    }

private:
    const NeighborLists& mLists;
    const SetGeometry mGeometry;
};

// Some of those rows.
class ChosenRows final : public NpzRows {
public:
    ChosenRows(const NpzRows& all, const std::vector<std::uint32_t>& rows) : mAll(all), mRows(rows)
    {
        for (const std::uint32_t row : rows) mPairs += all.count(row);
    }

    std::size_t size() const override { return mRows.size(); }
    std::uint64_t pairCount() const override { return mPairs; }
    std::size_t columnCount() const override { return mAll.columnCount(); }
    std::uint32_t count(std::size_t row) const override { return mAll.count(mRows[row]); }
    void copyRow(std::size_t row, std::uint32_t* out) const override { mAll.copyRow(mRows[row], out); }
    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return mAll.distance(mRows[row], neighbor);
    }
    void order(std::size_t row, std::uint32_t* numbers, std::size_t count) const override
    {
        mAll.order(mRows[row], numbers, count);
    }

private:
    const NpzRows& mAll;
    const std::vector<std::uint32_t>& mRows;
    std::uint64_t mPairs = 0;
};

// The same rows with the numbers of the file that the view is a part of.
class RenumberedRows final : public NpzRows {
public:
    RenumberedRows(const NpzRows& rows, const TileNumbers& numbers) : mRows(rows), mNumbers(numbers) {}

    std::size_t size() const override { return mRows.size(); }
    std::uint64_t pairCount() const override { return mRows.pairCount(); }
    std::size_t columnCount() const override { return static_cast<std::size_t>(mNumbers.total); }
    std::uint32_t count(std::size_t row) const override { return mRows.count(row); }

    void copyRow(std::size_t row, std::uint32_t* out) const override
    {
        mRows.copyRow(row, out);
        const std::size_t entries = mRows.count(row);
        for (std::size_t k = 0; k < entries; ++k) out[k] = mNumbers.numbers[out[k]];
    }

    double distance(std::size_t row, std::size_t neighbor) const override
    {
        return mRows.distance(row, placeOf(static_cast<std::uint32_t>(neighbor)));
    }

    void order(std::size_t row, std::uint32_t* numbers, std::size_t count) const override
    {
        for (std::size_t k = 0; k < count; ++k) numbers[k] = placeOf(numbers[k]);
        mRows.order(row, numbers, count);
        for (std::size_t k = 0; k < count; ++k) numbers[k] = mNumbers.numbers[numbers[k]];
    }

private:
    std::uint32_t placeOf(std::uint32_t number) const
    {
        const std::vector<std::uint32_t>& all = mNumbers.numbers;
        return static_cast<std::uint32_t>(std::lower_bound(all.begin(), all.end(), number) - all.begin());
    }

    const NpzRows& mRows;
    const TileNumbers& mNumbers;
};

void checkLists(const std::string& path, const NeighborLists& lists, const ListForm& form)
{
    requireKnown(form.values, ListValues::kDistance, "kind of values");
    requireKnown(form.order, RowOrder::kDistance, "order of rows");
    if (lists.encoding() == Encoding::kNone) {
        throw InvalidInput(path +
                           ": counts alone (encoding none) are no lists; search with encoding index or mask");
    }
}

} // namespace

void writeNpz(const std::string& path, const NeighborLists& lists, const ListForm& form,
              const OutputOptions& options, Progress* progress)
{
    checkLists(path, lists, form);
    writeNpzRows(path, ListRows(lists), form, options, progress);
}

void writeNpzPart(const std::string& path, const NeighborLists& lists, const std::vector<std::uint32_t>& rows,
                  const PartOrigin& origin, const ListForm& form, const OutputOptions& options,
                  Progress* progress, const TileNumbers* numbers)
{
    checkLists(path, lists, form);
    const ListRows all(lists);
    const ChosenRows chosen(all, rows);
    std::vector<std::uint32_t> renumbered;
    if (numbers) {
        for (const std::uint32_t row : rows) renumbered.push_back(numbers->numbers[row]);
    }
    const NpzPart part{numbers ? renumbered : rows,
                       {origin.tile, origin.tiles, origin.input, origin.options, origin.rows}};
    if (numbers) {
        writeNpzRows(path, RenumberedRows(chosen, *numbers), form, options, progress, &part);
    } else {
        writeNpzRows(path, chosen, form, options, progress, &part);
    }
}

} // namespace vdb_nns
