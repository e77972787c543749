// The tree of a grid of a .vdb file: a root, internal nodes of 32^3 and 16^3 children, leaves of 8^3 voxels.
#pragma once

#include "io/vdb/cursor.h"
#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

// The values that a tree has at each voxel.
struct VdbVoxelType {
    std::size_t bytes = 0;       // in memory
    std::size_t storedBytes = 0; // in the file
    bool isHalf = false;         // real values that are stored in 16 bits
};

// Reads the topology of a tree: the origins of its leaves, in the order of cbeginLeaf(), which is that of their buffers.
// Values of the upper nodes (tiles) hold no points and are passed over.
// @throws InputError
std::vector<Vec3i> readTopology(VdbCursor& cursor, const VdbVoxelType& voxels, std::uint32_t compression);

// Passes over the tree of a volume with one number or vector a voxel. A stream needs it, for it does not say where a grid
// ends.
// @throws InputError also for a type that it does not know
void skipVolume(VdbCursor& cursor, const std::string& gridType, bool savesHalf, std::uint32_t compression);

} // namespace vdb_nns
