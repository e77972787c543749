// The truth: who is a neighbor, by brute force over all pairs in exact integer arithmetic. Shares nothing with the engine
// but the definition: i and j are neighbors iff i != j and |M ((voxel_j - voxel_i) + (offset_j - offset_i))| <= radius in
// real arithmetic. Hand-worked tests of its own: tests/support/test_oracle.cpp.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::testing {

using Linear = std::array<std::array<double, 3>, 3>; // rows, for column vectors

constexpr Linear kIdentity{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

// A position voxel + offset. Arrays: voxel 0, offset the position (floats widened). Grids: ijk and P.
struct ExactPoint {
    std::array<std::int64_t, 3> voxel{};
    std::array<double, 3> offset{};
};

// Points with the radius that they are meant to be searched with.
struct PointSet {
    std::string name;
    double radius = 0; // world units
    std::vector<ExactPoint> points;
    Linear linear = kIdentity;
};

using Lists = std::vector<std::vector<std::uint32_t>>; // ascending in each row

bool isFinite(const ExactPoint& point);

// Whether two finite points are within the radius of each other, in exact arithmetic alone.
bool withinExactly(const ExactPoint& a, const ExactPoint& b, const Linear& linear, double radius);

// The lists of all points. A test in double with a margin of 1e-6 decides the clear pairs; cost about 5 ns a pair and 10
// microseconds a pair inside the margin.
Lists oracleLists(const PointSet& set);

// For messages: the distance rounded to double, and (distance - radius) in ulps of the radius, from 100 digits.
struct PairReport {
    double distance;
    double ulps;
};
PairReport describePair(const PointSet& set, std::size_t i, std::size_t j);

} // namespace vdb_nns::testing
