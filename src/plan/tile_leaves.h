// Leaves cut into tiles, whoever has them: a view in memory, or a file whose points are still to be read.
#pragma once

#include "vdb_nns/tiles.h"
#include "vdb_nns/types.h"

#include <array>
#include <cstdint>
#include <vector>

namespace vdb_nns {

struct TileLeaf {
    std::array<std::int64_t, 3> place; // in leaves
    std::uint64_t particles;           // not 0
};

// How a radius looks from the voxels of a grid.
struct TileGeometry {
    std::array<double, 3> voxels{}; // that the ball spans along each axis, from its middle; rounded up
    std::array<std::int64_t, 3> reach{1, 1, 1}; // the same in leaves
    double ballsEach = 0;   // volume of the ball of the radius over that of a box of so many leaves
    bool isReliable = true; // whether those could be worked out; a matrix may be next to singular
};
TileGeometry tileGeometry(const Matrix3& linear, double radius);

// Fills firstLeaf, endLeaf, particles and expectedPairs of as many tiles as there are. A particle is expected to have the neighbors that
// it would have if those of its box of `reach` leaves were spread evenly over the box.
void cutLeaves(const std::vector<TileLeaf>& leaves, const TileGeometry& geometry, std::vector<Tile>& tiles);

// A box of leaves, of one edge along each axis.
using TileBox = std::array<std::int64_t, 3>;

struct TileBoxHash {
    std::size_t operator()(const TileBox& box) const
    {
        std::uint64_t h = 0;
        for (const std::int64_t value : box)
            h = (h ^ static_cast<std::uint64_t>(value)) * 0x9E3779B97F4A7C15u;
        return static_cast<std::size_t>(h ^ (h >> 32));
    }
};

} // namespace vdb_nns
