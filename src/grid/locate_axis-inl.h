// LocateAxisFunction for the instruction set of the including file; the compiler makes vectors of it. Internal linkage.
#pragma once

#include <cstddef>
#include <cstdint>

namespace vdb_nns {
namespace {

bool locateAxis(const double* t, std::size_t count, double limit, std::int32_t* leaf, float* local)
{
    // Adding and taking away 1.5 * 2^52 rounds to the nearest integer, also where there is no instruction for it.
    constexpr double kRound = 6755399441055744.0;
    for (std::size_t i = 0; i < count; ++i) {
        const double number = (t[i] * 0.125 - 0.5 + kRound) - kRound;
        leaf[i] = static_cast<std::int32_t>(number);
        local[i] = static_cast<float>(t[i] - number * 8 - 4);
    }
    int outside = 0;
    for (std::size_t i = 0; i < count; ++i) outside |= !(t[i] < limit) | !(t[i] > -limit);
    return !outside;
}

} // namespace
} // namespace vdb_nns
