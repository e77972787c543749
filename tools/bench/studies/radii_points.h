// Particles with radii of their own for the study of radii.
#pragma once

#include "bench/bench_points.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct RadiiPoints {
    std::string name;       ///< what the radii are, e.g. "graded 1:100"
    std::vector<float> xyz; ///< what the view is of; empty where it is of the points given
    ParticleView view;
    std::vector<double> radii;
};

/// Radii over two decades about `radius`, each twice the spacing around its particle: shells of cubes about
/// the origin, one in the other, whose jittered faces are as fine as their distance asks, so that every
/// octave has as many particles. About `count`, at least 12. The same everywhere.
RadiiPoints gradedPoints(std::uint64_t count, double radius, std::uint64_t seed);

/// The points given, one in a hundred of them with a radius of four times `radius`.
RadiiPoints mixedPoints(const BenchPoints& points, double radius, std::uint64_t seed);

} // namespace vdb_nns::cli
