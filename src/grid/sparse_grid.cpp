// Sorts particles into leaves and cells. Deterministic for any number of threads: a slot depends on leaf, cell and
// particle number alone.
//
//   1. locate: every particle's leaf, through a small table of leaves for each chunk of particles
//   2. merge:  the chunks' leaves into one list in Morton order, and where each chunk writes into each leaf
//   3. scatter: leaf-local positions to their leaf
//   4. cells:  a counting sort inside each leaf
// Where the leaves of a file serve as they are, nothing of this is done: see file_leaves.h.
#include "vdb_nns/sparse_grid.h"

#include "cpu/leaves_in_reach-inl.h"
#include "grid/cell_map.h"
#include "grid/file_leaves.h"
#include "grid/lattice_choice.h"
#include "grid/placement.h"
#include "grid/sparse_grid_data.h"
#include "points/pair_geometry.h"
#include "points/particle_source.h"
#include "util/cancel.h"
#include "util/number_text.h"
#include "vdb_nns/error.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatch = CellMap::kBatch;

void scatterChunk(const GridMembers& members, const CellMap& map, Chunk& chunk, const std::uint32_t* leafOf,
                  GridScratch::Record* records, const CancelCheck& cancel)
{
    const ParticleSource& source = members.view.source();
    const bool mayBeLeftOut = !members.areAll();
    double stored[3][kBatch];
    CellMap::Located at;
    std::uint32_t* const cursor = chunk.cursor.data();
    for (std::size_t begin = chunk.begin; begin < chunk.end; begin += kBatch) {
        if (begin / kBatch % 64 == 0) cancel.check();
        const std::size_t n = std::min(kBatch, chunk.end - begin);
        const std::uint32_t* const leaves = leafOf + begin;
        const auto isSorted = [&](std::uint32_t leaf) { return leaf != kNoLeaf && cursor[leaf] != kNoLeaf; };
        if (mayBeLeftOut && std::none_of(leaves, leaves + n, isSorted)) continue;
        source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
        map.locate(stored, n, at);
        for (std::size_t i = 0; i < n; ++i) {
            const std::uint32_t leaf = leaves[i];
            if (leaf == kNoLeaf || (mayBeLeftOut && cursor[leaf] == kNoLeaf)) continue;
            records[cursor[leaf]++] = {at.local[0][i], at.local[1][i], at.local[2][i],
                                       static_cast<std::uint32_t>(begin + i)};
        }
    }
}

// Sorts the particles of one leaf by cell, stably. Writes the start of each occupied cell to starts[0..] and the
// occupancy mask; returns the number of occupied cells.
std::uint32_t sortLeaf(const GridScratch::Record* records, std::uint32_t begin, std::uint32_t end,
                       SparseGridData& grid, std::uint64_t* occupancy, std::uint32_t* starts,
                       std::vector<std::uint16_t>& cellOf, const CancelCheck& cancel)
{
    constexpr std::uint32_t kParticlesBetweenChecks = 1u << 20;
    const std::uint32_t n = end - begin;
    // f(first, end) for pieces of the particles.
    const auto forEachPiece = [&](auto&& f) {
        for (std::uint32_t first = 0, count; first < n; first += count) {
            count = std::min(n - first, kParticlesBetweenChecks);
            if (first > 0) cancel.check();
            f(first, first + count);
        }
    };
    if (cellOf.size() < n) cellOf.resize(n);
    std::uint64_t mask[8] = {};
    std::uint32_t next[512] = {};
    forEachPiece([&](std::uint32_t first, std::uint32_t last) {
        for (std::uint32_t i = first; i < last; ++i) {
            const GridScratch::Record& r = records[begin + i];
            const unsigned x = cellInLeaf(r.x), yz = cellInLeaf(r.y) << 3 | cellInLeaf(r.z),
                           cell = x << 6 | yz;
            cellOf[i] = static_cast<std::uint16_t>(cell);
            mask[x] |= std::uint64_t(1) << yz;
            ++next[cell];
        }
    });
    std::uint32_t cells = 0, slot = begin;
    for (int w = 0; w < 8; ++w) {
        occupancy[w] = mask[w];
        for (std::uint64_t m = mask[w]; m; m &= m - 1) {
            std::uint32_t& cell = next[w * 64 + __builtin_ctzll(m)];
            starts[cells++] = slot;
            slot += std::exchange(cell, slot);
        }
    }
    float *const x = grid.x.data(), *const y = grid.y.data(), *const z = grid.z.data();
    std::uint32_t* const number = grid.number.data();
    forEachPiece([&](std::uint32_t first, std::uint32_t last) {
        for (std::uint32_t i = first; i < last; ++i) {
            const GridScratch::Record r = records[begin + i];
            const std::uint32_t to = next[cellOf[i]]++;
            x[to] = r.x;
            y[to] = r.y;
            z[to] = r.z;
            number[to] = r.number;
        }
    });
    return cells;
}

