#include "io/vdb/tile_reader.h"

#include "io/array_readers.h"
#include "plan/tile_leaves.h"
#include "vdb_nns/error.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <unordered_set>
#include <utility>
#include <vector>

namespace vdb_nns {
namespace {

// A leaf that has points: where it is in the layout, and the box that its points are in.
struct SeenLeaf {
    std::size_t layoutLeaf;
    std::uint64_t firstPoint; // its number in the file
    std::uint32_t count;
    bool hasFinite;
    std::array<double, 3> low, high; // in voxels, of the finite points
};

using Boxes = std::unordered_set<TileBox, TileBoxHash>;

// The box of the points of a leaf.
void look(const GridPoints& points, std::size_t leaf, SeenLeaf& seen)
{
    seen.low.fill(HUGE_VAL);
    seen.high.fill(-HUGE_VAL);
    seen.hasFinite = false;
    const Vec3i& origin = points.leaves[leaf];
    for (std::uint64_t i = points.starts[leaf]; i < points.starts[leaf + 1]; ++i) {
        const int voxel = points.voxels[static_cast<std::size_t>(i)];
        const float* const p = points.positions.data() + 3 * i;
        const double at[3] = {double(origin[0]) + (voxel >> 6) + double(p[0]),
                              double(origin[1]) + (voxel >> 3 & 7) + double(p[1]),
                              double(origin[2]) + (voxel & 7) + double(p[2])};
        if (!std::isfinite(at[0]) || !std::isfinite(at[1]) || !std::isfinite(at[2])) continue;
        seen.hasFinite = true;
        for (std::size_t k = 0; k < 3; ++k) {
            seen.low[k] = std::min(seen.low[k], at[k]);
            seen.high[k] = std::max(seen.high[k], at[k]);
        }
    }
}

class TileReader {
public:
    TileReader(const VdbPointReader& reader, const VdbPointLayout& layout, const CancelCheck& cancel)
        : mReader(reader), mLayout(layout), mCancel(cancel)
    {
    }

    // All leaves, piece by piece.
    void lookAtAll(const std::string& path, std::uint64_t allowedBytes)
    {
        constexpr std::uint64_t kPieceBytes = std::uint64_t(8) << 20;
        GridPoints piece;
        for (std::size_t begin = 0; begin < mLayout.leaves.size();) {
            mCancel.check();
            std::size_t end = begin + 1;
            std::uint64_t bytes = mReader.pointBytes({begin, end});
            while (end < mLayout.leaves.size()) {
                bytes += mReader.pointBytes({end, end + 1});
                if (bytes > kPieceBytes) break;
                ++end;
            }
            checkPointsFit(path, mReader.pointBytes({begin, end}), allowedBytes);
            mReader.readPoints({begin, end}, mCancel, piece);
            const std::size_t first = mSeen.size();
            mSeen.resize(first + piece.leaves.size());
            std::size_t layoutLeaf = begin;
            for (std::size_t leaf = 0; leaf < piece.leaves.size(); ++leaf) {
                while (mLayout.leaves[layoutLeaf] != piece.leaves[leaf]) ++layoutLeaf;
                SeenLeaf& seen = mSeen[first + leaf];
                seen.layoutLeaf = layoutLeaf++;
                seen.firstPoint = mTotal + piece.starts[leaf];
                seen.count = static_cast<std::uint32_t>(piece.starts[leaf + 1] - piece.starts[leaf]);
            }
            tbb::parallel_for(std::size_t(0), piece.leaves.size(),
                              [&](std::size_t leaf) { look(piece, leaf, mSeen[first + leaf]); });
            mTotal += piece.size();
            begin = end;
        }
    }

    std::uint64_t total() const { return mTotal; }

    Tile cut(const TileOfFile& which, const TileGeometry& geometry) const
    {
        std::vector<TileLeaf> leaves;
        for (const SeenLeaf& seen : mSeen) {
            const Vec3i& origin = mLayout.leaves[seen.layoutLeaf];
            leaves.push_back({{origin[0] >> 3, origin[1] >> 3, origin[2] >> 3}, seen.count});
        }
        std::vector<Tile> tiles(which.tiles);
        cutLeaves(leaves, geometry, tiles);
        return tiles[which.tile - 1];
    }

    // The leaves to read, as ranges of mSeen.
    std::vector<VdbLeafRange> near(const Tile& tile, const TileGeometry& geometry) const
    {
        // Leaves that are read on the way, rather than to stop and begin again.
        constexpr std::size_t kGap = 32;
        const auto isNear = nearness(tile, geometry);
        std::vector<VdbLeafRange> ranges;
        for (std::size_t i = 0; i < mSeen.size(); ++i) {
            if (!isNear(i)) continue;
            if (ranges.empty() || i - ranges.back().end > kGap) ranges.push_back({i, i});
            ranges.back().end = i + 1;
        }
        return ranges;
    }

