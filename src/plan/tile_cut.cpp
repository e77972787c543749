// Cuts particles into tiles. Knows leaves and how many particles they hold; looks at positions only where there are no leaves, in
// arrays.
#include "plan/tile_leaves.h"

#include "points/particle_source.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_sort.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_map>
#include <utility>

namespace vdb_nns {
namespace {

using LeafCoord = std::array<std::int64_t, 3>; // in leaves

constexpr std::int64_t kEdge = 8;          // of a leaf, in voxels or cells
constexpr double kBall = 4.18879020478639; // volume of the ball of radius 1, 4 pi / 3

// The order of a VDB tree: by the nodes of 512^3 leaves, then of 16^3, then leaves; x before y before z in each.
std::array<LeafCoord, 3> treeOrder(const LeafCoord& leaf)
{
    constexpr int kLog2Lower = 4, kLog2Upper = 9;
    std::array<LeafCoord, 3> order{};
    for (std::size_t k = 0; k < 3; ++k)
        order[0][k] = leaf[k] >> kLog2Upper, order[1][k] = leaf[k] >> kLog2Lower;
    order[2] = leaf;
    return order;
}

double determinant(const Matrix3& m)
{
    return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
           m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
}

// A number of leaves from a quotient that may be anything.
std::int64_t boundedFloor(double value)
{
    constexpr double kMost = 1e15; // doubles are whole numbers below; farther leaves are one
    if (!(value >= -kMost)) return -static_cast<std::int64_t>(kMost);
    return static_cast<std::int64_t>(std::floor(std::min(value, kMost)));
}

// The box of leaves that a leaf is in.
TileBox boxOf(const LeafCoord& leaf, const std::array<std::int64_t, 3>& reach)
{
    TileBox box{};
    for (std::size_t k = 0; k < 3; ++k)
        box[k] = leaf[k] >= 0 ? leaf[k] / reach[k] : -((reach[k] - 1 - leaf[k]) / reach[k]);
    return box;
}

using BoxCounts = std::unordered_map<TileBox, std::uint64_t, TileBoxHash>;

BoxCounts countBoxes(const std::vector<TileLeaf>& leaves, const std::array<std::int64_t, 3>& reach)
{
    BoxCounts particles;
    for (const TileLeaf& leaf : leaves) particles[boxOf(leaf.place, reach)] += leaf.particles;
    return particles;
}

// Of the particles of a leaf, in whose box there are so many.
std::uint64_t pairsOf(std::uint64_t particles, std::uint64_t inBox, double ballsEach)
{
    constexpr double kMost = 9007199254740992.0; // 2^53
    const double pairs = static_cast<double>(particles) * (static_cast<double>(inBox) - 1);
    return static_cast<std::uint64_t>(std::min(std::max(pairs * std::min(ballsEach, 1.0), 0.0), kMost));
}

std::vector<TileLeaf> leavesOfGrid(const ParticleSource& source)
{
    std::vector<TileLeaf> leaves(source.fileLeafCount());
    for (std::size_t i = 0; i < leaves.size(); ++i) {
        const FileLeaf leaf = source.fileLeaf(i);
        for (std::size_t k = 0; k < 3; ++k) leaves[i].place[k] = leaf.origin[k] >> 3;
        leaves[i].particles = leaf.count;
    }
    return leaves;
}

// Also the numbers of the particles, leaf by leaf.
std::vector<TileLeaf> leavesOfArray(const ParticleSource& source, double radius, const CancelCheck& cancel,
                                    std::vector<std::uint32_t>& numbers)
{
    struct Placed {
        LeafCoord place;
        std::uint32_t number;
    };
    constexpr std::size_t kBlock = 4096;
    std::vector<Placed> placed(source.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, placed.size(), kBlock), [&](const auto& range) {
        cancel.check();
        for (std::size_t i = range.begin(); i < range.end(); ++i) {
            const StoredPosition position = source.stored(i);
            for (std::size_t k = 0; k < 3; ++k)
                placed[i].place[k] = boundedFloor(position.offset[k] / (kEdge * radius));
            placed[i].number = static_cast<std::uint32_t>(i);
        }
    });
    tbb::parallel_sort(placed.begin(), placed.end(), [](const Placed& a, const Placed& b) {
        if (a.place == b.place) return a.number < b.number;
        return treeOrder(a.place) < treeOrder(b.place);
    });
    cancel.check();
    std::vector<TileLeaf> leaves;
    numbers.resize(placed.size());
    for (std::size_t i = 0; i < placed.size(); ++i) {
        if (leaves.empty() || leaves.back().place != placed[i].place) leaves.push_back({placed[i].place, 0});
        ++leaves.back().particles;
        numbers[i] = placed[i].number;
    }
    return leaves;
}

// Particles near each tile, by boxes of leaves as wide as the radius: those of a tile's boxes and of their neighbors that are not its
// own.
void findHalos(const std::vector<TileLeaf>& leaves, const std::array<std::int64_t, 3>& reach,
               std::vector<Tile>& tiles)
{
    const BoxCounts particles = countBoxes(leaves, reach);
    tbb::parallel_for(std::size_t(0), tiles.size(), [&](std::size_t t) {
        std::unordered_map<LeafCoord, bool, TileBoxHash> near; // boxes
        Tile& tile = tiles[t];
        for (std::uint64_t i = tile.firstLeaf; i < tile.endLeaf; ++i) {
            const TileBox box = boxOf(leaves[static_cast<std::size_t>(i)].place, reach);
            if (!near.emplace(box, true).second && near[box]) continue;
            near[box] = true;
            for (int n = 0; n < 27; ++n) {
                const LeafCoord other{box[0] + n / 9 - 1, box[1] + n / 3 % 3 - 1, box[2] + n % 3 - 1};
                if (particles.count(other) > 0) near.emplace(other, false);
            }
        }
        std::uint64_t all = 0;
        for (const auto& box : near) all += particles.at(box.first);
        tile.haloParticles = all - tile.particles;
    });
}

} // namespace

