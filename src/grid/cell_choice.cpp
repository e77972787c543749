// How wide cells should be. Wide cells are fewer and give a query more candidates: dense fluids want cells of the radius, or
// half of it; where few cells hold more than a handful of particles, finding and gathering cells costs more than the tests that
// wider cells add. Measured on the scenes of docs/accuracy.md.
//
//   1. A glance at every thousandth particle: how many leaves they are in. Where those are few for all particles, the scene is
//      dense, and nothing more is looked at.
//   2. Else a pilot: one pass over all particles, which counts cells and particles of some hundred wide cells (2^3 cells),
//      drawn by a hash of their coordinates.
#include "grid/cell_map.h"
#include "grid/placement.h"
#include "particles/particle_source.h"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <unordered_map>
#include <unordered_set>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatch = CellMap::kBatch;
constexpr std::size_t kGlance = 1024; // particles for one of the glance, but so many at least
constexpr std::size_t kPilot = 2048;  // particles that the pilot counts at least
constexpr double kLeafCells = 512;

constexpr double kCrowded = 64; // particles a cell: half the radius is no slower and makes masks smaller
constexpr double kDense = 4;    // particles a cell if all cells were full: no look at the cells
constexpr double kFilled = 6;   // particles an occupied cell: from here on cells of the radius are best
// Particles in the wide cell of the mean particle: above, the tests begin to cost.
constexpr double kCrowdedWide = 48;
// But on surfaces and in clusters wide cells hold far less than eight times as many.
constexpr double kCompact = 5;
constexpr double kLone = 2.5; // particles a wide cell: below, hardly anybody has a neighbor

std::uint64_t hashOf(std::int64_t x, std::int64_t y, std::int64_t z)
{
    // Odd multipliers from the golden ratio and its powers, and the finaliser of SplitMix64 without its first step.
    std::uint64_t h = static_cast<std::uint64_t>(x) * 0x9E3779B97F4A7C15u +
                      static_cast<std::uint64_t>(y) * 0xC2B2AE3D27D4EB4Fu +
                      static_cast<std::uint64_t>(z) * 0x165667B19E3779F9u;
    h = (h ^ (h >> 32)) * 0x94d049bb133111ebu;
    return h ^ (h >> 31);
}

// Particles a leaf, at most: of all over the leaves that the glance meets. 0 where none is in range.
double glanceAtLeaves(const ParticleSource& source, const CellMap& map)
{
    const std::size_t size = source.size();
    const std::size_t glanced = std::min(size, std::max(kGlance, size / kGlance));
    std::unordered_set<std::uint64_t> leaves;
    double stored[3][kBatch];
    CellMap::Located at;
    for (std::size_t k = 0; k < glanced; ++k) {
        // One of each of as many equal shares, anywhere in it: no lattice falls in step with that.
        const std::size_t low = size * k / glanced, high = size * (k + 1) / glanced;
        const std::size_t i = low + hashOf(static_cast<std::int64_t>(k), 0, 0) % (high - low);
        source.read(i, 1, map.reference, stored[0], stored[1], stored[2]);
        if (!map.inRange(stored[0][0], stored[1][0], stored[2][0])) continue;
        map.locate(stored, 1, at);
        leaves.insert(hashOf(at.leaf[0][0], at.leaf[1][0], at.leaf[2][0]));
    }
    return leaves.empty() ? 0 : static_cast<double>(size) / static_cast<double>(leaves.size());
}

// A wide cell: particles of its cells.
using WideCell = std::array<std::uint32_t, 8>;
using WideCells = std::unordered_map<std::uint64_t, WideCell>; // by hash

// Bits of a wide cell's coordinates, well mixed from bit 31 down. In 32 bits, so that a loop of it is vectorised.
std::uint32_t lotOf(std::uint32_t x, std::uint32_t y, std::uint32_t z)
{
    std::uint32_t h = x * 0x9E3779B1u ^ y * 0x85EBCA77u ^ z * 0xC2B2AE3Du;
    h = (h ^ h >> 15) * 0x2C1B3C6Du;
    return h ^ h >> 13;
}

