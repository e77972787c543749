// Two particles against the radius without rounding: what verify does with pairs that double arithmetic cannot decide.
// Knows positions as ParticleSource stores them; shares nothing with the engine.
#pragma once

#include "vdb_nns/types.h"

#include <cstdint>

namespace vdb_nns::cli {

// A stored position: voxel + offset.
struct StoredPoint {
    std::int64_t voxel[3];
    double offset[3];
};

// |linear * (b - a)| <= radius in real arithmetic; all numbers finite. A microsecond for ordinary numbers.
bool withinRadius(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear, double radius);

// The distance rounded from 50 digits, and (distance - radius) in ulps of the radius. For messages.
struct PairDistance {
    double distance;
    double ulps;
};
PairDistance describeDistance(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear,
                              double radius);

} // namespace vdb_nns::cli
