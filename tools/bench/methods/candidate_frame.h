// Where a particle is in the cells of a SparseGrid, found from what is public: the grid says which leaf a particle is in,
// but neither where cell 0 begins nor which cell of the leaf it is.
//
// Any origin of the cells that puts every particle into its leaf is as good as the grid's own: cells and leaves are then
// those of one uniform grid. Voxels that serve as cells and arrays with cell 0 at 0 are tried first; fit() finds one for
// all others.
#pragma once

#include "vdb_nns/sparse_grid.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {

class CellFrame {
public:
    struct Place {
        double at[3]; ///< cells from the leaf's lowest corner, 0 to 8
        int cell[3];  ///< 0 to 7
        bool inside;  ///< of the leaf; else the frame is not the grid's
    };

    /// The usual one; see fit().
    explicit CellFrame(const SparseGrid& grid);

    /// Reads all positions to find an origin. @throws std::logic_error without one
    void fit(const SparseGrid& grid);

    Place placeOf(const StoredPosition& stored, const Vec3i& leafOrigin) const
    {
        return mVoxelsAreCells ? voxelPlace(stored, leafOrigin) : cellPlace(stored, leafOrigin);
    }

    /// Bound on the error of a coordinate, for positions up to `most` from reference().
    double error(const Vec3d& most) const;

    /// Stored coordinates that errors are counted from.
    double fromReference(const StoredPosition& stored, int axis) const
    {
        return static_cast<double>(stored.voxel[axis] - mReference[axis]) + stored.offset[axis];
    }

private:
    // Of the 2^-16 that cells are wider than need be, two particles outside their leaf take two of it.
    static constexpr double kSlack = 4e-6;

    double coordinate(const StoredPosition& stored, int axis) const
    {
        const auto& m = mMatrix[axis];
        return m[0] * fromReference(stored, 0) + m[1] * fromReference(stored, 1) +
               m[2] * fromReference(stored, 2);
    }

    Place voxelPlace(const StoredPosition& stored, const Vec3i& origin) const
    {
        Place place{};
        place.inside = true;
        for (int k = 0; k < 3; ++k) {
            const std::int64_t cell = stored.voxel[k] - origin[k];
            place.inside &= cell >= 0 && cell < 8 && std::fabs(stored.offset[k]) <= 0.5;
            place.at[k] = static_cast<double>(cell) + stored.offset[k] + 0.5;
            place.cell[k] = static_cast<int>(cell & 7);
        }
        return place;
    }

    Place cellPlace(const StoredPosition& stored, const Vec3i& origin) const
    {
        Place place{};
        place.inside = true;
        for (int k = 0; k < 3; ++k) {
            const double at = coordinate(stored, k) - mShift[k] - origin[k];
            place.inside &= at >= -kSlack && at <= 8 + kSlack;
            place.at[k] = at;
            // Rounded as the engine rounds it, so that its order inside the leaf mostly serves.
            const float rounded = static_cast<float>(at - 4) + (4 - 0x1p-21f);
            place.cell[k] = static_cast<int>(std::clamp(rounded, 0.0f, 7.0f));
        }
        return place;
    }

    bool mVoxelsAreCells = false;
    Matrix3 mMatrix{}; // cells per stored unit
    std::int64_t mReference[3] = {0, 0, 0};
    double mShift[3] = {0, 0, 0};
};

} // namespace vdb_nns::cli
