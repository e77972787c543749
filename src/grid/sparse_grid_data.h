// What a SparseGrid holds: a lattice, and the particles of a view sorted on it. Plain arrays by slot, cell and leaf, and
// the tree. Knows nothing of lists, devices, and the radius of a search.
#pragma once

#include "grid/topology.h"
#include "shared/block_view.h"
#include "util/memory.h"
#include "vdb_nns/error.h"
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
    std::uint64_t nonfiniteCount = 0; // of those that were to be sorted
    std::uint64_t finiteCount =
        0; // the others: as many as slots, but for those that are too far from all of another set

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
    void neighborhoodsInReach(std::size_t first, std::size_t end, LeafNeighborhood* out) const
    {
        neighborhoodsInReach(*this, first, end, out);
    }
    // The same among the leaves of another grid on this lattice.
    void neighborhoodsInReach(const SparseGridData& candidates, std::size_t first, std::size_t end,
                              LeafNeighborhood* out) const;
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

// What NonFinite::kFail says of so many of some particles.
InputError nonfiniteParticles(std::uint64_t count, std::uint64_t particles);

// Which particles are sorted.
struct GridMembers {
    ParticleView view;
    Span<const std::uint8_t> chosen = {}; // by number, not 0 for those; empty: all
    // Only those near the leaves of this grid, on its lattice: in leaves that touch one of them. Others are left out, however far.
    const SparseGridData* around = nullptr;
    // In whose stored coordinates the lattice is; its own unless told.
    const ParticleSource* home = nullptr;
    bool mayUseVoxels = true; // as cells, where the lattice is chosen

    GridMembers(const ParticleView& particles) : view(particles) {} // NOLINT: all particles of a view
    bool areAll() const { return chosen.empty() && !around; }
};

// Sorts particles into `grid`, whose memory is reused: on a lattice, or on the one that suits them and a radius.
// Throw as SearchEngine::buildGrid().
void buildSparseGrid(const GridMembers& members, const Lattice& lattice, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid);
void buildSparseGrid(const GridMembers& members, double radius, const SearchOptions& options,
                     GridScratch& scratch, SparseGridData& grid);

} // namespace vdb_nns
