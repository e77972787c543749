#include "io/npz_search.h"

#include "io/npz_in_order.h"
#include "io/npz_parts.h"
#include "io/output_file.h"
#include "io/set_geometry.h"
#include "search/ordered_rows.h"
#include "util/isolate.h"
#include "util/known_value.h"
#include "util/wall_clock.h"

namespace vdb_nns {

namespace {

// How far the pairs of a sample of queries may be from the truth, as a factor, before anything but time is lost.
constexpr double kDoubt = 2;

// Whether the number of pairs must be known before the first row is written: for the place of distances, or because it is in
// doubt whether the indices take 4 GiB, or whether the disk has the room.
bool mustCount(const OutputFile& file, const NpzShape& shape, double expectedPairs, ListValues values)
{
    if (values == ListValues::kDistance) return true;
    const NpzLayout small = layoutNpz(shape, static_cast<std::uint64_t>(expectedPairs / kDoubt), values),
                    large = layoutNpz(shape, static_cast<std::uint64_t>(expectedPairs * kDoubt), values);
    const std::optional<std::uint64_t> freeBytes = file.freeBytes();
    return small.members[NpzLayout::kIndices].valueOffset != large.members[NpzLayout::kIndices].valueOffset ||
           (freeBytes && large.directoryOffset > *freeBytes);
}

} // namespace

std::optional<NpzSearchResult> searchToNpz(EngineState& engine, const SearchSets& sets,
                                           const SearchOptions& search, const NpzSearchOptions& options)
{
    requireKnown(options.form.values, ListValues::kDistance, "kind of values");
    requireKnown(options.form.order, RowOrder::kDistance, "order of rows");
    return isolatedIeee([&]() -> std::optional<NpzSearchResult> {
        OrderedSearch rows(engine, sets, search);
        const double rowBytes = rows.expectedNeighbors() * sizeof(std::uint32_t);
        if (options.windowBytes == 0 || kDoubt * rowBytes * static_cast<double>(rows.windowRows()) >
                                            static_cast<double>(options.windowBytes))
            return std::nullopt;
        if (options.checksum) rows.makeChecksum();
        const NpzShape shape{sets.rowCount(), sets.columnCount()};
        const CancelCheck cancel(search.progress, "search");
        OutputFile file(options.path, options.output);
        const double expected = rows.expectedPairs();
        auto pairs = static_cast<std::uint64_t>(expected);
        if (mustCount(file, shape, expected, options.form.values)) {
            pairs = rows.countPairs();
            beginFile(file, layoutNpz(shape, pairs, options.form.values));
        }
        const SetGeometry geometry(rows.sets());
        for (;;) {
            NpzInOrder npz(file, shape, pairs, options.form, geometry, cancel);
            NpzSearchResult result;
            try {
                result.lists = rows.run(options.windowBytes, npz);
            } catch (const WindowExceeded&) {
                return std::nullopt;
            }
            const double found = wallSeconds();
            pairs = result.lists.pairCount();
            if (!npz.finish(pairs)) continue;
            file.commit();
            result.checksum = rows.checksum();
            result.writeSeconds = wallSeconds() - found;
            return result;
        }
    });
}

} // namespace vdb_nns
