// What the sources of grids have in common: which leaf a point is in, and where the middle of the leaves is.
#pragma once

#include "vdb_nns/types.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

// Number of the leaf that holds point i. starts: number of a leaf's first point, and one more at the end.
inline std::size_t leafOf(const std::vector<std::uint64_t>& starts, std::size_t i)
{
    // Neighbors mostly share their query's leaf. The hint is only a guess: it is checked against these starts.
    thread_local std::size_t hint = 0;
    if (hint + 1 < starts.size() && starts[hint] <= i && i < starts[hint + 1]) return hint;
    hint = static_cast<std::size_t>(std::upper_bound(starts.begin(), starts.end(), i) - starts.begin()) - 1;
    return hint;
}

// The middle of the origins of `count` leaves, integers: ParticleSource::reference(). origin(i) of each.
template <typename Origin>
Vec3d middleOfLeaves(std::size_t count, Origin&& origin)
{
    Vec3d middle{};
    if (count == 0) return middle;
    Vec3i low = origin(0), high = low;
    for (std::size_t i = 1; i < count; ++i) {
        const Vec3i at = origin(i);
        for (int k = 0; k < 3; ++k) {
            low[k] = std::min(low[k], at[k]);
            high[k] = std::max(high[k], at[k]);
        }
    }
    for (int k = 0; k < 3; ++k) middle[k] = static_cast<double>((std::int64_t(low[k]) + high[k]) / 2);
    return middle;
}

} // namespace vdb_nns
