// Small formulas that commands share.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace vdb_nns::cli {

/// The middle value, or the mean of the two in the middle; `values` must not be empty.
inline double median(std::vector<double> values)
{
    std::sort(values.begin(), values.end());
    const std::size_t n = values.size();
    return n % 2 == 1 ? values[n / 2] : (values[n / 2 - 1] + values[n / 2]) / 2;
}

/// The first of ascending (value, weight) at which the weights sum to `weight`; 0 of none.
inline double weightedQuantile(const std::vector<std::pair<double, double>>& sorted, double weight)
{
    double sum = 0;
    for (const auto& [value, part] : sorted) {
        sum += part;
        if (sum >= weight) return value;
    }
    return sorted.empty() ? 0 : sorted.back().first;
}

/// The finaliser of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
inline std::uint64_t mix64(std::uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
}

} // namespace vdb_nns::cli
