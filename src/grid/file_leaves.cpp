#include "grid/file_leaves.h"

#include "grid/cell_map.h"
#include "grid/leaf_table.h"
#include "points/particle_source.h"
#include "util/cancel.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

// Voxels at most twice as wide as the radius. With block 4 M at 0.5 the search is still 3.6 times faster than in sorted
// cells, because those hold one particle each.
constexpr double kLeastRadius = 0.5;

// Edge of a voxel if the transform does nothing but scale and mirror, the same on each axis; else 0.
double voxelEdge(const Matrix3& linear)
{
    const double edge = std::fabs(linear[0][0]);
    for (int k = 0; k < 3; ++k) {
        for (int c = 0; c < 3; ++c) {
            if (!(std::fabs(std::fabs(linear[k][c]) - (k == c ? edge : 0)) <=
                  kUnevenVoxels * (k == c) * edge))
                return 0;
        }
    }
    return edge;
}

// The file's leaves in the order of the grid. Empty when cell coordinates would be out of range.
std::vector<FileLeaf> sortedLeaves(const ParticleSource& source)
{
    std::vector<FileLeaf> leaves(source.fileLeafCount());
    std::vector<std::pair<std::uint64_t, std::uint32_t>> order(leaves.size());
    RootOrder roots;
    const auto cellsOf = [](const FileLeaf& leaf) {
        return Vec3i{leaf.origin[0] >> 3, leaf.origin[1] >> 3, leaf.origin[2] >> 3};
    };
    for (std::size_t i = 0; i < leaves.size(); ++i) {
        leaves[i] = source.fileLeaf(i);
        for (const std::int32_t origin : leaves[i].origin) {
            if (!(std::fabs(origin + 4.0) + 4 < kCellLimit)) return {};
        }
        roots.add(cellsOf(leaves[i]));
    }
    roots.finish();
    for (std::size_t i = 0; i < leaves.size(); ++i) {
        order[i] = {roots.key(cellsOf(leaves[i])), static_cast<std::uint32_t>(i)};
    }
    tbb::parallel_sort(order.begin(), order.end());
    std::vector<FileLeaf> sorted(leaves.size());
    for (std::size_t i = 0; i < order.size(); ++i) sorted[i] = leaves[order[i].second];
    return sorted;
}

// Particles whose voxels are read at once.
constexpr std::size_t kVoxelBatch = 512;

// Notes which voxels of a leaf hold particles, and returns how many do.
std::uint32_t occupiedCells(const ParticleSource& source, const FileLeaf& leaf, std::uint64_t* occupancy)
{
    std::uint16_t voxels[kVoxelBatch];
    std::fill_n(occupancy, 8, std::uint64_t(0));
    for (std::uint32_t i = 0; i < leaf.count; i += kVoxelBatch) {
        const std::size_t n = std::min<std::size_t>(kVoxelBatch, leaf.count - i);
        source.readVoxels(leaf.firstParticle + i, n, voxels);
        for (std::size_t k = 0; k < n; ++k) occupancy[voxels[k] >> 6] |= std::uint64_t(1) << (voxels[k] & 63);
    }
    std::uint32_t cells = 0;
    for (int w = 0; w < 8; ++w) cells += static_cast<std::uint32_t>(__builtin_popcountll(occupancy[w]));
    return cells;
}

// Copies the particles of a leaf and makes its starts of cells. False when one is outside its voxel or not finite.
bool copyLeaf(const ParticleSource& source, const FileLeaf& leaf, const LeafRecord& record,
              SparseGridData& grid, const CancelCheck& cancel)
{
    constexpr std::size_t kBatch = CellMap::kBatch;
    const Vec3d corner{double(leaf.origin[0]), double(leaf.origin[1]), double(leaf.origin[2])};
    double at[3][kBatch];
    std::uint16_t voxels[kBatch];
    std::uint32_t* start = grid.cellStart.data() + record.firstCell;
    int lastVoxel = -1;
    bool inside = true;
    for (std::uint32_t i = 0; i < leaf.count; i += kBatch) {
        if (i > 0 && i % (64 * kBatch) == 0) cancel.check();
        const std::uint32_t n = std::min<std::uint32_t>(kBatch, leaf.count - i), slot = record.firstSlot + i;
        source.read(leaf.firstParticle + i, n, corner, at[0], at[1], at[2]);
        source.readVoxels(leaf.firstParticle + i, n, voxels);
        for (std::uint32_t b = 0; b < n; ++b) {
            const int voxel = voxels[b];
            inside &= std::fabs(at[0][b] - (voxel >> 6)) <= 0.5 &&
                      std::fabs(at[1][b] - (voxel >> 3 & 7)) <= 0.5 &&
                      std::fabs(at[2][b] - (voxel & 7)) <= 0.5;
            grid.x[slot + b] = static_cast<float>(at[0][b] - 3.5);
            grid.y[slot + b] = static_cast<float>(at[1][b] - 3.5);
            grid.z[slot + b] = static_cast<float>(at[2][b] - 3.5);
            grid.number[slot + b] = static_cast<std::uint32_t>(leaf.firstParticle) + i + b;
        }
        for (std::uint32_t b = 0; b < n; ++b) {
            if (voxels[b] != lastVoxel) *start++ = slot + b;
            lastVoxel = voxels[b];
        }
    }
    return inside;
}

} // namespace

