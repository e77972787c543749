// How large the voxels of a new grid are, where the caller leaves it open.
#pragma once

#include "io/world_positions.h"
#include "util/cancel.h"

namespace vdb_nns {

// A new grid's voxels have coordinates within this: beyond it, the leaves and nodes around them would pass 32 bits.
constexpr double kMostVoxels = 2147483648.0 - 4096.0;

// The least edge with which every finite position has a voxel; 0 without one.
double leastVoxelSize(const PositionFacts& facts);

// The edge with which an occupied voxel has 8 points on average, in three decimal digits, or a larger one that the
// extent asks for. Where points coincide so that the smallest voxels have more, the largest edge with little more than
// these. It depends on the positions alone, not on their order. Cost: a pass over the positions for each of some
// ten edges.
double chooseVoxelSize(const WorldPositions& positions, const PositionFacts& facts,
                       const CancelCheck& cancel);

} // namespace vdb_nns
