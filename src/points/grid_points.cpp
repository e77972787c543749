#include "points/grid_points.h"

#include "points/leaf_lookup.h"
#include "points/particle_source.h"

#include <algorithm>
#include <memory>
#include <utility>

namespace vdb_nns {

namespace {

class GridPointsSource final : public ParticleSource {
public:
    explicit GridPointsSource(GridPoints&& points) : mPoints(std::move(points))
    {
        mSize = static_cast<std::size_t>(mPoints.size());
        mLinear = mPoints.linear;
        mTranslation = mPoints.translation;
        mIsArray = false;
        mReference =
            middleOfLeaves(mPoints.leaves.size(), [this](std::size_t i) { return mPoints.leaves[i]; });
    }

    StoredPosition stored(std::size_t i) const override
    {
        const Vec3i& origin = mPoints.leaves[leafOf(mPoints.starts, i)];
        const int voxel = mPoints.voxels[i];
        const float* const p = mPoints.positions.data() + 3 * i;
        return {{std::int64_t(origin[0]) + (voxel >> 6), std::int64_t(origin[1]) + (voxel >> 3 & 7),
                 std::int64_t(origin[2]) + (voxel & 7)},
                {p[0], p[1], p[2]}};
    }

    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override
    {
        if (count == 0) return;
        std::size_t leaf = leafOf(mPoints.starts, begin);
        const float* p = mPoints.positions.data() + 3 * begin;
        for (std::size_t done = 0; done < count; ++leaf) {
            const Vec3i& origin = mPoints.leaves[leaf];
            // Integers below 2^53: exact, and so is their sum with a voxel.
            const double corner[3] = {origin[0] - reference[0], origin[1] - reference[1],
                                      origin[2] - reference[2]};
            const std::uint16_t* const voxels = mPoints.voxels.data() + begin;
            const std::size_t end =
                std::min(count, static_cast<std::size_t>(mPoints.starts[leaf + 1]) - begin);
            for (; done < end; ++done, p += 3) {
                const int voxel = voxels[done];
                x[done] = corner[0] + (voxel >> 6) + static_cast<double>(p[0]); // the only rounding
                y[done] = corner[1] + (voxel >> 3 & 7) + static_cast<double>(p[1]);
                z[done] = corner[2] + (voxel & 7) + static_cast<double>(p[2]);
            }
        }
    }

    void readStored(std::size_t begin, std::size_t count, StoredPosition* out) const override
    {
        if (count == 0) return;
        std::size_t leaf = leafOf(mPoints.starts, begin);
        const float* p = mPoints.positions.data() + 3 * begin;
        for (std::size_t done = 0; done < count; ++leaf) {
            const Vec3i& origin = mPoints.leaves[leaf];
            const std::uint16_t* const voxels = mPoints.voxels.data() + begin;
            const std::size_t end =
                std::min(count, static_cast<std::size_t>(mPoints.starts[leaf + 1]) - begin);
            for (; done < end; ++done, p += 3) {
                const int voxel = voxels[done];
                out[done] = {{std::int64_t(origin[0]) + (voxel >> 6),
                              std::int64_t(origin[1]) + (voxel >> 3 & 7),
                              std::int64_t(origin[2]) + (voxel & 7)},
                             {p[0], p[1], p[2]}};
            }
        }
    }

    std::size_t fileLeafCount() const override { return mPoints.leaves.size(); }

    FileLeaf fileLeaf(std::size_t i) const override
    {
        return {mPoints.leaves[i], mPoints.starts[i],
                static_cast<std::uint32_t>(mPoints.starts[i + 1] - mPoints.starts[i])};
    }

    void readVoxels(std::size_t begin, std::size_t count, std::uint16_t* out) const override
    {
        std::copy_n(mPoints.voxels.data() + begin, count, out);
    }

private:
    const GridPoints mPoints;
};

} // namespace

ParticleView viewOf(GridPoints&& points)
{
    return ParticleView(std::make_shared<GridPointsSource>(std::move(points)));
}

} // namespace vdb_nns