// `checkCells(n)` is asked whether n occupied cells fit.
template <typename CheckCells>
void sortCells(GridScratch& scratch, SparseGridData& grid, CheckCells&& checkCells, const CancelCheck& cancel)
{
    const std::size_t leaves = grid.leafCount();
    grid.topology.build({grid.leafOrigins.data(), leaves}, cancel);
    std::uint32_t* const starts = scratch.leafOf.data(); // no longer needed as such
    const tbb::blocked_range<std::size_t> range(0, leaves, 16);
    tbb::parallel_for(range, [&](const tbb::blocked_range<std::size_t>& r) {
        cancel.check();
        std::vector<std::uint16_t> cellOf;
        for (std::size_t l = r.begin(); l < r.end(); ++l) {
            LeafRecord& leaf = grid.leaves[l];
            std::uint64_t* const occupancy = grid.topology.occupancy(l);
            leaf.occupancy = occupancy;
            leaf.firstCell = sortLeaf(scratch.records.data(), leaf.firstSlot, grid.leaves[l + 1].firstSlot,
                                      grid, occupancy, starts + leaf.firstSlot, cellOf, cancel);
        }
    });
    std::uint32_t cells = 0;
    for (std::size_t l = 0; l <= leaves; ++l) cells += std::exchange(grid.leaves[l].firstCell, cells);
    checkCells(cells);
    grid.cellStart.resizeDiscarding(std::size_t(cells) + 1);
    tbb::parallel_for(range, [&](const tbb::blocked_range<std::size_t>& r) {
        for (std::size_t l = r.begin(); l < r.end(); ++l) {
            const LeafRecord& leaf = grid.leaves[l];
            std::copy_n(starts + leaf.firstSlot, grid.leaves[l + 1].firstCell - leaf.firstCell,
                        grid.cellStart.data() + leaf.firstCell);
        }
    });
    grid.cellStart[cells] = grid.leaves[leaves].firstSlot;
}

// Coordinates and number.
constexpr std::uint64_t kBytesPerParticle = 3 * sizeof(float) + sizeof(std::uint32_t);

// Bound on the error of cell coordinates, from the extent of the leaves.
double coordinateErrorOf(const CellMap& map, const std::vector<Vec3i>& leafOrigins)
{
    double most[3] = {0, 0, 0};
    for (const Vec3i& origin : leafOrigins) {
        for (int k = 0; k < 3; ++k) most[k] = std::max(most[k], mostCellsOf(origin[k] >> 3));
    }
    return map.errorCells(most);
}

} // namespace

InputError nonfiniteParticles(std::uint64_t count, std::uint64_t particles)
{
    return InputError(std::to_string(count) + " of " + std::to_string(particles) +
                      " particles have a position that is NaN or infinite: repair them or skip them");
}

void checkGridCapacity(const SparseGridData& grid, const GridNeed& need, std::uint64_t hostMemoryBytes)
{
    const std::size_t leaves = grid.leafCount();
    const std::uint64_t needed = need.particles * kBytesPerParticle + need.cells * sizeof(std::uint32_t) +
                                 leaves * (sizeof(LeafRecord) + sizeof(Vec3i)) +
                                 Topology::bytesToBuild({grid.leafOrigins.data(), leaves}) + need.sortBytes;
    const std::uint64_t allowed = hostMemoryBytes ? hostMemoryBytes : availableMemoryBytes() + need.heldBytes;
    if (needed > allowed) throw gridDoesNotFit(need.particles, leaves, needed, allowed);
}

