// Values of flags: text to numbers.
#include "cli_options.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <system_error>

namespace vdb_nns::cli {
namespace {

struct NumberAndUnit {
    double number;
    std::string unit;
};

// A number at the start and what follows it. strtod rounds to the nearest double.
NumberAndUnit splitNumber(const std::string& text, const std::string& flag)
{
    const char* begin = text.c_str();
    char* end = nullptr;
    const double number = std::strtod(begin, &end);
    if (end == begin || std::isspace(static_cast<unsigned char>(*begin))) {
        throw InvalidInput(flag + ": '" + text + "' is not a number");
    }
    return {number, std::string(end)};
}

std::string lowerCase(std::string text)
{
    for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return text;
}

// Past 2^63 a product of a flag cannot be meant.
std::uint64_t wholeNumber(double value, const std::string& text, const std::string& flag)
{
    if (!(value >= 0) || value >= 9.2e18) {
        throw InvalidInput(flag + ": '" + text + "' is out of range; give 0 to 9.2e18");
    }
    return static_cast<std::uint64_t>(value + 0.5);
}

} // namespace

std::uint64_t parseSize(const std::string& text, const std::string& flag)
{
    const NumberAndUnit parts = splitNumber(text, flag);
    const std::string unit = lowerCase(parts.unit);
    double factor = 1;
    if (!unit.empty() && unit != "b") {
        const std::size_t power = std::string("kmgt").find(unit[0]);
        const std::string rest = unit.substr(1);
        if (power == std::string::npos || (!rest.empty() && rest != "b" && rest != "ib")) {
            throw InvalidInput(flag + ": '" + text +
                               "' has no unit that is known; use KB MB GB TB (powers of 1000) or "
                               "K M G T KiB MiB GiB TiB (powers of 1024)");
        }
        factor = std::pow(rest == "b" ? 1000.0 : 1024.0, static_cast<double>(power + 1));
    }
    const std::uint64_t bytes = wholeNumber(parts.number * factor, text, flag);
    if (bytes == 0)
        throw InvalidInput(flag + ": '" + text + "' leaves no memory; give a size above 0, e.g. 4G");
    return bytes;
}

std::uint64_t parseCount(const std::string& text, const std::string& flag)
{
    std::uint64_t digits = 0; // plain digits are exact up to 2^64-1, e.g. seeds
    const char* const textEnd = text.data() + text.size();
    const std::from_chars_result parsed = std::from_chars(text.data(), textEnd, digits);
    if (parsed.ec == std::errc() && parsed.ptr == textEnd) return digits;

    const NumberAndUnit parts = splitNumber(text, flag);
    const std::string unit = lowerCase(parts.unit);
    double factor = 1;
    if (unit == "k") factor = 1e3;
    if (unit == "m") factor = 1e6;
    if (unit == "g") factor = 1e9;
    if (!unit.empty() && factor == 1) {
        throw InvalidInput(flag + ": '" + text +
                           "' is not a whole number; k, M and G are powers of 1000, e.g. 4M");
    }
    const std::uint64_t count = wholeNumber(parts.number * factor, text, flag);
    // 65.6 has no exact double: a part in 10^12 is rounding, more is a fraction of a particle.
    if (std::abs(parts.number * factor - static_cast<double>(count)) > 1e-12 * static_cast<double>(count)) {
        throw InvalidInput(flag + ": '" + text + "' is not a whole number");
    }
    return count;
}

std::uint64_t parseRange(const std::string& text, const std::string& flag, std::uint64_t low,
                         std::uint64_t high)
{
    const auto fail = [&] {
        throw InvalidInput(flag + ": '" + text + "' is not possible; give " + std::to_string(low) + " to " +
                           std::to_string(high));
    };
    const bool isNumber =
        !text.empty() && text.size() < 20 && // fits 64 bits
        std::all_of(text.begin(), text.end(), [](unsigned char c) { return std::isdigit(c); });
    if (!isNumber) fail();
    const std::uint64_t number = std::strtoull(text.c_str(), nullptr, 10);
    if (number < low || number > high) fail();
    return number;
}

double parseNumber(const std::string& text, const std::string& flag)
{
    const NumberAndUnit parts = splitNumber(text, flag);
    if (!parts.unit.empty()) throw InvalidInput(flag + ": '" + text + "' is not a number");
    if (!std::isfinite(parts.number)) throw InvalidInput(flag + ": '" + text + "' is not a finite number");
    return parts.number;
}

double parsePositive(const std::string& text, const std::string& flag)
{
    const double number = parseNumber(text, flag);
    if (!(number > 0)) {
        throw InvalidInput(flag + ": '" + text + "' is " + (number < 0 ? "negative" : "0 as a double") +
                           "; give a number above 0");
    }
    return number;
}

double parseCellSize(const std::string& text)
{
    const std::string flag = "--cell-size";
    if (text == "auto") return 0;
    if (text == "1/2") return 1.0 / 2;
    if (text == "1/3") return 1.0 / 3;
    const double size = parsePositive(text, flag);
    if (size < SearchOptions::kSmallestCell || size > SearchOptions::kLargestCell) {
        throw InvalidInput(flag + ": '" + text + "' radii is out of range; use auto, or 0.333 to 4");
    }
    return size;
}

} // namespace vdb_nns::cli
