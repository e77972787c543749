// Point sets as ParticleViews: as each kind of array that a caller may have, and as voxels and offsets under a matrix, by
// a ParticleSource of the tests' own. For the tests that hold the engine against the oracle.
#pragma once

#include "grid/sparse_grid_data.h"
#include "points/particle_source.h"
#include "support/distributions.h"
#include "support/oracle.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search.h"

#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

namespace vdb_nns::testing {

enum class Form { kFloats, kFloatColumns, kDoubles, kStridedDoubles, kDoubleColumns, kVoxels };

// x as a float, widened. Through memory: g++ 12 at -O3 makes vectors of such conversions in a loop, and leaves them out.
inline double roundedToFloat(double x)
{
    const volatile float rounded = static_cast<float>(x);
    return static_cast<double>(rounded);
}

// The set with every coordinate rounded to float, so that it is the same as an array of either type.
inline PointSet roundedToFloats(PointSet set)
{
    for (ExactPoint& point : set.points) {
        for (double& x : point.offset) x = roundedToFloat(x);
    }
    return set;
}

inline const char* nameOf(Form form)
{
    constexpr const char* kNames[] = {"Floats",         "FloatColumns",  "Doubles",
                                      "StridedDoubles", "DoubleColumns", "Voxels"};
    return kNames[static_cast<int>(form)];
}

// Stored positions as the points of a set are, whatever they are.
class VoxelSource final : public ParticleSource {
public:
    explicit VoxelSource(const PointSet& set) : mPoints(set.points)
    {
        mSize = mPoints.size();
        mLinear = set.linear;
        mIsArray = false;
        std::int64_t low[3] = {}, high[3] = {};
        for (std::size_t i = 0; i < mSize; ++i) {
            for (std::size_t k = 0; k < 3; ++k) {
                low[k] = i ? std::min(low[k], mPoints[i].voxel[k]) : mPoints[i].voxel[k];
                high[k] = i ? std::max(high[k], mPoints[i].voxel[k]) : mPoints[i].voxel[k];
            }
        }
        for (std::size_t k = 0; k < 3; ++k) mReference[k] = static_cast<double>((low[k] + high[k]) / 2);
    }

    StoredPosition stored(std::size_t i) const override
    {
        const ExactPoint& p = mPoints[i];
        return {{p.voxel[0], p.voxel[1], p.voxel[2]}, {p.offset[0], p.offset[1], p.offset[2]}};
    }

    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override
    {
        double* const out[3] = {x, y, z};
        for (std::size_t i = 0; i < count; ++i) {
            for (std::size_t k = 0; k < 3; ++k) {
                const ExactPoint& p = mPoints[begin + i];
                const std::int64_t voxels = p.voxel[k] - static_cast<std::int64_t>(reference[k]);
                out[k][i] = static_cast<double>(voxels) + p.offset[k];
            }
        }
    }

private:
    std::vector<ExactPoint> mPoints;
};

// Owns the memory that its view shows.
class SetView {
public:
    SetView(const PointSet& set, Form form)
    {
        const std::size_t n = set.points.size();
        if (form == Form::kVoxels) {
            mView = ParticleView(std::make_shared<VoxelSource>(set));
        } else if (form == Form::kFloats) {
            mFloats = floatsOf(set);
            mView = ParticleView::fromArray(mFloats.data(), n);
        } else if (form == Form::kDoubles) {
            mDoubles = doublesOf(set);
            mView = ParticleView::fromArray(mDoubles.data(), n);
        } else if (form == Form::kFloatColumns) {
            mFloats = columnsOf(floatsOf(set));
            mView = ParticleView::fromArrays(mFloats.data(), mFloats.data() + n, mFloats.data() + 2 * n, n);
        } else if (form == Form::kDoubleColumns) {
            mDoubles = columnsOf(doublesOf(set));
            mView =
                ParticleView::fromArrays(mDoubles.data(), mDoubles.data() + n, mDoubles.data() + 2 * n, n);
        } else {
            // Each position is followed by two values that are none of the search's business.
            const std::vector<double> xyz = doublesOf(set);
            mDoubles.assign(5 * n, std::nan(""));
            for (std::size_t i = 0; i < n; ++i) {
                std::copy_n(xyz.data() + 3 * i, 3, mDoubles.data() + 5 * i);
            }
            mView = ParticleView::fromArray(mDoubles.data(), n, 5 * sizeof(double));
        }
    }
    SetView(const SetView&) = delete;
    SetView& operator=(const SetView&) = delete;

    const ParticleView& view() const { return mView; }

private:
    template <typename Real>
    static std::vector<Real> columnsOf(const std::vector<Real>& xyz)
    {
        std::vector<Real> columns;
        for (std::size_t k = 0; k < 3; ++k) {
            for (std::size_t i = k; i < xyz.size(); i += 3) columns.push_back(xyz[i]);
        }
        return columns;
    }

    std::vector<float> mFloats;
    std::vector<double> mDoubles;
    ParticleView mView;
};

// Runs f on that many threads, also where the machine has fewer cores.
template <typename F>
void runOnThreads(int threads, F&& f)
{
    const tbb::global_control most(tbb::global_control::max_allowed_parallelism,
                                   static_cast<std::size_t>(threads));
    tbb::task_arena(threads).execute(f);
}

// Every instruction set of this processor.
inline std::vector<SimdLevel> simdLevels()
{
    std::vector<SimdLevel> levels;
    for (int l = 0; l <= static_cast<int>(bestSimdLevel()); ++l) levels.push_back(static_cast<SimdLevel>(l));
    return levels;
}

// The cell of every particle of the grid, by number; particles that are not in it have none (the origin).
inline std::vector<Vec3i> cellsOf(const SparseGrid& grid)
{
    std::vector<Vec3i> cells(grid.view().size());
    for (std::size_t l = 0; l < grid.leafCount(); ++l) {
        const SparseGrid::Leaf leaf = grid.leaf(l);
        // Where a cell starts within its leaf is not public, but positions about the leaf's centre are what decides it.
        for (std::uint64_t s = leaf.firstSlot; s < leaf.firstSlot + leaf.particleCount; ++s) {
            const float* const local[3] = {grid.data().x.data(), grid.data().y.data(), grid.data().z.data()};
            Vec3i& cell = cells[grid.particleNumbers()[s]];
            for (std::size_t k = 0; k < 3; ++k) {
                const int inLeaf = static_cast<int>(std::floor(local[k][s] + (4 - 0x1p-21f)));
                cell[k] = leaf.origin[k] + std::clamp(inLeaf, 0, 7);
            }
        }
    }
    return cells;
}

} // namespace vdb_nns::testing