namespace {

// Where the lattice does not fit the grid is left in any state.
LatticeFit sortIntoCells(const GridMembers& members, const Lattice& lattice, const SearchOptions& options,
                         GridScratch& scratch, SparseGridData& grid)
{
    const ParticleSource& source = members.view.source();
    const CancelCheck cancel(options.progress, "grid");
    // Those around others may be past the limit by what the others reach.
    const double limit = members.around ? kCellLimit + 2 * 8 : kCellLimit;
    const CellMap map(source, lattice, options.simd, members.home, limit);
    scratch.leafOf.resizeDiscarding(source.size());
    Placement placed = placeParticles(members, map, options, scratch.leafOf.data(), cancel);
    if (placed.outOfRange && !members.around) return {};
    if (placed.nonfinite > 0 && options.nonfinite == NonFinite::kFail)
        throw nonfiniteParticles(placed.nonfinite, placed.members);
    cancel.update(0.3);
    std::vector<Chunk>& chunks = placed.chunks;
    mergeLeaves(chunks, members.around, grid);
    grid.view = members.view;
    grid.lattice = lattice;
    grid.coordinateError = coordinateErrorOf(map, grid.leafOrigins);
    if (!(grid.coordinateError <= kMaxErrorCells)) return {false, grid.coordinateError};
    grid.nonfiniteCount = placed.nonfinite;
    grid.finiteCount = placed.members - placed.nonfinite;
    const std::size_t particles = grid.leaves.back().firstSlot;
    GridNeed need{particles, grid.leafCount(), 0, 0};
    need.heldBytes = grid.x.usedBytes() * 4 + scratch.records.usedBytes() + scratch.leafOf.usedBytes();
    need.sortBytes = particles * sizeof(GridScratch::Record) + scratch.leafOf.usedBytes();
    for (const Chunk& chunk : chunks) need.sortBytes += chunk.cursor.size() * sizeof(std::uint32_t);
    checkGridCapacity(grid, need, options.hostMemoryBytes);
    scratch.records.resizeDiscarding(particles);
    tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t c) {
        scatterChunk(members, map, chunks[c], scratch.leafOf.data(), scratch.records.data(), cancel);
    });
    chunks.clear();
    cancel.update(0.6);
    for (PageArray<float>* array : {&grid.x, &grid.y, &grid.z}) array->resizeDiscarding(particles);
    grid.number.resizeDiscarding(particles);
    const auto checkCells = [&](std::size_t cells) {
        need.cells = cells;
        if (options.hostMemoryBytes) checkGridCapacity(grid, need, options.hostMemoryBytes);
    };
    sortCells(scratch, grid, checkCells, cancel);
    cancel.update(1);
    return {true, grid.coordinateError};
}

LatticeFit sortOn(const GridMembers& members, const Lattice& lattice, const SearchOptions& options,
                  GridScratch& scratch, SparseGridData& grid)
{
    if (!lattice.usesVoxels) return sortIntoCells(members, lattice, options, scratch, grid);
    const bool fits = takeOverLeaves(members.view, lattice, options, grid);
    grid.finiteCount = grid.particleCount();
    return {fits, 0};
}

// Throws InvalidInput for a lattice whose cells cannot be those of the view, whatever its particles.
void requireSuitable(const ParticleSource& source, const Lattice& lattice)
{
    checkLattice(lattice);
    if (lattice.usesVoxels && !areCells(source, lattice)) {
        throw InvalidInput("the lattice has voxels of edge " + shortest(lattice.cellSize) +
                           " as cells, and the particles are not points of a VDB grid of such voxels: "
                           "use a lattice of cells of its own");
    }
    if (source.isArray() || lattice.usesVoxels) return;
    for (const double x : lattice.reference) {
        if (std::floor(x) != x || std::fabs(x) > kCellLimit) {
            throw InvalidInput("the reference of the lattice, " + shortest(x) +
                               " on one axis, is no voxel: for VDB grids it must be a whole number inside "
                               "+-(2^31 - 4096)");
        }
    }
}

} // namespace

