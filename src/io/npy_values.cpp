// Arrays of one value a point: their types and shapes, and their values in any byte order and order of indices.
#include "io/half_float.h"
#include "io/npy_header.h"
#include "io/number_type.h"
#include "util/memory.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kMostWidth = 10;
// Rows that a task converts.
constexpr std::size_t kTaskRows = std::size_t(1) << 16;

// Numbers of a row; as many as no value has, if it is more.
std::uint64_t widthOf(const NpyHeader& header)
{
    std::uint64_t width = 1;
    for (std::size_t i = 1; i < header.shape.size(); ++i)
        width = std::min(width * std::min(header.shape[i], kMostWidth), kMostWidth);
    return width;
}

// The type that rows are read as; empty where none holds them.
std::optional<AttributeType> readableType(const NpyHeader& header)
{
    const NpyType& type = header.type;
    const std::vector<std::uint64_t>& shape = header.shape;
    const std::uint64_t width = widthOf(header);
    const bool isMatrix =
        (shape.size() == 2 && width == 9) || (shape.size() == 3 && shape[1] == 3 && shape[2] == 3);
    if (shape.size() > 2 && !isMatrix) return std::nullopt;
    if (type.isFloat()) {
        const bool isDouble = type.bytes == 8;
        if (width == 1) return isDouble ? AttributeType::kDouble : AttributeType::kFloat;
        if (width == 3) return isDouble ? AttributeType::kVec3d : AttributeType::kVec3s;
        if (isMatrix && !isDouble) return AttributeType::kMat3s;
        return std::nullopt;
    }
    const bool isNumber = type.isInteger() || (type.kind == 'b' && type.bytes == 1);
    if (!isNumber || width != 1) return std::nullopt;
    const bool isSmall = type.bytes < 4 || (type.bytes == 4 && type.kind == 'i');
    return isSmall ? AttributeType::kInt32 : AttributeType::kInt64;
}

// The values of an array whose rows are values of points.
struct ValueArray {
    const ArrayFile& file;
    const NpyHeader& header;

    // As numbers of a type that holds them, row by row.
    template <typename To>
    void read(To* out) const
    {
        const NpyType& type = header.type;
        if (type.kind == 'f') {
            if (type.bytes == 2)
                return convert<std::uint16_t>(out, [](auto bits) { return floatOfHalf(bits); });
            return type.bytes == 4 ? copy<float>(out) : copy<double>(out);
        }
        const bool isSigned = type.kind == 'i';
        switch (type.bytes) {
        case 1:
            return isSigned ? copy<std::int8_t>(out) : copy<std::uint8_t>(out);
        case 2:
            return isSigned ? copy<std::int16_t>(out) : copy<std::uint16_t>(out);
        case 4:
            return isSigned ? copy<std::int32_t>(out) : copy<std::uint32_t>(out);
        default:
            return isSigned ? copy<std::int64_t>(out) : copyLarge(out);
        }
    }

private:
    template <typename From, typename To>
    void copy(To* out) const
    {
        convert<From>(out, [](From value) { return value; });
    }

    template <typename To>
    void copyLarge(To* out) const
    {
        convert<std::uint64_t>(out, [&](std::uint64_t value) {
            if (value > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()))
                throw InputError(file.path + ": holds " + std::to_string(value) +
                                 ", which is beyond 2^63-1, the largest int64; leave it out");
            return value;
        });
    }

    template <typename From, typename To, typename Convert>
    void convert(To* out, const Convert& converted) const
    {
        const auto rows = static_cast<std::size_t>(header.shape[0]);
        const auto width = static_cast<std::size_t>(widthOf(header));
        const bool isBig = header.type.isBigEndian(), isSquare = header.shape.size() == 3;
        const unsigned char* const values = file.bytes.data() + header.dataOffset;
        tbb::parallel_for(std::size_t(0), (rows + kTaskRows - 1) / kTaskRows, [&](std::size_t task) {
            file.cancel.check();
            const std::size_t end = std::min(rows, (task + 1) * kTaskRows);
            for (std::size_t row = task * kTaskRows; row < end; ++row) {
                for (std::size_t k = 0; k < width; ++k) {
                    // In Fortran's order the first index runs fastest.
                    const std::size_t column = isSquare ? k / 3 + 3 * (k % 3) : k;
                    const std::size_t at = header.fortranOrder ? column * rows + row : row * width + k;
                    out[row * width + k] =
                        static_cast<To>(converted(loadNumber<From>(values + at * sizeof(From), isBig)));
                }
            }
        });
    }
};

} // namespace

StoredValue describeNpyValues(const std::string& path, const std::string& name, FileBytes bytes,
                              std::uint64_t points)
{
    const NpyHeader header = readNpyHeader(path, bytes);
    const NpyType& type = header.type;
    std::string shape;
    for (std::size_t i = 0; i < header.shape.size(); ++i)
        shape += (i ? ", " : "") + std::to_string(header.shape[i]);
    StoredValue value;
    value.name = name;
    value.type = (header.isStructured() ? "records" : escapedText(header.descr)) + " (" + shape + ")";
    if (header.isStructured()) {
        value.problem = "holds records";
    } else if (header.shape.empty() || header.shape[0] != points) {
        value.problem = "has the shape " + npyShapeText(header.shape) + ", not a value for each of " +
                        std::to_string(points) + " points";
    } else if (type.kind == 'b' && type.bytes == 1 && widthOf(header) == 1) {
        value.isGroup = true;
    } else {
        value.readAs = readableType(header);
        if (!value.readAs)
            value.problem = "has the dtype '" + shownText(header.descr) + "' and the shape " +
                            npyShapeText(header.shape) +
                            ", which is none of float, double, int32, int64, vec3s, vec3d and mat3s";
    }
    return value;
}

void readNpyValues(const ArrayFile& file, const StoredValue& which, std::uint64_t points, PointValues& values)
{
    const NpyHeader header = readNpyHeader(file.path, file.bytes);
    checkNpySize(file.path, header, file.bytes.size() - header.dataOffset);
    const ValueArray from{file, header};
    const auto count = static_cast<std::size_t>(points);
    if (which.isGroup) {
        const auto members = std::make_shared<std::vector<std::uint8_t>>(count);
        from.read(members->data());
        values.groups.push_back({which.name, points, {members, members->data()}});
        return;
    }
    const auto owner = std::make_shared<PageBlock>(count * attributeBytes(*which.readAs));
    switch (*which.readAs) {
    case AttributeType::kFloat:
    case AttributeType::kVec3s:
    case AttributeType::kMat3s:
        from.read(static_cast<float*>(owner->data()));
        break;
    case AttributeType::kDouble:
    case AttributeType::kVec3d:
        from.read(static_cast<double*>(owner->data()));
        break;
    case AttributeType::kInt32:
        from.read(static_cast<std::int32_t*>(owner->data()));
        break;
    case AttributeType::kInt64:
        from.read(static_cast<std::int64_t*>(owner->data()));
        break;
    }
    values.attributes.push_back({which.name, *which.readAs, points, {owner, owner->data()}});
}

} // namespace vdb_nns
