#include "search/sample_rows.h"

#include "cpu/leaves_in_reach-inl.h"
#include "search/count_queries.h"

#include <algorithm>
#include <cstdint>

namespace vdb_nns {

RowSample sampleRows(const SearchRun& run, std::size_t most, ThreadState& state)
{
    const std::size_t particles = run.queries.particleCount();
    RowSample sample;
    sample.queries = std::min(particles, most);
    auto piece = run.pieces.begin();
    std::uint32_t count = 0;
    for (std::size_t k = 0; k < sample.queries; ++k) {
        run.cancel.check();
        const auto slot = static_cast<std::uint32_t>(particles * k / sample.queries);
        while (piece->endSlot <= slot) ++piece;
        std::uint64_t cells[8];
        markCell(run.queries, piece->leaf, slot, cells);
        LeafNeighborhood neighborhood;
        const std::uint32_t wanted = leavesInReach(cells, run.queries.reach());
        run.candidates.topology.neighborhoods({&run.queries.leafOrigins[piece->leaf], 1}, &wanted,
                                              &neighborhood);
        state.sink.slotBase = slot;
        state.sink.rowCount = &count;
        run.makeRows(RowKind::kCount, {piece->leaf, slot, slot + 1, neighborhood.leaf, cells}, state,
                     state.sink);
        sample.entries += run.entriesKept(slot, count);
    }
    return sample;
}

} // namespace vdb_nns
