// How wide cells should be. Wide cells have fewer leaves and more candidates a query: dense fluids want cells of the radius, or
// half of it; where few cells hold more than a handful of particles, finding and gathering cells costs more than the tests that
// wider cells add. Measured on the scenes of docs/accuracy.md.
#include "grid/placement.h"
#include "particles/particle_source.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bitset>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatch = CellMap::kBatch;
constexpr std::size_t kSampledLeaves = 512; // tell the occupied cells of all to some per cent
constexpr double kLeafCells = 512;

constexpr double kCrowded = 64; // particles a cell: half the radius is no slower and makes masks smaller
constexpr double kFilled = 6;   // particles a cell: from here on cells of the radius are best
constexpr double kRoomy = 10;   // particles a cell of twice the edge: above, the tests cost more than is won
constexpr double kLone = 2.5;   // particles a cell of twice the edge: below, hardly anybody has a neighbor

using Occupancy = std::array<std::atomic<std::uint64_t>, 8>; // a bit a cell, as LeafRecord::occupancy

// Numbers of sampled leaves, by local leaf of a chunk; kNotSampled for others.
constexpr std::uint32_t kNotSampled = 0xffffffffu;

std::vector<std::uint32_t> sampleOf(const Chunk& chunk, const SparseGridData& grid, std::size_t stride)
{
    std::vector<std::uint32_t> sample(chunk.cursor.size(), kNotSampled);
    const auto firstLeaf = grid.leaves.begin(), endLeaf = grid.leaves.end() - 1;
    for (std::size_t local = 0; local < sample.size(); ++local) {
        const auto after = std::upper_bound(
            firstLeaf, endLeaf, chunk.cursor[local],
            [](std::uint32_t slot, const LeafRecord& leaf) { return slot < leaf.firstSlot; });
        const auto leaf = static_cast<std::size_t>(after - firstLeaf) - 1;
        if (leaf % stride == 0) sample[local] = static_cast<std::uint32_t>(leaf / stride);
    }
    return sample;
}

// Marks the cells of the sampled particles of a chunk.
void markCells(const ParticleSource& source, const CellMap& map, const Chunk& chunk,
               const std::vector<std::uint32_t>& sample, const std::uint32_t* leafOf, Occupancy* occupancy)
{
    double stored[3][kBatch];
    CellMap::Located at;
    const auto isSampled = [&](std::size_t i) {
        return leafOf[i] != kNoLeaf && sample[leafOf[i]] != kNotSampled;
    };
    for (std::size_t begin = chunk.begin; begin < chunk.end; begin += kBatch) {
        const std::size_t n = std::min(kBatch, chunk.end - begin);
        std::size_t first = 0;
        while (first < n && !isSampled(begin + first)) ++first;
        if (first == n) continue;
        source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
        map.locate(stored, n, at);
        for (std::size_t i = first; i < n; ++i) {
            if (!isSampled(begin + i)) continue;
            const unsigned x = cellInLeaf(at.local[0][i]),
                           yz = cellInLeaf(at.local[1][i]) << 3 | cellInLeaf(at.local[2][i]);
            occupancy[sample[leafOf[begin + i]]][x].fetch_or(std::uint64_t(1) << yz,
                                                             std::memory_order_relaxed);
        }
    }
}

// Occupied cells of a leaf, and how many they are when two are one along each axis.
struct OccupiedCells {
    std::uint64_t cells = 0, wideCells = 0;
};

OccupiedCells countCells(const Occupancy& occupancy)
{
    OccupiedCells counts;
    for (std::size_t x = 0; x < 8; x += 2) {
        const std::uint64_t low = occupancy[x], high = occupancy[x + 1];
        counts.cells += std::bitset<64>(low).count() + std::bitset<64>(high).count();
        std::uint64_t both = low | high;
        both |= both >> 1;           // along z
        both |= both >> 8;           // along y
        both &= 0x0055005500550055u; // the even ones
        counts.wideCells += std::bitset<64>(both).count();
    }
    return counts;
}

} // namespace

double chooseCellSize(const ParticleSource& source, const Placement& placement, const SparseGridData& grid,
                      const std::uint32_t* leafOf, bool mayBeWide)
{
    const std::size_t leaves = grid.leafCount();
    if (leaves == 0) return 1;
    const double meanPerLeaf =
        static_cast<double>(grid.leaves[leaves].firstSlot) / static_cast<double>(leaves);
    if (meanPerLeaf >= kCrowded * kLeafCells) return 0.5;
    if (!mayBeWide || meanPerLeaf >= kFilled * kLeafCells) return 1; // the cells need not be looked at

    const std::size_t stride = std::max<std::size_t>(1, leaves / kSampledLeaves);
    const std::size_t sampled = (leaves + stride - 1) / stride;
    std::vector<Occupancy> occupancy(sampled);
    tbb::parallel_for(std::size_t(0), placement.chunks.size(), [&](std::size_t c) {
        const Chunk& chunk = placement.chunks[c];
        markCells(source, placement.map, chunk, sampleOf(chunk, grid, stride), leafOf, occupancy.data());
    });
    OccupiedCells all;
    std::uint64_t particles = 0;
    for (std::size_t s = 0; s < sampled; ++s) {
        const OccupiedCells counts = countCells(occupancy[s]);
        all.cells += counts.cells;
        all.wideCells += counts.wideCells;
        particles += grid.leaves[s * stride + 1].firstSlot - grid.leaves[s * stride].firstSlot;
    }
    const double perCell = static_cast<double>(particles) / static_cast<double>(all.cells);
    const double perWideCell = static_cast<double>(particles) / static_cast<double>(all.wideCells);
    if (perCell >= kCrowded) return 0.5;
    if (perCell >= kFilled) return 1;
    if (perWideCell > kRoomy) return 1.5;
    return perWideCell > kLone ? 2 : 4;
}

} // namespace vdb_nns
