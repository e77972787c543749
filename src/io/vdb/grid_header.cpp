#include "io/vdb/grid_header.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>

namespace vdb_nns {

namespace {

// Sizes of values whose type OpenVDB knows. It reads so many bytes, whatever size stands in the file.
struct TypeSize {
    const char* type;
    std::size_t bytes;
};
constexpr TypeSize kTypeSizes[] = {{"bool", 1},   {"int32", 4},  {"int64", 8},  {"float", 4},
                                   {"double", 8}, {"vec2i", 8},  {"vec2s", 8},  {"vec2d", 16},
                                   {"vec3i", 12}, {"vec3s", 12}, {"vec3d", 24}, {"vec4i", 16},
                                   {"vec4s", 16}, {"vec4d", 32}, {"mat4s", 64}, {"mat4d", 128}};

Vec3d readVec3d(VdbCursor& cursor)
{
    Vec3d v;
    for (double& x : v) x = cursor.number<double>("the transform");
    return v;
}

// Rows of a matrix for row vectors, as OpenVDB has it.
void readAffineMap(VdbCursor& cursor, VdbTransform& transform)
{
    const std::uint64_t at = cursor.position();
    double m[4][4];
    for (auto& row : m) {
        for (double& x : row) x = cursor.number<double>("the transform");
    }
    if (m[0][3] != 0 || m[1][3] != 0 || m[2][3] != 0 || m[3][3] != 1)
        cursor.fail("a matrix whose last column is 0 0 0 1", at);
    for (int k = 0; k < 3; ++k) {
        double squares = 0;
        for (int c = 0; c < 3; ++c) {
            transform.linear[c][k] = m[k][c];
            const double edge = (m[k][c] + m[3][c]) - m[3][c]; // in OpenVDB's order of operations
            squares += edge * edge;
        }
        transform.translation[k] = m[3][k];
        transform.voxelSize[k] = std::sqrt(squares);
    }
}

// Scale, size of the voxels, and three products of the scale.
void readScale(VdbCursor& cursor, VdbTransform& transform)
{
    const Vec3d scale = readVec3d(cursor);
    transform.voxelSize = readVec3d(cursor);
    cursor.skip(3 * sizeof(Vec3d), "the transform");
    for (int k = 0; k < 3; ++k) transform.linear[k][k] = scale[k];
}

// A linear map. False where the type is none of them.
bool readLinearMap(VdbCursor& cursor, VdbTransform& transform)
{
    const std::string& type = transform.mapType;
    if (type == "AffineMap" || type == "UnitaryMap") {
        readAffineMap(cursor, transform);
    } else if (type == "ScaleMap" || type == "UniformScaleMap") {
        readScale(cursor, transform);
    } else if (type == "TranslationMap") {
        transform.translation = readVec3d(cursor);
    } else if (type == "ScaleTranslateMap" || type == "UniformScaleTranslateMap") {
        transform.translation = readVec3d(cursor);
        readScale(cursor, transform);
    } else {
        return false;
    }
    return true;
}

VdbTransform readTransform(VdbCursor& cursor)
{
    VdbTransform transform;
    std::uint64_t at = cursor.position();
    transform.mapType = cursor.text("the type of the transform");
    transform.isLinear = transform.mapType != "NonlinearFrustumMap";
    VdbTransform inner = transform;
    if (!transform.isLinear) { // a box, taper, depth, and a linear map
        cursor.skip((6 + 1 + 1) * sizeof(double), "the transform");
        at = cursor.position();
        inner.mapType = cursor.text("the type of the transform");
    }
    if (!readLinearMap(cursor, inner))
        cursor.fail("the type of a transform, not '" + inner.mapType + "',", at);
    return transform.isLinear ? inner : transform;
}

} // namespace

const VdbMetadata* VdbGridHeader::find(const std::string& name) const
{
    // Of several, OpenVDB keeps the last.
    const auto found = std::find_if(metadata.rbegin(), metadata.rend(),
                                    [&](const VdbMetadata& item) { return item.name == name; });
    return found == metadata.rend() ? nullptr : &*found;
}

std::vector<VdbMetadata> readMetadata(VdbCursor& cursor)
{
    std::vector<VdbMetadata> items;
    for (auto left = cursor.number<std::uint32_t>("the number of metadata"); left > 0; --left) {
        VdbMetadata item;
        item.name = cursor.text("the name of metadata");
        item.type = cursor.text("the type of metadata");
        const std::uint64_t at = cursor.position();
        item.value = cursor.text("the value of metadata");
        const auto size = std::find_if(std::begin(kTypeSizes), std::end(kTypeSizes),
                                       [&](const TypeSize& known) { return item.type == known.type; });
        if (size != std::end(kTypeSizes) && size->bytes != item.value.size()) {
            cursor.fail(std::to_string(size->bytes) + " bytes as the size of metadata '" + item.name +
                            "' of type " + item.type + ", not " + std::to_string(item.value.size()) + ",",
                        at);
        }
        items.push_back(std::move(item));
    }
    return items;
}

VdbGridHeader readGridHeader(VdbCursor& cursor)
{
    VdbGridHeader header;
    header.compression = cursor.number<std::uint32_t>("the compression");
    header.metadata = readMetadata(cursor);
    header.transform = readTransform(cursor);
    return header;
}

} // namespace vdb_nns
