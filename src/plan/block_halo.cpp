// A set of cells is 8 words, one for each x; a word has a byte for each y, a byte a bit for each z.
#include "plan/block_halo.h"

#include <algorithm>
#include <cstring>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kEachByte = 0x0101010101010101u;

// Along z: dz of -1, 0, 1 is the leaf below, the same one, the one above.
std::uint64_t spreadZ(std::uint64_t word, int dz, int reach)
{
    std::uint64_t out = dz == 0 ? word : 0;
    for (int k = 1; k <= reach; ++k) {
        const std::uint64_t low = kEachByte * ((1u << k) - 1), high = low << (8 - k);
        if (dz == 0) out |= (word << k & ~low) | (word >> k & ~high);
        if (dz > 0) out |= word >> (8 - k) & low;
        if (dz < 0) out |= word << (8 - k) & high;
    }
    return out;
}

std::uint64_t spreadY(std::uint64_t word, int dy, int reach)
{
    std::uint64_t out = dy == 0 ? word : 0;
    for (int k = 1; k <= reach; ++k) {
        if (dy == 0) out |= word << 8 * k | word >> 8 * k;
        if (dy > 0) out |= word >> 8 * (8 - k);
        if (dy < 0) out |= word << 8 * (8 - k);
    }
    return out;
}

// Unites sets of the same leaf; ascending by leaf.
void merge(std::vector<CellSet>& sets)
{
    std::sort(sets.begin(), sets.end(), [](const CellSet& a, const CellSet& b) { return a.leaf < b.leaf; });
    std::size_t out = 0;
    for (std::size_t i = 0; i < sets.size(); ++i) {
        if (out > 0 && sets[out - 1].leaf == sets[i].leaf) {
            for (int x = 0; x < 8; ++x) sets[out - 1].cells[x] |= sets[i].cells[x];
        } else {
            sets[out++] = sets[i];
        }
    }
    sets.resize(out);
}

} // namespace

std::uint64_t particlesIn(const SparseGridData& grid, const CellSet& set)
{
    const LeafRecord& leaf = grid.leaves[set.leaf];
    const std::uint32_t* cell = grid.cellStart.data() + leaf.firstCell;
    std::uint64_t particles = 0;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cell) {
            if (set.cells[x] & word & -word) particles += cell[1] - cell[0];
        }
    }
    return particles;
}

std::uint64_t cellsIn(const CellSet& set)
{
    std::uint64_t cells = 0;
    for (const std::uint64_t word : set.cells)
        cells += static_cast<std::uint64_t>(__builtin_popcountll(word));
    return cells;
}

void cellsInReach(const std::uint64_t* cells, int dx, int dy, int dz, int reach, std::uint64_t* out)
{
    std::uint64_t spread[8];
    for (int x = 0; x < 8; ++x) spread[x] = spreadZ(spreadY(cells[x], dy, reach), dz, reach);
    for (int x = 0; x < 8; ++x) {
        const int low = std::max(x + 8 * dx - reach, 0), high = std::min(x + 8 * dx + reach, 7);
        out[x] = 0;
        for (int from = low; from <= high; ++from) out[x] |= spread[from];
    }
}

BlockHalo haloOf(const SparseGridData& grid, std::uint32_t firstLeaf, std::uint32_t endLeaf, int log2Cells)
{
    BlockHalo result;
    if (log2Cells == WorkloadNode::kRoot) return result;
    const std::int32_t last = (std::int32_t(1) << (log2Cells - 3)) - 1; // leaf of the cube, on an axis
    LeafNeighborhood neighborhood;
    for (std::uint32_t l = firstLeaf; l < endLeaf; ++l) {
        bool isInside = true;
        for (const std::int32_t origin : grid.leafOrigins[l]) {
            const std::int32_t at = origin >> 3 & last;
            isInside &= at > 0 && at < last;
        }
        if (isInside) continue;
        grid.neighborhoodsInReach(l, l + 1, &neighborhood);
        const std::uint64_t* const own = grid.leaves[l].occupancy;
        CellSet boundary{l, {}};
        std::uint64_t any = 0;
        for (int n = 0; n < kLeavesAround; ++n) {
            const std::uint32_t other = neighborhood.leaf[n];
            if (other == kNoLeaf || (other >= firstLeaf && other < endLeaf)) continue;
            const std::uint64_t* const outside = grid.leaves[other].occupancy;
            const int dx = n / 9 - 1, dy = n / 3 % 3 - 1, dz = n % 3 - 1;
            CellSet halo{other, {}};
            cellsInReach(own, dx, dy, dz, grid.reach(), halo.cells);
            std::uint64_t touched = 0;
            for (int x = 0; x < 8; ++x) touched |= halo.cells[x] &= outside[x];
            if (!touched) continue;
            result.halo.push_back(halo);
            std::uint64_t back[8];
            cellsInReach(outside, -dx, -dy, -dz, grid.reach(), back);
            for (int x = 0; x < 8; ++x) any |= boundary.cells[x] |= back[x] & own[x];
        }
        if (any) result.boundary.push_back(boundary);
    }
    merge(result.halo);
    for (const CellSet& set : result.halo) {
        result.size.particles += particlesIn(grid, set);
        result.size.cells += cellsIn(set);
    }
    result.size.leaves = result.halo.size();
    for (const CellSet& set : result.boundary) result.size.boundaryQueries += particlesIn(grid, set);
    result.size.boundaryLeaves = result.boundary.size();
    return result;
}

} // namespace vdb_nns