std::optional<Lattice> latticeOfVoxels(const ParticleSource& source, double radius)
{
    if (source.isArray() || source.size() == 0) return std::nullopt;
    Lattice lattice;
    lattice.cellSize = voxelEdge(source.linear());
    lattice.radius = radius;
    lattice.usesVoxels = true;
    const double edge = lattice.cellSize;
    if (!(edge > 1e-290 && edge < 1e290 && voxelsSpan(edge, radius) && radius / edge >= kLeastRadius))
        return std::nullopt;
    return lattice;
}

bool areCells(const ParticleSource& source, const Lattice& lattice)
{
    return !source.isArray() && voxelEdge(source.linear()) == lattice.cellSize;
}

bool particlesAreInVoxels(const ParticleSource& source, const CancelCheck& cancel)
{
    if (sortedLeaves(source).empty() && source.size() > 0) return false;
    std::atomic<bool> inside{true};
    const tbb::blocked_range<std::size_t> range(0, source.size(), 8192);
    tbb::parallel_for(range, [&](const auto& r) {
        cancel.check();
        for (std::size_t i = r.begin(); i < r.end() && inside; ++i) {
            for (const double offset : source.stored(i).offset) {
                if (!(std::fabs(offset) <= 0.5)) inside = false;
            }
        }
    });
    return inside;
}

bool takeOverLeaves(const ParticleView& view, const Lattice& lattice, const SearchOptions& options,
                    SparseGridData& grid)
{
    const ParticleSource& source = view.source();
    const std::vector<FileLeaf> leaves = sortedLeaves(source);
    if (leaves.empty() && source.size() > 0) return false;
    const CancelCheck cancel(options.progress, "grid");
    grid.leafOrigins.resize(leaves.size());
    grid.leaves.resize(leaves.size() + 1);
    std::uint32_t slot = 0;
    for (std::size_t l = 0; l < leaves.size(); ++l) {
        grid.leafOrigins[l] = leaves[l].origin;
        grid.leaves[l].firstSlot = slot;
        slot += leaves[l].count;
    }
    grid.view = view;
    grid.lattice = lattice;
    grid.coordinateError = 16 * kUnevenVoxels; // of positions less than 12 cells from the leaf's centre
    grid.nonfiniteCount = 0;
    checkGridCapacity(grid, {slot, leaves.size(), 0, grid.x.usedBytes() * 4}, options.hostMemoryBytes);
    grid.topology.build({grid.leafOrigins.data(), leaves.size()}, cancel);
    const tbb::blocked_range<std::size_t> range(0, leaves.size(), 16);
    tbb::parallel_for(range, [&](const auto& r) {
        cancel.check();
        for (std::size_t l = r.begin(); l < r.end(); ++l) {
            std::uint64_t* const occupancy = grid.topology.occupancy(l);
            grid.leaves[l].occupancy = occupancy;
            grid.leaves[l].firstCell = occupiedCells(source, leaves[l], occupancy);
        }
    });
    std::uint32_t cells = 0;
    for (std::size_t l = 0; l < leaves.size(); ++l) cells += std::exchange(grid.leaves[l].firstCell, cells);
    grid.leaves[leaves.size()] = {slot, cells, nullptr};
    if (options.hostMemoryBytes) checkGridCapacity(grid, {slot, cells, 0, 0}, options.hostMemoryBytes);
    cancel.update(0.3);
    for (PageArray<float>* array : {&grid.x, &grid.y, &grid.z}) array->resizeDiscarding(slot);
    grid.number.resizeDiscarding(slot);
    grid.cellStart.resizeDiscarding(std::size_t(cells) + 1);
    grid.cellStart[cells] = slot;
    std::atomic<bool> inside{true};
    tbb::parallel_for(range, [&](const auto& r) {
        cancel.check();
        for (std::size_t l = r.begin(); l < r.end() && inside; ++l) {
            if (!copyLeaf(source, leaves[l], grid.leaves[l], grid, cancel)) inside = false;
        }
    });
    if (inside) cancel.update(1);
    return inside;
}

} // namespace vdb_nns
