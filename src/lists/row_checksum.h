// What a row adds to the checksum of lists: NeighborLists::checksum().
#pragma once

#include "vdb_nns/types.h"

#include <cstdint>

namespace vdb_nns {

// The finalizer of SplitMix64 (Steele, Lea, Flood 2014).
inline std::uint64_t mix64(std::uint64_t x)
{
    x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9u;
    x = (x ^ x >> 27) * 0x94D049BB133111EBu;
    return x ^ x >> 31;
}

inline std::uint64_t rowChecksum(std::uint64_t row, Span<const std::uint32_t> neighbors)
{
    std::uint64_t sum = 0;
    for (const std::uint32_t neighbor : neighbors) sum += mix64(row << 32 | neighbor);
    return sum;
}

} // namespace vdb_nns
