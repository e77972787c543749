// IEEE half floats.
#pragma once

#include <cstdint>
#include <cstring>

namespace vdb_nns {

// Exact: every half is a float.
inline float floatOfHalf(std::uint16_t half)
{
    const std::uint32_t sign = std::uint32_t(half & 0x8000u) << 16;
    const std::uint32_t magnitude = half & 0x7FFFu;
    std::uint32_t bits = 0;
    if (magnitude >= 0x7C00u) { // infinite or NaN
        bits = sign | 0x7F800000u | (magnitude & 0x3FFu) << 13;
    } else if (magnitude >= 0x400u) {
        bits = sign | ((magnitude << 13) + (std::uint32_t(127 - 15) << 23));
    } else {
        const float value = static_cast<float>(magnitude) * 0x1p-24f; // of which the exponent is the smallest
        return sign ? -value : value;
    }
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

} // namespace vdb_nns