    // Appends the points of the ranges.
    TileNumbers read(const std::vector<VdbLeafRange>& ranges, const Tile& tile, GridPoints& points) const
    {
        TileNumbers result;
        result.total = mTotal;
        std::uint64_t count = 0;
        for (const VdbLeafRange& range : ranges) count += pointsOf(range);
        points.voxels.resizeDiscarding(static_cast<std::size_t>(count));
        points.positions.resizeDiscarding(3 * static_cast<std::size_t>(count));
        result.numbers.resize(static_cast<std::size_t>(count));
        std::size_t done = 0;
        GridPoints piece;
        for (const VdbLeafRange& range : ranges) {
            mCancel.check();
            mReader.readPoints({mSeen[range.begin].layoutLeaf, mSeen[range.end - 1].layoutLeaf + 1}, mCancel,
                               piece);
            const auto size = static_cast<std::size_t>(piece.size());
            std::copy_n(piece.voxels.data(), size, points.voxels.data() + done);
            std::copy_n(piece.positions.data(), 3 * size, points.positions.data() + 3 * done);
            for (std::size_t i = 0; i < size; ++i)
                result.numbers[done + i] = static_cast<std::uint32_t>(mSeen[range.begin].firstPoint + i);
            for (std::size_t leaf = 0; leaf < piece.leaves.size(); ++leaf) {
                const std::size_t seen = range.begin + leaf;
                if (seen == tile.firstLeaf)
                    result.begin = done + static_cast<std::size_t>(piece.starts[leaf]);
                if (seen + 1 == tile.endLeaf)
                    result.end = done + static_cast<std::size_t>(piece.starts[leaf + 1]);
                points.leaves.push_back(piece.leaves[leaf]);
                points.starts.push_back(done + piece.starts[leaf + 1]);
            }
            done += size;
        }
        return result;
    }

    std::uint64_t pointsOf(const VdbLeafRange& range) const
    {
        const SeenLeaf& last = mSeen[range.end - 1];
        return last.firstPoint + last.count - mSeen[range.begin].firstPoint;
    }

private:
    // Whether leaf i of mSeen may have a point within the radius of one of the tile: by boxes that are at least as wide as the
    // radius, those with points of the tile and their neighbors.
    std::function<bool(std::size_t)> nearness(const Tile& tile, const TileGeometry& geometry) const
    {
        const auto isOwn = [tile](std::size_t i) { return i >= tile.firstLeaf && i < tile.endLeaf; };
        if (tile.firstLeaf == tile.endLeaf) return [](std::size_t) { return false; };
        const auto all = [](std::size_t) { return true; };
        std::array<double, 3> edges{};
        for (std::size_t k = 0; k < 3; ++k) edges[k] = std::max(8.0, geometry.voxels[k]);
        if (!geometry.isReliable) return all;
        Boxes own;
        for (std::size_t i = tile.firstLeaf; i < tile.endLeaf; ++i) {
            if (!forEachBox(mSeen[i], edges, [&](const TileBox& box) {
                    own.insert(box);
                    return false;
                }))
                return all;
        }
        auto boxes = std::make_shared<Boxes>();
        for (const TileBox& box : own) {
            for (int n = 0; n < 27; ++n)
                boxes->insert({box[0] + n / 9 - 1, box[1] + n / 3 % 3 - 1, box[2] + n % 3 - 1});
        }
        return [this, isOwn, edges, boxes](std::size_t i) {
            if (isOwn(i)) return true;
            bool found = false;
            const bool isLooked = forEachBox(mSeen[i], edges, [&](const TileBox& box) {
                found = boxes->count(box) > 0;
                return found;
            });
            return found || !isLooked;
        };
    }

    // f(box) for the boxes that the points of a leaf may be in, until it returns true. False for a leaf whose points are too far
    // apart for that.
    template <typename F>
    static bool forEachBox(const SeenLeaf& leaf, const std::array<double, 3>& edges, const F& f)
    {
        constexpr double kMostBoxes = 512, kFarthest = 1e15;
        if (!leaf.hasFinite) return true;
        TileBox low{}, high{};
        double boxes = 1;
        for (std::size_t k = 0; k < 3; ++k) {
            // Half a voxel on, the points of a leaf are in one box of 8 voxels.
            const double from = std::floor((leaf.low[k] + 0.5) / edges[k]),
                         to = std::floor((leaf.high[k] + 0.5) / edges[k]);
            boxes *= to - from + 1;
            if (!(boxes <= kMostBoxes) || !(std::fabs(from) < kFarthest)) return false;
            low[k] = static_cast<std::int64_t>(from);
            high[k] = static_cast<std::int64_t>(to);
        }
        for (std::int64_t x = low[0]; x <= high[0]; ++x) {
            for (std::int64_t y = low[1]; y <= high[1]; ++y) {
                for (std::int64_t z = low[2]; z <= high[2]; ++z) {
                    if (f(TileBox{x, y, z})) return true;
                }
            }
        }
        return true;
    }

    const VdbPointReader& mReader;
    const VdbPointLayout& mLayout;
    const CancelCheck& mCancel;
    std::vector<SeenLeaf> mSeen; // in the order of the file
    std::uint64_t mTotal = 0;
};

} // namespace

TileNumbers readTile(const VdbPointReader& reader, const VdbPointLayout& layout, const std::string& path,
                     const TileOfFile& which, std::uint64_t allowedBytes, const CancelCheck& cancel,
                     GridPoints& points)
{
    constexpr std::uint64_t kPointBytes = 3 * sizeof(float) + sizeof(std::uint16_t) + sizeof(std::uint32_t);
    TileReader tiles(reader, layout, cancel);
    tiles.lookAtAll(path, allowedBytes);
    if (tiles.total() > std::numeric_limits<std::uint32_t>::max()) {
        throw InputError(path + ": " + std::to_string(tiles.total()) +
                         " points are more than their numbers can count (4294967295): split the grid");
    }
    const TileGeometry geometry = tileGeometry(points.linear, which.radius);
    const Tile tile = tiles.cut(which, geometry);
    const std::vector<VdbLeafRange> ranges = tiles.near(tile, geometry);
    std::uint64_t count = 0;
    for (const VdbLeafRange& range : ranges) count += tiles.pointsOf(range);
    checkPointsFit(path, kPointBytes * count, allowedBytes);
    return tiles.read(ranges, tile, points);
}

} // namespace vdb_nns
