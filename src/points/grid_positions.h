// Where the points of a new grid go.
#pragma once

#include "vdb_nns/types.h"

#include <array>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// P, a float in voxels, from the centre of a voxel.
struct VoxelPosition {
    Vec3i voxel;
    std::array<float, 3> offset;
};

// Thread-safe. Both are called more than once for a point.
class GridPositions {
public:
    virtual ~GridPositions() = default;

    virtual std::size_t size() const = 0;
    virtual VoxelPosition at(std::size_t i) const = 0;
    // Of point i in the caller's arrays of values; it ascends with i.
    virtual std::uint32_t number(std::size_t i) const { return static_cast<std::uint32_t>(i); }
};

} // namespace vdb_nns
