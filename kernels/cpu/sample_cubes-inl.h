// SampleCubesFunction for the instruction set of the including file; the compiler makes vectors of it. Internal linkage.
#pragma once

#include "cpu/round_down-inl.h"

#include <cstddef>
#include <cstdint>

namespace vdb_nns {
namespace {

void sampleCubes(const double* x, const double* y, const double* z, std::size_t count,
                 const double (*rows)[3], std::uint32_t last, std::uint8_t* drawn)
{
    constexpr std::uint32_t kOdd[3] = {0x9E3779B1u, 0x85EBCA77u, 0xC2B2AE3Du};
    for (std::size_t i = 0; i < count; ++i) {
        std::uint32_t h = 0x6A09E667u; // so that no cube has lot 0 for its coordinates' sake
        for (int k = 0; k < 3; ++k) {
            const double t = rows[k][0] * x[i] + rows[k][1] * y[i] + rows[k][2] * z[i];
            h ^= static_cast<std::uint32_t>(clampedInteger(roundDown(t))) * kOdd[k];
        }
        h = (h ^ h >> 15) * 0x2C1B3C6Du;
        drawn[i] = (h ^ h >> 13) <= last;
    }
}

} // namespace
} // namespace vdb_nns
