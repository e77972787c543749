// What one does without radii of particles, or without the nearest within a radius: methods of the studies of
// these. None promises exact pairs. They answer runSets() alone, of one set.
#pragma once

#include "bench/method.h"

#include <memory>

namespace vdb_nns::cli {

/// The largest radius for all, then every row filtered by the radius of each pair; or full lists, then every
/// row sorted by distance and cut. Distances in double, equal ones by number. The engine searches.
std::unique_ptr<Method> makeFilteredMethod(const SearchOptions& options);

/// A uniform search for each octave of radii, with the largest radius in it: of queries where theirs decide,
/// of candidates where those do, both where the larger does. Its rows hold all that these find; their time is
/// that of the searches alone.
std::unique_ptr<Method> makeOctaveMethod(const SearchOptions& options);

} // namespace vdb_nns::cli
