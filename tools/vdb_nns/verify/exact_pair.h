// Distances of two particles without rounding: what verify does with pairs that double arithmetic cannot decide.
// Knows positions as ParticleSource stores them; shares nothing with the engine.
#pragma once

#include "vdb_nns/types.h"

#include <boost/multiprecision/cpp_int.hpp>

#include <cstdint>

namespace vdb_nns::cli {

// A stored position: voxel + offset.
struct StoredPoint {
    std::int64_t voxel[3];
    double offset[3];
};

// World position of a stored one: linear * stored + translation.
struct AffineMap {
    Matrix3 linear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Vec3d translation{};
};

// A particle of a set. Particles of one set have the same map, by address; its translation is then not read.
struct PlacedPoint {
    StoredPoint point;
    const AffineMap* map;
};

// A number of the form mantissa * 2^exponent: sums and products of doubles are such numbers.
struct Dyadic {
    boost::multiprecision::cpp_int mantissa;
    int exponent = 0;
};

// In real arithmetic; all numbers finite. About a microsecond for ordinary numbers.
Dyadic squaredDistance(const PlacedPoint& a, const PlacedPoint& b);

// -1, 0 or 1: which one is less.
int compare(const Dyadic& a, const Dyadic& b);

// Whether the distance is <= radius in real arithmetic; all numbers finite.
bool withinRadius(const PlacedPoint& a, const PlacedPoint& b, double radius);
// The same of two particles of one set.
bool withinRadius(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear, double radius);

// linear * voxel + translation - origin, each rounded once.
Vec3d worldOffset(const AffineMap& map, const std::int64_t voxel[3], const Vec3d& origin);

// The distance rounded from 50 digits, and (distance - radius) in ulps of the radius, NaN unless that is positive and
// finite. For messages.
struct PairDistance {
    double distance;
    double ulps;
};
PairDistance describeDistance(const PlacedPoint& a, const PlacedPoint& b, double radius);
// The same of two particles of one set.
PairDistance describeDistance(const StoredPoint& a, const StoredPoint& b, const Matrix3& linear,
                              double radius);

} // namespace vdb_nns::cli