void buildSparseGrid(const GridMembers& members, const Lattice& lattice, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid)
{
    const ParticleSource& source = members.view.source();
    requireSuitable(members.home ? *members.home : source, lattice);
    const LatticeFit fit = sortOn(members, lattice, options, scratch, grid);
    if (fit.fits) return;
    if (lattice.usesVoxels) {
        throw InputError("the lattice has the voxels as cells, and a particle is more than half a voxel from "
                         "the centre of its own, or a voxel past +-(2^31 - 4096): use a lattice of cells");
    }
    throw CellMap(source, lattice, options.simd, members.home)
        .rangeError(source, fit.coordinateError, std::nullopt);
}

void buildSparseGrid(const GridMembers& members, double radius, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid)
{
    const ParticleSource& home = members.home ? *members.home : members.view.source();
    const bool mayUseVoxels = members.mayUseVoxels && members.areAll() && !members.home;
    offerLattices(home, radius, options, members.view.source(), mayUseVoxels,
                  [&](const Lattice& lattice) { return sortOn(members, lattice, options, scratch, grid); });
}

std::uint64_t SparseGridData::bytes() const
{
    return x.usedBytes() + y.usedBytes() + z.usedBytes() + number.usedBytes() + cellStart.usedBytes() +
           leaves.size() * sizeof(LeafRecord) + leafOrigins.size() * sizeof(Vec3i) + topology.bytes();
}

void SparseGridData::neighborhoodsInReach(const SparseGridData& candidates, std::size_t first,
                                          std::size_t end, LeafNeighborhood* out) const
{
    constexpr std::size_t kAtOnce = 64;
    std::uint32_t wanted[kAtOnce];
    for (std::size_t begin = first; begin < end; begin += kAtOnce) {
        const std::size_t count = std::min(kAtOnce, end - begin);
        for (std::size_t k = 0; k < count; ++k)
            wanted[k] = leavesInReach(leaves[begin + k].occupancy, reach());
        candidates.topology.neighborhoods({leafOrigins.data() + begin, count}, wanted, out + (begin - first));
    }
}

SparseGrid::SparseGrid()
{
    static const std::shared_ptr<const SparseGridData> empty = [] {
        auto data = std::make_shared<SparseGridData>();
        data->leaves.push_back({0, 0, nullptr}); // the end
        return data;
    }();
    mData = empty;
}

SparseGrid::SparseGrid(std::shared_ptr<const SparseGridData> data) : mData(std::move(data)) {}

const Lattice& SparseGrid::lattice() const
{
    return mData->lattice;
}
std::uint64_t SparseGrid::particleCount() const
{
    return mData->particleCount();
}
std::uint64_t SparseGrid::nonfiniteCount() const
{
    return mData->nonfiniteCount;
}
std::uint64_t SparseGrid::leafCount() const
{
    return mData->leafCount();
}
std::uint64_t SparseGrid::cellCount() const
{
    return mData->leaves.back().firstCell;
}
std::uint64_t SparseGrid::bytes() const
{
    return mData->bytes();
}
const ParticleView& SparseGrid::view() const
{
    return mData->view;
}

SparseGrid::Leaf SparseGrid::leaf(std::uint64_t index) const
{
    const LeafRecord& record = mData->leaves[index];
    Leaf leaf{mData->leafOrigins[index],
              {},
              record.firstSlot,
              mData->leaves[index + 1].firstSlot - record.firstSlot,
              record.firstCell};
    std::copy_n(record.occupancy, 8, leaf.occupancy);
    return leaf;
}

Span<const std::uint32_t> SparseGrid::particleNumbers() const
{
    return {mData->number.data(), mData->number.size()};
}

} // namespace vdb_nns
