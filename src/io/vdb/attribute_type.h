// Types and codecs of attributes, by the names that OpenVDB writes: how large a value is, and what it decodes to.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace vdb_nns {

// One number of a value.
enum class VdbScalar { kBool, kInt8, kUint8, kInt16, kInt32, kUint32, kInt64, kFloat, kDouble };

// How a value is stored.
enum class VdbCodec {
    kPlain,      // null; str: number of a text, 0 for the empty one; grp: a bit a group
    kHalf,       // trnc: IEEE half floats
    kPosition8,  // fxpt8: k / 255 - 1/2
    kPosition16, // fxpt16: k / 65535 - 1/2
    kUnit8,      // ufxpt8: k / 255
    kUnit16,     // ufxpt16: k / 65535
    kUnitVector  // uvec: a direction in 16 bits
};

struct VdbAttributeType {
    bool isKnown = false; // the rest is only then set
    VdbScalar scalar = VdbScalar::kFloat;
    VdbCodec codec = VdbCodec::kPlain;
    std::size_t components = 0;  // numbers of a value
    std::size_t storedBytes = 0; // of a value in the file

    // Of a decoded value.
    std::size_t bytes() const;
};

VdbAttributeType attributeType(const std::string& valueType, const std::string& codec);

// Decodes `count` values as OpenVDB does, to the bit: components one after the other, in the type of the scalar.
// Not for unit vectors and unknown types.
void decodeValues(const VdbAttributeType& type, const unsigned char* stored, std::size_t count, void* out);

} // namespace vdb_nns