// Cell coordinate along an axis, modulo 2^32.
std::uint32_t cellOf(const CellMap::Located& at, int axis, std::size_t i)
{
    return static_cast<std::uint32_t>(at.leaf[axis][i]) * 8 + cellInLeaf(at.local[axis][i]);
}

// Particles whose wide cell has a lot below 2^(32 - log2Shares).
void countCells(const ParticleSource& source, const CellMap& map, std::size_t begin, std::size_t end,
                int log2Shares, WideCells& found)
{
    double stored[3][kBatch];
    CellMap::Located at;
    std::uint32_t lots[kBatch];
    for (; begin < end; begin += kBatch) {
        const std::size_t n = std::min(kBatch, end - begin);
        source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
        const bool allInRange = map.locate(stored, n, at);
        for (std::size_t i = 0; i < n; ++i)
            lots[i] = lotOf(cellOf(at, 0, i) >> 1, cellOf(at, 1, i) >> 1, cellOf(at, 2, i) >> 1);
        for (std::size_t i = 0; i < n; ++i) {
            if (std::uint64_t(lots[i]) >> (32 - log2Shares)) continue;
            if (!allInRange && !map.inRange(stored[0][i], stored[1][i], stored[2][i])) continue;
            const std::uint32_t x = cellOf(at, 0, i), y = cellOf(at, 1, i), z = cellOf(at, 2, i);
            WideCell& wide = found[hashOf(x >> 1, y >> 1, z >> 1)];
            ++wide[(x & 1) << 2 | (y & 1) << 1 | (z & 1)];
        }
    }
}

// Of occupied cells and of occupied wide cells: particles of the mean cell, and of the cell of the mean particle, which is what
// a query meets. 0 where the pilot met none.
struct Occupancy {
    double perCell = 0, perWideCell = 0;
    double crowd = 0, wideCrowd = 0;
};

Occupancy occupancyOf(const WideCells& found)
{
    double cells = 0, particles = 0, squares = 0, wideSquares = 0;
    for (const auto& entry : found) {
        double sum = 0;
        for (const std::uint32_t count : entry.second) {
            cells += count > 0;
            sum += count;
            squares += double(count) * count;
        }
        particles += sum;
        wideSquares += sum * sum;
    }
    if (found.empty()) return {};
    return {particles / cells, particles / static_cast<double>(found.size()), squares / particles,
            wideSquares / particles};
}

Occupancy runPilot(const ParticleSource& source, const CellMap& map)
{
    int log2Shares = 0;
    while (source.size() >> log2Shares > 2 * kPilot) ++log2Shares;
    const auto parts = 4 * static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    std::vector<WideCells> found(parts);
    tbb::parallel_for(std::size_t(0), parts, [&](std::size_t p) {
        countCells(source, map, source.size() * p / parts, source.size() * (p + 1) / parts, log2Shares,
                   found[p]);
    });
    for (std::size_t p = 1; p < parts; ++p) {
        for (const auto& [hash, wide] : found[p]) {
            WideCell& sum = found[0][hash];
            for (std::size_t c = 0; c < wide.size(); ++c) sum[c] += wide[c];
        }
    }
    return occupancyOf(found[0]);
}

} // namespace

double chooseCellSize(const ParticleSource& source, const CellMap& map, bool mayBeWide)
{
    const double perLeaf = glanceAtLeaves(source, map);
    if (perLeaf >= kCrowded * kLeafCells) return 0.5;
    if (!mayBeWide || perLeaf == 0 || perLeaf >= kDense * kLeafCells) return 1;
    const Occupancy occupancy = runPilot(source, map);
    if (occupancy.perCell >= kFilled || occupancy.perCell == 0) return 1;
    const bool addsManyTests =
        occupancy.wideCrowd > kCrowdedWide && occupancy.wideCrowd > kCompact * occupancy.crowd;
    if (addsManyTests) return 1;
    return occupancy.perWideCell > kLone || occupancy.wideCrowd > 2 * kLone ? 2 : 4;
}

} // namespace vdb_nns
