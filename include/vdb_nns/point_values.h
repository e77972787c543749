// Named values of points, as files hold them beside the positions: attributes and groups.
#pragma once

#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns {

/// Types of attributes, as OpenVDB names them.
enum class AttributeType {
    kFloat,
    kDouble,
    kInt32,
    kInt64,
    kVec3s, ///< three floats
    kVec3d, ///< three doubles
    kMat3s  ///< nine floats, row by row
};

/// "float", "double", "int32", "int64", "vec3s", "vec3d" or "mat3s".
const char* attributeTypeName(AttributeType type);

/// Numbers of one value: 1, 3 or 9.
std::size_t attributeWidth(AttributeType type);

/// Bytes of one value.
std::size_t attributeBytes(AttributeType type);

/// One value a point, in the order of the points' numbers. Copies share the values.
struct PointAttribute {
    std::string name;
    AttributeType type = AttributeType::kFloat;
    std::uint64_t count = 0; ///< points
    std::shared_ptr<const void>
        values; ///< `count` of them, one after the other, aligned as their numbers are
};

/// An attribute whose values are the caller's, who keeps them alive and unchanged as long as it is used.
PointAttribute viewAttribute(std::string name, AttributeType type, const void* values, std::uint64_t count);

/// Which points are in a group. Copies share the members.
struct PointGroup {
    std::string name;
    std::uint64_t count = 0;                     ///< points
    std::shared_ptr<const std::uint8_t> members; ///< of each point: not 0 if it is in the group
};

/// A group whose members are the caller's, who keeps them alive and unchanged as long as it is used.
PointGroup viewGroup(std::string name, Span<const std::uint8_t> members);

/// What points have beside their positions.
struct PointValues {
    std::vector<PointAttribute> attributes;
    std::vector<PointGroup> groups;
};

} // namespace vdb_nns
