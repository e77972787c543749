// Methods of `bench` that are not the engine: parts left out, approximations, peers. None of them promises exact pairs, and
// nothing outside the bench uses them.
#pragma once

#include "bench/method.h"

#include <memory>
#include <string>

namespace vdb_nns::cli {

/// kAblation:
///   certified     this search (methods/ablation_search-inl.h) with every part: the control of those below
///   filter-only   float32 about the leaf's centre as the engine's filter has it; no band, no double or exact test
///   world-float   float32 world positions, differences of those
///   world-double  double world positions, differences of those
///   codec16, codec8   positions stored as OpenVDB's fxpt16 and fxpt8 store them in voxels; then the exact engine
/// kApproximate:
///   sampledP      a query tests P percent of its candidates, drawn once for all queries of a cell (of a slab of cells
///                 where particles are sparse) by a hash of the cell and the candidate. Counts times 100 / P are right on
///                 average; rows are not symmetric
///   nearestK      the K nearest neighbors of each query, ties by number
/// @param voxelSize world edge of the voxels for the codecs
std::unique_ptr<Method> makeAblationMethod(const MethodSpec& spec, const SearchOptions& options,
                                           double voxelSize);

/// kPeer: openvdb (PointIndexGrid and PointIndexFilter), nanoflann-float, nanoflann-double, treensearch,
/// brute-force (double).
/// @throws InvalidInput for one that this program was built without, with what to install
std::unique_ptr<Method> makePeerMethod(const MethodSpec& spec);

/// Empty if the peer is built in; else a sentence that says what is missing and what to install.
std::string missingPeer(const std::string& family);

} // namespace vdb_nns::cli
