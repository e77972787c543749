// Sorts two sets on several lattices that nest, for radii of candidates that differ much: see search_sets_data.h.
#pragma once

#include "grid/search_sets_data.h"

#include <vector>

namespace vdb_nns {

// `sets`: with everything but parts and the numbers of particles. False, and nothing done, where no two of the lattices fit the
// particles. Throws as sortSets().
bool sortOnNestedLattices(const ParticleSet& candidates, const ParticleSet& queries,
                          const std::vector<RadiusClass>& classes, const SearchOptions& options,
                          GridScratch& scratch, SearchSetsData& sets);

} // namespace vdb_nns
