#include "search/leaf_tasks.h"

#include <tbb/task_arena.h>

namespace vdb_nns {

std::vector<Piece> makePieces(const SparseGridData& grid)
{
    const auto threads = static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    const std::size_t most = std::clamp<std::size_t>(grid.particleCount() / (16 * threads), 1024, 16384);
    std::vector<Piece> pieces;
    pieces.reserve(grid.leafCount());
    for (std::uint32_t l = 0; l < grid.leafCount(); ++l) {
        const std::uint64_t first = grid.leaves[l].firstSlot, count = grid.leaves[l + 1].firstSlot - first;
        const std::uint64_t parts = (count + most - 1) / most;
        for (std::uint64_t p = 0; p < parts; ++p) {
            pieces.push_back({l, static_cast<std::uint32_t>(first + count * p / parts),
                              static_cast<std::uint32_t>(first + count * (p + 1) / parts)});
        }
    }
    return pieces;
}

} // namespace vdb_nns
