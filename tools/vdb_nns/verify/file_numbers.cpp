#include "file_numbers.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>

namespace vdb_nns::cli {

namespace {

constexpr std::uint64_t kMostExactInteger = std::uint64_t(1) << 53;

// IEEE 754 binary16: a sign, 5 bits of exponent with bias 15, 10 bits of fraction.
double halfOf(std::uint64_t bits)
{
    const int exponent = static_cast<int>(bits >> 10 & 31), fraction = static_cast<int>(bits & 1023);
    const double sign = bits >> 15 ? -1 : 1;
    if (exponent == 31)
        return fraction ? std::numeric_limits<double>::quiet_NaN()
                        : sign * std::numeric_limits<double>::infinity();
    if (exponent == 0) return sign * std::ldexp(fraction, -24);
    return sign * std::ldexp(1024 + fraction, exponent - 25);
}

double floatOfBits(std::uint64_t bits, unsigned bytes)
{
    if (bytes == 2) return halfOf(bits);
    if (bytes == 8) {
        double value;
        std::memcpy(&value, &bits, sizeof value);
        return value;
    }
    const auto low = static_cast<std::uint32_t>(bits);
    float value;
    std::memcpy(&value, &low, sizeof value);
    return value;
}

std::optional<double> microsoftNumber(const std::string& text)
{
    const std::size_t lastOfName = text.find_last_not_of('0');
    const std::string name = text.substr(0, lastOfName == std::string::npos ? 0 : lastOfName + 1);
    const double infinity = std::numeric_limits<double>::infinity();
    if (name == "1.#INF") return infinity;
    if (name == "-1.#INF") return -infinity;
    for (const char* nan : {"1.#QNAN", "1.#SNAN", "1.#IND", "1.#NAN"}) {
        if (name == nan || name == std::string("-") + nan) return std::numeric_limits<double>::quiet_NaN();
    }
    return std::nullopt;
}

template <typename Real>
std::optional<double> parsed(const std::string& text, Real (*parse)(const char*, char**))
{
    if (text.empty() || text.find_first_of("xX \t\n\v\f\r") != std::string::npos) return std::nullopt;
    char* end = nullptr;
    const Real value = parse(text.c_str(), &end);
    if (end != text.c_str() + text.size()) return microsoftNumber(text);
    const bool saysInfinite = text.find_first_of("iI") != std::string::npos;
    if (std::isinf(value) && !saysInfinite) return std::nullopt;
    return value;
}

} // namespace

bool isNumberType(NumberType type)
{
    const bool isInteger = type.kind == 'i' || type.kind == 'u';
    return ((isInteger && type.bytes == 1) || ((isInteger || type.kind == 'f') && type.bytes == 2) ||
            ((isInteger || type.kind == 'f') && (type.bytes == 4 || type.bytes == 8)));
}

std::optional<double> numberAt(const char* first, NumberType type, bool isBigEndian)
{
    std::uint64_t bits = 0;
    for (unsigned k = 0; k < type.bytes; ++k)
        bits = bits << 8 | static_cast<unsigned char>(first[isBigEndian ? k : type.bytes - 1 - k]);
    if (type.kind == 'f') return floatOfBits(bits, type.bytes);
    const bool isNegative = type.kind == 'i' && bits >> (8 * type.bytes - 1);
    if (isNegative && type.bytes < 8) bits |= ~std::uint64_t(0) << (8 * type.bytes);
    const std::uint64_t magnitude = isNegative ? 0 - bits : bits;
    if (magnitude > kMostExactInteger) return std::nullopt;
    return isNegative ? -static_cast<double>(magnitude) : static_cast<double>(magnitude);
}

std::optional<double> numberOf(const std::string& text)
{
    return parsed<double>(text, std::strtod);
}

std::optional<double> floatOf(const std::string& text)
{
    return parsed<float>(text, std::strtof);
}

bool LineReader::next(std::string& line)
{
    if (mAt > mBlock.size()) {
        if (!std::getline(mStream, mBlock)) return false;
        mAt = 0;
        if (!mBlock.empty() && mBlock.back() == '\r') mBlock.pop_back();
    }
    const std::size_t end = std::min(mBlock.find('\r', mAt), mBlock.size());
    line.assign(mBlock, mAt, end - mAt);
    mAt = end + 1;
    return true;
}

} // namespace vdb_nns::cli
