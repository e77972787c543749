// The distributions that every executor test runs (house rule 16), as small seeded point sets with their radius. Every
// set mixes clear pairs with pairs close to the radius. Knows only the oracle's types.
#pragma once

#include "oracle.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns::testing {

enum class Precision { kFloat, kDouble };

// empty, one, two coincident, all coincident, lattice at exactly the radius, block, sheet, spray, clusters, two far
// islands, seam, far, non-finite, and pairs within a few ulps of the radius. Plain arrays: voxel 0, identity. With kFloat
// every coordinate is a float, so that the set is the same as an array of either type.
std::vector<PointSet> arraySets(Precision precision, std::uint64_t seed = 1);

// The same distributions as voxels and float offsets under several linear maps: identity, scale, non-uniform scale,
// rotation, shear, reflection, and a rotated non-uniform scale; and a set whose offsets leave their voxels.
std::vector<PointSet> gridSets(std::uint64_t seed = 1);

struct NamedLinear {
    const char* name;
    Linear linear;
};
const std::vector<NamedLinear>& linearMaps();

// Coordinates as x y z triples, for ParticleView::fromArray. Only for sets without voxels.
std::vector<double> doublesOf(const PointSet& set);
std::vector<float> floatsOf(const PointSet& set);

// The set with its points reordered by a seeded permutation; order[k] is the old number of new point k.
PointSet shuffled(const PointSet& set, std::uint64_t seed, std::vector<std::uint32_t>& order);

} // namespace vdb_nns::testing
