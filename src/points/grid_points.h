// Points of a VDB grid in plain arrays, as a reader leaves them: 14 bytes a point and 20 a leaf.
#pragma once

#include "util/memory.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <vector>

namespace vdb_nns {

struct GridPoints {
    // Index to world space, for column vectors.
    Matrix3 linear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Vec3d translation{};
    std::vector<Vec3i> leaves; // lowest voxel of each leaf with points, in the order of cbeginLeaf()
    std::vector<std::uint64_t> starts{0}; // number of a leaf's first point; one more at the end
    PageArray<float> positions;           // P: x y z of each point, in voxels, from the centre of its voxel
    PageArray<std::uint16_t> voxels;      // of each point, in its leaf: 64 x + 8 y + z; they ascend

    std::uint64_t size() const { return starts.back(); }
};

// Takes the points over.
ParticleView viewOf(GridPoints&& points);

} // namespace vdb_nns
