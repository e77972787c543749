// What stands before the tree of a grid of a .vdb file: compression flags, metadata, transform.
#pragma once

#include "io/vdb/cursor.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

struct VdbMetadata {
    std::string name, type; // OpenVDB's name of the type: "string", "float", "double", "int32", ...
    std::string value;      // its bytes, little-endian
};

// The map from index to world space, for column vectors: world = linear * index + translation. For maps that are linear.
struct VdbTransform {
    std::string mapType; // OpenVDB's name: "UniformScaleMap", "AffineMap", ...
    bool isLinear = true;
    Matrix3 linear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Vec3d translation{};
    Vec3d voxelSize{1, 1, 1}; // as OpenVDB gives it
};

struct VdbGridHeader {
    std::uint32_t compression = 0; // VdbCompression
    std::vector<VdbMetadata> metadata;
    VdbTransform transform;

    // Null where there is none of that name.
    const VdbMetadata* find(const std::string& name) const;
};

// A count (4), then name, type, size (4) and value of each.
// @throws InputError also where the size is not that of the type
std::vector<VdbMetadata> readMetadata(VdbCursor& cursor);

// Leaves the cursor at the tree. Of a transform that is not linear only the type is kept.
// @throws InputError
VdbGridHeader readGridHeader(VdbCursor& cursor);

} // namespace vdb_nns
