// The whole number below, for code that the compiler makes vectors of. Internal linkage.
#pragma once

#include <cstdint>

namespace vdb_nns {
namespace {

// Of |t| < 2^51. Whole numbers go down to the even one of themselves and the one below. Adding and taking away 1.5 * 2^52 rounds
// to the nearest integer, also where there is no instruction for it.
inline double roundDown(double t)
{
    constexpr double kRound = 6755399441055744.0;
    return (t - 0.5 + kRound) - kRound;
}

// A whole number as an integer; what is beyond the range becomes its end, and NaN the lower one.
inline std::int32_t clampedInteger(double whole)
{
    constexpr double kLowest = -2147483648.0, kHighest = 2147483647.0;
    const double above = whole > kLowest ? whole : kLowest;
    return static_cast<std::int32_t>(above < kHighest ? above : kHighest);
}

} // namespace
} // namespace vdb_nns
