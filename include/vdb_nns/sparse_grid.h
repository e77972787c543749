// The sparse grid: particles sorted on a lattice, by leaf and cell, over the topology of an OpenVDB tree.
#pragma once

#include "vdb_nns/lattice.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <memory>

namespace vdb_nns {

struct SparseGridData; // src/grid/sparse_grid_data.h

/// Immutable; a cheap handle whose copies share the data. Safe to read from several threads.
///
/// Space is cut into the cells of lattice(). 8^3 cells are a leaf, and only occupied leaves exist. The tree
/// above them is OpenVDB's, with nodes of 128^3 and 4096^3 cells. Leaves stand in Morton order within a
/// 4096^3 node, so every octant of a node is a contiguous range of leaves. Inside a leaf the cells stand in
/// OpenVDB's linear order, (x * 8 + y) * 8 + z, and inside a cell the particles stand by number. A slot is a
/// particle's place in that order.
class SparseGrid {
public:
    /// An empty grid.
    SparseGrid();
    explicit SparseGrid(std::shared_ptr<const SparseGridData> data);

    struct Leaf {
        Vec3i origin;                ///< cell coordinates of the lowest cell
        std::uint64_t occupancy[8];  ///< bit 8 y + z of word x: the cell holds a particle
        std::uint64_t firstSlot;     ///< slot of its first particle
        std::uint64_t particleCount; ///< particles in the leaf
        std::uint64_t firstCell;     ///< occupied cells in all leaves before it
    };

    bool empty() const { return particleCount() == 0; }
    const Lattice& lattice() const;                    ///< where the cells are; other grids may share it
    double radius() const { return lattice().radius; } ///< the largest that a search may have; world units
    int reach() const { return lattice().reach; }      ///< cells that it spans, 1 to 3
    double cellSize() const { return lattice().cellSize; } ///< world units
    std::uint64_t particleCount() const;                   ///< particles in the grid: all finite ones
    std::uint64_t nonfiniteCount() const; ///< particles left out because a coordinate is NaN or infinite
    std::uint64_t leafCount() const;      ///< occupied leaves
    std::uint64_t cellCount() const;      ///< occupied cells
    std::uint64_t bytes() const;          ///< memory held, tree included

    /// @param index below leafCount(); not checked.
    Leaf leaf(std::uint64_t index) const;

    /// Particle numbers by slot. Valid while a handle of this grid lives.
    Span<const std::uint32_t> particleNumbers() const;

    const ParticleView& view() const;

    const SparseGridData& data() const { return *mData; }
    const std::shared_ptr<const SparseGridData>& sharedData() const { return mData; }

private:
    std::shared_ptr<const SparseGridData> mData;
};

} // namespace vdb_nns
