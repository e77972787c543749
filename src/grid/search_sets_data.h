// The two sets of a search, sorted: who asks and among whom, on one lattice, or in parts on several where radii differ much.
// Knows roles and radii; nothing of lists, and not who is a neighbor.
//
// Cells of the largest radius would hold crowds where radii are small: a lattice for each factor of two keeps cells about as wide
// as the radii that are searched in them. A query is in one part. Where the radii of queries decide, that is the part of its
// radius, and the candidates are those in leaves that touch one of its queries' leaves. Where radii of candidates count too, the
// lattices nest, and a part has candidates on its own lattice and on wider ones:
//   scatter    on each lattice the candidates of its radii. A query is on the narrowest lattice that has candidates near it
//   symmetric  on its own lattice those with radii up to that lattice's, on wider ones those of the lattice's radii
#pragma once

#include "grid/set_radii.h"
#include "grid/sparse_grid_data.h"
#include "shared/membership.h"
#include "util/memory.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/search_sets.h"

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace vdb_nns {

// Candidates on one lattice, and what the filter knows of the radii there.
struct SearchLayer {
    std::shared_ptr<const SparseGridData> candidates;
    // By slot: FilterBounds::far of each radius; null where one radius serves all, or those of the queries decide.
    std::shared_ptr<const PageArray<float>> candidateFar;
    FilterBounds bounds{};  // of the largest radius
    float nearestDoubt = 0; // scores further apart than this are ordered as the distances are
    float farOfQueries = 0; // FilterBounds::far of all queries, where they have no array
    int octaves = 0;        // cells are 2^octaves times as wide as those of the queries

    SearchLayer() = default;
    SearchLayer(std::shared_ptr<const SparseGridData> grid, const RadiusBounds& radius)
        : candidates(std::move(grid)), farOfQueries(radius.bounds.far)
    {
        setBounds(radius);
    }
    void setBounds(const RadiusBounds& radius)
    {
        bounds = radius.bounds;
        nearestDoubt = radius.nearestDoubt;
    }
};

struct SearchPart {
    std::shared_ptr<const SparseGridData> queries;
    std::shared_ptr<const PageArray<float>> queryFar; // as candidateFar; on the lattice of the queries
    SearchLayer own;                                  // on that too; the same grid where all have both roles
    std::vector<SearchLayer> wider;                   // ascending
    std::uint32_t firstRow = 0;                       // queries of the parts before
};

struct SearchSetsData {
    ParticleView queries, candidates;
    // As ParticleSet::chosen; these and the spans of `radius` belong to the caller.
    Span<const std::uint8_t> queryChosen, candidateChosen;
    Radius radius;
    double largestRadius = 0;      // of those that reach somebody
    std::vector<SearchPart> parts; // those with the widest cells first; one at least
    std::uint64_t lattices = 1;
    Lattice widest;                  // of the lattices
    std::uint64_t finiteQueries = 0; // of those that have the role
    std::uint64_t nonfiniteQueries = 0, nonfiniteCandidates = 0;

    // Whether a number means the same particle in both sets.
    bool areSameParticles() const { return &queries.source() == &candidates.source(); }
    // Whether a query is a candidate too.
    bool isCandidate(std::uint32_t query) const
    {
        return areSameParticles() && (candidateChosen.empty() || candidateChosen[query]);
    }
    // Queries that have a row of their own: of all parts.
    std::uint64_t rowCount() const;
    std::uint64_t gridBytes() const;
};

// The same sets within a smaller radius, one for all; 0: as they are. Throws InvalidInput for a larger one, and where particles have
// radii of their own.
SearchSets setsWithin(const SearchSets& sets, double radius);

// Sorts two sets for a radius. `options` as for SearchEngine::buildGrid(); hostMemoryBytes is for all grids together.
// Throws as that, and InvalidInput for spans of a wrong size.
SearchSetsData sortSets(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                        const SearchOptions& options, GridScratch& scratch);

} // namespace vdb_nns