TileGeometry tileGeometry(const Matrix3& m, double radius)
{
    // What rounding may take from a product of nearly parallel vectors.
    constexpr double kLeast = 1e-6, kMargin = 1 + 1e-6;
    TileGeometry geometry;
    const double volume = std::fabs(determinant(m));
    double boxVolume = kEdge * kEdge * kEdge * volume;
    double edges = 1; // product of the lengths of the columns
    for (std::size_t k = 0; k < 3; ++k)
        edges *= std::sqrt(m[0][k] * m[0][k] + m[1][k] * m[1][k] + m[2][k] * m[2][k]);
    geometry.isReliable = volume >= kLeast * edges;
    for (std::size_t k = 0; k < 3; ++k) {
        // |row k of the inverse| = |cross product of the other two columns| / |det|: voxels along axis k a world unit.
        const std::size_t i = (k + 1) % 3, j = (k + 2) % 3;
        const double x = m[1][i] * m[2][j] - m[2][i] * m[1][j], y = m[2][i] * m[0][j] - m[0][i] * m[2][j],
                     z = m[0][i] * m[1][j] - m[1][i] * m[0][j];
        geometry.voxels[k] = kMargin * radius * std::sqrt(x * x + y * y + z * z) / volume;
        geometry.isReliable = geometry.isReliable && std::isfinite(geometry.voxels[k]);
        geometry.reach[k] = boundedFloor(geometry.voxels[k] / kEdge) + 1;
        boxVolume *= static_cast<double>(geometry.reach[k]);
    }
    geometry.ballsEach = kBall * radius * radius * radius / boxVolume;
    return geometry;
}

void cutLeaves(const std::vector<TileLeaf>& leaves, const TileGeometry& geometry, std::vector<Tile>& tiles)
{
    const BoxCounts counts = countBoxes(leaves, geometry.reach);
    std::vector<std::uint64_t> pairs(leaves.size());
    unsigned __int128 total = 0, before = 0;
    for (std::size_t i = 0; i < leaves.size(); ++i) {
        const std::uint64_t inBox = counts.at(boxOf(leaves[i].place, geometry.reach));
        pairs[i] = pairsOf(leaves[i].particles, inBox, geometry.ballsEach);
        total += leaves[i].particles + pairs[i];
    }
    std::size_t next = 0;
    for (std::size_t t = 0; t < tiles.size(); ++t) {
        Tile& tile = tiles[t];
        tile.firstLeaf = next;
        // Leaves whose middle is before the end of the tile's share.
        for (; next < leaves.size(); ++next) {
            const unsigned __int128 work = leaves[next].particles + pairs[next];
            if (t + 1 < tiles.size() && (2 * before + work) * tiles.size() >= 2 * total * (t + 1)) break;
            before += work;
            tile.particles += leaves[next].particles;
            tile.expectedPairs += pairs[next];
        }
        tile.endLeaf = next;
    }
}

TileCut::TileCut(const ParticleView& view, double radius, std::uint32_t tiles, Progress* progress)
{
    constexpr std::uint64_t kGridBytes = 24, kRowBytes = 16,
                            kPairBytes = 4; // of a particle, a query and a pair
    if (!(radius >= 0) || !std::isfinite(radius))
        throw InvalidInput("a cut into tiles: the radius is negative or not finite");
    if (radius == 0) radius = 1; // nobody has a neighbor, wherever the cuts are
    if (tiles == 0) throw InvalidInput("a cut into 0 tiles has room for no particle; give 1 or more");
    const CancelCheck cancel(progress, "tiles");
    const ParticleSource& source = view.source();
    isolatedIeee([&] {
        const std::vector<TileLeaf> leaves =
            source.isArray() ? leavesOfArray(source, radius, cancel, mNumbers) : leavesOfGrid(source);
        TileGeometry geometry; // of an array, whose leaves have an edge of 8 radii
        geometry.ballsEach = kBall / (kEdge * kEdge * kEdge);
        if (!source.isArray()) geometry = tileGeometry(source.linear(), radius);
        mTiles.resize(tiles);
        cutLeaves(leaves, geometry, mTiles);
        cancel.check();
        findHalos(leaves, geometry.reach, mTiles);
    });
    mBegins.push_back(0);
    for (Tile& tile : mTiles) {
        tile.bytes = kGridBytes * (tile.particles + tile.haloParticles) + kRowBytes * tile.particles +
                     kPairBytes * tile.expectedPairs;
        mBegins.push_back(mBegins.back() + tile.particles);
    }
}

std::vector<std::uint32_t> TileCut::particles(std::uint32_t tile) const
{
    const std::uint64_t begin = mBegins[tile], end = mBegins[tile + 1];
    std::vector<std::uint32_t> result(static_cast<std::size_t>(end - begin));
    for (std::size_t i = 0; i < result.size(); ++i) {
        const std::uint64_t place = begin + i;
        result[i] =
            mNumbers.empty() ? static_cast<std::uint32_t>(place) : mNumbers[static_cast<std::size_t>(place)];
    }
    if (!mNumbers.empty()) tbb::parallel_sort(result.begin(), result.end());
    return result;
}

} // namespace vdb_nns
