// The types of numbers that files declare: their sizes, and their values from raw bytes and from text.
#pragma once

#include "util/shown_text.h"

#include <charconv>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>
#include <type_traits>

namespace vdb_nns {

enum class NumberType { kInt8, kUInt8, kInt16, kUInt16, kInt32, kUInt32, kInt64, kUInt64, kFloat, kDouble };

// Calls use(zero of that type).
template <typename Use>
auto withNumberType(NumberType type, Use&& use)
{
    switch (type) {
    case NumberType::kInt8:
        return use(std::int8_t());
    case NumberType::kUInt8:
        return use(std::uint8_t());
    case NumberType::kInt16:
        return use(std::int16_t());
    case NumberType::kUInt16:
        return use(std::uint16_t());
    case NumberType::kInt32:
        return use(std::int32_t());
    case NumberType::kUInt32:
        return use(std::uint32_t());
    case NumberType::kInt64:
        return use(std::int64_t());
    case NumberType::kUInt64:
        return use(std::uint64_t());
    case NumberType::kFloat:
        return use(float());
    default:
        return use(double());
    }
}

inline std::size_t sizeOf(NumberType type)
{
    return withNumberType(type, [](auto zero) { return sizeof zero; });
}

inline bool isReal(NumberType type)
{
    return type == NumberType::kFloat || type == NumberType::kDouble;
}

template <typename Number>
Number loadNumber(const unsigned char* from, bool isBigEndian)
{
    Number value;
    if (!isBigEndian || sizeof value == 1) {
        std::memcpy(&value, from, sizeof value);
        return value;
    }
    if constexpr (sizeof value == 2) {
        std::uint16_t bits;
        std::memcpy(&bits, from, sizeof bits);
        bits = __builtin_bswap16(bits);
        std::memcpy(&value, &bits, sizeof value);
    } else if constexpr (sizeof value == 4) {
        std::uint32_t bits;
        std::memcpy(&bits, from, sizeof bits);
        bits = __builtin_bswap32(bits);
        std::memcpy(&value, &bits, sizeof value);
    } else if constexpr (sizeof value == 8) {
        std::uint64_t bits;
        std::memcpy(&bits, from, sizeof bits);
        bits = __builtin_bswap64(bits);
        std::memcpy(&value, &bits, sizeof value);
    }
    return value;
}

// Whether a double holds every integer up to this one exactly. Reals always are.
template <typename Number>
bool isExactInDouble(Number value)
{
    constexpr std::int64_t kMost = std::int64_t(1) << 53;
    if constexpr (std::is_same_v<Number, std::int64_t>) return value >= -kMost && value <= kMost;
    if constexpr (std::is_same_v<Number, std::uint64_t>) return value <= std::uint64_t(kMost);
    return true;
}

// ------------------------------------------------------------------------------------------------ text

inline bool isTextSpace(char c)
{
    return c == ' ' || (c >= '\t' && c <= '\r');
}

inline const char* endOfToken(const char* next, const char* end)
{
    while (next != end && !isTextSpace(*next)) ++next;
    return next;
}

// What is not finite is spelled in many ways: nan, inf and infinity in any case, nan(ind), and 1.#QNAN,
// 1.#IND or 1.#INF00 by Microsoft's older library. Returns false for any other text.
template <typename Real>
bool readNonfinite(std::string_view text, Real& value)
{
    const bool isNegative = !text.empty() && text[0] == '-';
    if (!text.empty() && (text[0] == '-' || text[0] == '+')) text.remove_prefix(1);
    std::string name;
    for (const char c : text.substr(0, 16)) name += static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c);
    if (name.compare(0, 3, "1.#") == 0) {
        name.erase(0, 3);
        while (name.size() > 3 && name.back() == '0') name.pop_back();
    }
    for (const char* const infinite : {"inf", "infinity"}) {
        if (name != infinite) continue;
        value = std::numeric_limits<Real>::infinity();
        if (isNegative) value = -value;
        return true;
    }
    for (const char* const known : {"nan", "qnan", "snan", "ind", "nan(ind)", "nan(snan)", "nan(qnan)"}) {
        if (name != known) continue;
        value = std::numeric_limits<Real>::quiet_NaN();
        return true;
    }
    return false;
}

// Whether a number that is written out of its type's range is too large; else it is too small, which is zero.
// By its digits alone: the C library reads points as the locale says.
inline bool isTooLarge(std::string_view text)
{
    std::int64_t power = 0; // of ten, of the first digit that is not zero
    bool isBehindPoint = false, hasDigit = false;
    std::size_t i = 0;
    for (; i < text.size() && text[i] != 'e' && text[i] != 'E'; ++i) {
        if (text[i] == '.') {
            isBehindPoint = true;
        } else if (text[i] >= '0' && text[i] <= '9') {
            hasDigit = hasDigit || text[i] != '0';
            if (hasDigit && !isBehindPoint) ++power;
            if (!hasDigit && isBehindPoint) --power;
        }
    }
    if (i == text.size()) return power > 0;
    text.remove_prefix(i + 1);
    if (!text.empty() && text[0] == '+') text.remove_prefix(1);
    std::int64_t exponent = 0;
    const std::from_chars_result result = std::from_chars(text.data(), text.data() + text.size(), exponent);
    if (result.ec == std::errc::result_out_of_range) return text[0] != '-';
    return exponent > -power; // the exponent of text is any 64-bit number, a power is small
}

constexpr const char* kIsNoNumber = "is not a number";
constexpr const char* kIsNoInteger = "is not an integer";
constexpr const char* kIsOutOfRange = "is beyond its type's range";
constexpr const char* kIsInexact = "is an integer beyond 2^53, which no double holds exactly";

// Reads the number of type `Number` that the text from `next` to a space or `end` is, and nothing less.
// Returns null, and `next` stands behind it, or what is wrong with that text, and `next` stays. Reals are the
// nearest of their type.
template <typename Number, typename Real>
const char* readTextNumber(const char*& next, const char* end, Real& out)
{
    const char* first = next;
    if (*first == '+' && first + 1 != end && first[1] != '-' && first[1] != '+')
        ++first; // from_chars takes no plus
    Number value{};
    const std::from_chars_result result = std::from_chars(first, end, value);
    if (result.ec == std::errc() && (result.ptr == end || isTextSpace(*result.ptr))) {
        if (!isExactInDouble(value)) return kIsInexact;
        out = static_cast<Real>(value);
        next = result.ptr;
        return nullptr;
    }
    const char* const last = endOfToken(next, end);
    const bool isWhole = result.ec == std::errc::result_out_of_range && result.ptr == last;
    if constexpr (std::is_floating_point_v<Number>) {
        const std::string_view text(first, static_cast<std::size_t>(last - first));
        if (isWhole) {
            if (isTooLarge(text)) return kIsOutOfRange;
            value = text[0] == '-' ? -Number(0) : Number(0);
        } else if (!readNonfinite(text, value)) {
            return kIsNoNumber;
        }
        out = static_cast<Real>(value);
        next = last;
        return nullptr;
    } else {
        return isWhole ? kIsOutOfRange : kIsNoInteger;
    }
}

template <typename Real>
const char* readTextNumber(NumberType type, const char*& next, const char* end, Real& out)
{
    return withNumberType(type,
                          [&](auto zero) { return readTextNumber<decltype(zero), Real>(next, end, out); });
}

} // namespace vdb_nns
