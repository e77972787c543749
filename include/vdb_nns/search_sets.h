// Queries and candidates, sorted for a radius: what a search runs on.
#pragma once

#include "vdb_nns/particle_set.h"
#include "vdb_nns/sparse_grid.h"

#include <cstdint>
#include <memory>

namespace vdb_nns {

struct SearchSetsData; // src/grid/search_sets_data.h

/// Immutable; a cheap handle whose copies share the data. Safe to read from several threads. Made by SearchEngine::sort(), or
/// of one grid, whose particles are queries and candidates then.
///
/// Where radii differ by more than a factor of two, queries and candidates are sorted on several lattices; a query is on one of them,
/// a candidate may be on several. Figures of leaves, cells and bytes are sums over lattices.
class SearchSets {
public:
    /// Nobody.
    SearchSets() : SearchSets(SparseGrid()) {}
    /// All particles of a grid.
    /// @param radius of the search, at most the grid's; 0: the grid's.
    /// @throws InvalidInput for a radius that is negative, not finite or above the grid's
    SearchSets(const SparseGrid& grid, double radius = 0); // NOLINT: a grid is both sets
    explicit SearchSets(std::shared_ptr<const SearchSetsData> data) : mData(std::move(data)) {}

    std::uint64_t rowCount() const;    ///< particles of the queries' view: rows of the lists
    std::uint64_t columnCount() const; ///< particles of the candidates' view
    const ParticleView& queries() const;
    const ParticleView& candidates() const;

    double radius() const;   ///< the largest that reaches anybody; world units
    double cellSize() const; ///< of the lattice of the largest radius
    int reach() const;       ///< of that lattice: cells that the radius spans
    std::uint64_t leafCount() const;
    std::uint64_t cellCount() const;
    std::uint64_t latticeCount() const;
    std::uint64_t finiteQueries() const;    ///< of those that have the role
    std::uint64_t nonfiniteQueries() const; ///< they have no neighbors
    std::uint64_t nonfiniteCandidates() const;
    std::uint64_t bytes() const;

    const SearchSetsData& data() const { return *mData; }
    const std::shared_ptr<const SearchSetsData>& sharedData() const { return mData; }

private:
    std::shared_ptr<const SearchSetsData> mData;
};

} // namespace vdb_nns
