// After openvdb/points/AttributeArray.h, AttributeArrayString.h and AttributeGroup.h; the types are those that
// openvdb::initialize() registers.
#include "io/vdb/attribute_type.h"

#include "io/half_float.h"

#include <algorithm>
#include <cstring>
#include <iterator>

namespace vdb_nns {

namespace {

struct ValueType {
    const char* name;
    VdbScalar scalar;
    std::size_t components;
};
constexpr ValueType kValueTypes[] = {
    {"bool", VdbScalar::kBool, 1},    {"int8", VdbScalar::kInt8, 1},    {"uint8", VdbScalar::kUint8, 1},
    {"int16", VdbScalar::kInt16, 1},  {"int32", VdbScalar::kInt32, 1},  {"uint32", VdbScalar::kUint32, 1},
    {"int64", VdbScalar::kInt64, 1},  {"float", VdbScalar::kFloat, 1},  {"double", VdbScalar::kDouble, 1},
    {"vec3i", VdbScalar::kInt32, 3},  {"vec3s", VdbScalar::kFloat, 3},  {"vec3d", VdbScalar::kDouble, 3},
    {"quats", VdbScalar::kFloat, 4},  {"quatd", VdbScalar::kDouble, 4}, {"mat3s", VdbScalar::kFloat, 9},
    {"mat3d", VdbScalar::kDouble, 9}, {"mat4s", VdbScalar::kFloat, 16}, {"mat4d", VdbScalar::kDouble, 16}};

struct Codec {
    const char* name;
    VdbCodec codec;
    const char *type, *otherType; // that it is for; null: any but uint8 and uint32
    std::size_t componentBytes;   // 0: those of the scalar
};
constexpr Codec kCodecs[] = {{"null", VdbCodec::kPlain, nullptr, nullptr, 0},
                             {"str", VdbCodec::kPlain, "uint32", nullptr, 0},
                             {"grp", VdbCodec::kPlain, "uint8", nullptr, 0},
                             {"trnc", VdbCodec::kHalf, "vec3s", "float", 2},
                             {"fxpt8", VdbCodec::kPosition8, "vec3s", nullptr, 1},
                             {"fxpt16", VdbCodec::kPosition16, "vec3s", nullptr, 2},
                             {"ufxpt8", VdbCodec::kUnit8, "vec3s", "float", 1},
                             {"ufxpt16", VdbCodec::kUnit16, "vec3s", "float", 2},
                             {"uvec", VdbCodec::kUnitVector, "vec3s", nullptr, 0}};
constexpr std::size_t kUnitVectorBytes = 2;

std::size_t scalarBytes(VdbScalar scalar)
{
    switch (scalar) {
    case VdbScalar::kBool:
    case VdbScalar::kInt8:
    case VdbScalar::kUint8:
        return 1;
    case VdbScalar::kInt16:
        return 2;
    case VdbScalar::kInt32:
    case VdbScalar::kUint32:
    case VdbScalar::kFloat:
        return 4;
    case VdbScalar::kInt64:
    case VdbScalar::kDouble:
        return 8;
    }
    return 0;
}

bool isFor(const Codec& codec, const std::string& type)
{
    if (!codec.type) return type != "uint8" && type != "uint32";
    return type == codec.type || (codec.otherType && type == codec.otherType);
}

template <typename Stored, typename Decode>
void decodeEach(const unsigned char* stored, std::size_t numbers, void* out, Decode&& decode)
{
    float* const values = static_cast<float*>(out);
    for (std::size_t i = 0; i < numbers; ++i) {
        Stored code;
        std::memcpy(&code, stored + i * sizeof code, sizeof code);
        values[i] = decode(code);
    }
}

} // namespace

std::size_t VdbAttributeType::bytes() const
{
    return components * scalarBytes(scalar);
}

VdbAttributeType attributeType(const std::string& valueType, const std::string& codecName)
{
    const auto* const type = std::find_if(std::begin(kValueTypes), std::end(kValueTypes),
                                          [&](const ValueType& known) { return valueType == known.name; });
    const auto* const codec = std::find_if(std::begin(kCodecs), std::end(kCodecs),
                                           [&](const Codec& known) { return codecName == known.name; });
    if (type == std::end(kValueTypes) || codec == std::end(kCodecs) || !isFor(*codec, valueType)) return {};
    VdbAttributeType result{true, type->scalar, codec->codec, type->components, 0};
    result.storedBytes = codec->codec == VdbCodec::kUnitVector ? kUnitVectorBytes
                         : codec->componentBytes               ? codec->componentBytes * type->components
                                                               : result.bytes();
    return result;
}

void decodeValues(const VdbAttributeType& type, const unsigned char* stored, std::size_t count, void* out)
{
    const std::size_t numbers = count * type.components;
    switch (type.codec) {
    case VdbCodec::kPlain:
        std::memcpy(out, stored, count * type.storedBytes);
        return;
    case VdbCodec::kHalf:
        return decodeEach<std::uint16_t>(stored, numbers, out, floatOfHalf);
    case VdbCodec::kPosition8:
        return decodeEach<std::uint8_t>(stored, numbers, out,
                                        [](std::uint8_t k) { return float(k) / 255.0f - 0.5f; });
    case VdbCodec::kPosition16:
        return decodeEach<std::uint16_t>(stored, numbers, out,
                                         [](std::uint16_t k) { return float(k) / 65535.0f - 0.5f; });
    case VdbCodec::kUnit8:
        return decodeEach<std::uint8_t>(stored, numbers, out,
                                        [](std::uint8_t k) { return float(k) / 255.0f; });
    case VdbCodec::kUnit16:
        return decodeEach<std::uint16_t>(stored, numbers, out,
                                         [](std::uint16_t k) { return float(k) / 65535.0f; });
    case VdbCodec::kUnitVector:
        return;
    }
}

} // namespace vdb_nns
