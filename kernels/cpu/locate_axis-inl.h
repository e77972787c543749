// LocateAxisFunction for the instruction set of the including file; the compiler makes vectors of it. Internal linkage.
#pragma once

#include "cpu/round_down-inl.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {
namespace {

bool locateAxis(const double* t, std::size_t count, double limit, std::int32_t* leaf, float* local)
{
    for (std::size_t i = 0; i < count; ++i) {
        const double number = roundDown(t[i] * 0.125);
        leaf[i] = clampedInteger(number);
        local[i] = static_cast<float>(t[i] - number * 8 - 4);
    }
    int outside = 0;
    for (std::size_t i = 0; i < count; ++i) outside |= !(t[i] < limit) | !(t[i] > -limit);
    return !outside;
}

} // namespace
} // namespace vdb_nns
