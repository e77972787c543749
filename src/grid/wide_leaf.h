// Where a leaf of one lattice is on a lattice of wider cells that nests with it. See shared/wide_place.h.
#pragma once

#include "shared/wide_place.h"
#include "vdb_nns/types.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace vdb_nns {

struct WideLeaf {
    Vec3i origin; // of the wide leaf, in its cells
    WidePlace place;
};

// `origin`: of the leaf, in its cells, which are 2^octaves times as narrow, octaves > 0.
inline WideLeaf wideLeafOf(const Vec3i& origin, int octaves)
{
    constexpr int kMost = 40; // all cell coordinates are in the leaves at 0 and -1 then
    const int shift = std::min(octaves, kMost);
    WideLeaf leaf;
    leaf.place.bits = std::min(octaves, 3);
    leaf.place.scale = static_cast<float>(std::ldexp(1.0, -octaves));
    for (int axis = 0; axis < 3; ++axis) {
        const std::int64_t narrow = origin[axis], wide = (narrow >> shift) & ~std::int64_t(7),
                           within = narrow - wide * (std::int64_t(1) << shift);
        leaf.origin[axis] = static_cast<std::int32_t>(wide);
        leaf.place.cell[axis] = static_cast<std::int32_t>(shift < 3 ? within : (within >> shift) * 8);
        // The centre of the leaf is four cells from its corner, that of the wide leaf from its own.
        const double center = std::ldexp(static_cast<double>(narrow) + 4, -octaves);
        leaf.place.shift[axis] = static_cast<float>(center - (static_cast<double>(wide) + 4));
    }
    return leaf;
}

} // namespace vdb_nns
