// The weights of neighbors by their distance, as the definition of the measures has them, in long double. Shares nothing with
// the engine.
#pragma once

#include "vdb_nns/measure.h"

namespace vdb_nns::cli {

using Real = long double;

// A weight, and what computing it in doubles may change. `most` is that of distance 0.
struct Weight {
    Real value, most;
    Real error; // from `distanceError`
};

// @param distanceError how far a computed distance may be from the true one
Weight smoothingWeight(SmoothingKernel kernel, Real distance, Real radius, Real distanceError);

// 1 - (d / R)^3: that of `pca`.
Weight pcaWeight(Real distance, Real radius, Real distanceError);

} // namespace vdb_nns::cli
