// Point sets of the oracle as views.
#pragma once

#include "../support/oracle.h"
#include "points/particle_source.h"
#include "vdb_nns/particle_view.h"

#include <memory>
#include <vector>

namespace vdb_nns::testing {

// A point set as the definition of a ParticleView; no grid file needed.
class SetSource : public ParticleSource {
public:
    explicit SetSource(const PointSet& set) : mPoints(set.points)
    {
        mSize = set.points.size();
        mLinear = set.linear;
        mIsArray = false;
    }
    StoredPosition stored(std::size_t i) const override
    {
        const ExactPoint& p = mPoints[i];
        return {{p.voxel[0], p.voxel[1], p.voxel[2]}, {p.offset[0], p.offset[1], p.offset[2]}};
    }
    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override
    {
        double* out[3] = {x, y, z};
        for (std::size_t k = 0; k < count; ++k) {
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const ExactPoint& p = mPoints[begin + k];
                out[axis][k] = (static_cast<double>(p.voxel[axis]) - reference[axis]) + p.offset[axis];
            }
        }
    }

private:
    std::vector<ExactPoint> mPoints;
};

inline ParticleView viewOf(const PointSet& set)
{
    return ParticleView(std::make_shared<SetSource>(set));
}

} // namespace vdb_nns::testing
