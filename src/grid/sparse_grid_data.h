// What a SparseGrid holds: a lattice, and the particles of a view sorted on it. Plain arrays by slot, cell and leaf, and
// the tree. Knows nothing of lists, devices, and the radius of a search.
#pragma once

#include "grid/topology.h"
#include "shared/block_view.h"
#include "util/memory.h"
#include "vdb_nns/lattice.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

struct SparseGridData {
    ParticleView view;
    Lattice lattice;
    double coordinateError =
        0; // bound, in cells, on computed minus true cell coordinates, before rounding to float
    std::uint64_t nonfiniteCount = 0;

    // By slot: position about the leaf's centre in cells, |.| <= 4, and the particle's number.
    PageArray<float> x, y, z;
    PageArray<std::uint32_t> number;

    std::vector<Vec3i> leafOrigins;     // cell coordinates
    std::vector<LeafRecord> leaves;     // one more than leaves: the end
    PageArray<std::uint32_t> cellStart; // first slot of each occupied cell; one more: the end
    Topology topology;

    std::size_t leafCount() const { return leafOrigins.size(); }
    std::size_t particleCount() const { return number.size(); }
    std::uint64_t bytes() const;
    int reach() const { return lattice.reach; }

    // Of the leaves [first, end), the leaves around that hold cells in reach of theirs; on sparse scenes few. Finds what a
    // search reads: a leaf that no cell reaches has no candidates.
    void neighborhoodsInReach(std::size_t first, std::size_t end, LeafNeighborhood* out) const;
};

// Memory of the sort, kept from frame to frame.
struct GridScratch {
    struct Record {
        float x, y, z;
        std::uint32_t number;
    };
    PageArray<Record> records;
    PageArray<std::uint32_t> leafOf; // by particle; later starts of cells by slot
};

// Throws CapacityError when a grid with the leaves of `grid`, so many particles and at least so many cells cannot fit
// beside the memory of its sort. Before its arrays are made; `heldBytes` of all that are there already.
struct GridNeed {
    std::size_t particles = 0, cells = 0;
    std::uint64_t sortBytes = 0, heldBytes = 0;
};
void checkGridCapacity(const SparseGridData& grid, const GridNeed& need, std::uint64_t hostMemoryBytes);

// Sorts the particles of `view` into `grid`, whose memory is reused: on a lattice, or on the one that suits them and a radius.
// Throw as SearchEngine::buildGrid().
void buildSparseGrid(const ParticleView& view, const Lattice& lattice, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid);
void buildSparseGrid(const ParticleView& view, double radius, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid);

// Whether the cells of one are those of the other: particles of both can be searched for each other.
bool shareLattice(const SparseGridData& a, const SparseGridData& b);

} // namespace vdb_nns
