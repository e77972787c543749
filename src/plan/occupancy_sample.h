// A rough estimate from a few leaves, for asking whether everything fits at once with room to spare.
#pragma once

#include "grid/sparse_grid_data.h"
#include "vdb_nns/planning/work_estimate.h"

namespace vdb_nns {

// Every leaf the same work per particle: the mean of some leaves, drawn with their particles as weights. Its leaves' tests and
// masks are exact, their pairs those of particles spread evenly over the cells in reach.
void probeWork(const SparseGridData& grid, double radius, WorkEstimate& estimate);

} // namespace vdb_nns
