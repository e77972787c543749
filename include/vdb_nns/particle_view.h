// What the engine searches: a view of particles that somebody else owns. Arrays are viewed here, VDB grids by
// openvdb_bridge.h, files by point_file.h.
#pragma once

#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <memory>

namespace vdb_nns {

class ParticleSource; // src/points/particle_source.h

/// The exact position of a particle as its source holds it. Except for the translation, the world position is
/// linear() * (voxel + offset), in real arithmetic. This is what decides who is a neighbor.
struct StoredPosition {
    /// Grids: an int32. Arrays: 0.
    std::int64_t voxel[3];
    /// Grids: the value of P, a float, in voxels. Arrays: the position, in world units.
    double offset[3];

    friend bool operator==(const StoredPosition& a, const StoredPosition& b)
    {
        for (int k = 0; k < 3; ++k) {
            if (a.voxel[k] != b.voxel[k] || a.offset[k] != b.offset[k]) return false;
        }
        return true;
    }
};

/// A cheap handle to positions that are viewed, not copied: they must stay alive and unchanged while the
/// view, or any grid or lists made from it, is used. Copies share the view. Safe to read from several
/// threads.
///
/// Particles are numbered 0 to size()-1: those of an array in its own order, those of a VDB point grid in the
/// order of `tree().cbeginLeaf()` and inside a leaf in attribute order. Functions do not check the numbers
/// they are given.
class ParticleView {
public:
    /// An empty view.
    ParticleView();
    explicit ParticleView(std::shared_ptr<const ParticleSource> source);

    /// Positions as x, y, z triples in world units.
    /// @param strideBytes distance from one particle's x to the next one's; at least three values.
    /// @throws InvalidInput for more than 2^32-1 particles, a null pointer with count > 0, or too small a
    ///         stride.
    static ParticleView fromArray(const float* xyz, std::size_t count,
                                  std::size_t strideBytes = 3 * sizeof(float));
    static ParticleView fromArray(const double* xyz, std::size_t count,
                                  std::size_t strideBytes = 3 * sizeof(double));

    /// Positions as three arrays of `count` values each, in world units.
    /// @throws InvalidInput as fromArray() does.
    static ParticleView fromArrays(const float* x, const float* y, const float* z, std::size_t count);
    static ParticleView fromArrays(const double* x, const double* y, const double* z, std::size_t count);

    std::size_t size() const;

    /// The linear part of the map from stored positions to world space, for column vectors: the identity for
    /// arrays, the M of the grid's transform for a VDB grid.
    const Matrix3& linear() const;

    /// Exact. Cost: some ns for arrays, tens of ns for grids.
    StoredPosition stored(std::size_t i) const;

    /// World position of particle i, rounded to double: for reports, never to decide who is a neighbor.
    Vec3d worldPosition(std::size_t i) const;

    /// World distance of two particles by one fixed sequence of IEEE double operations, the same on every
    /// machine: the difference of the stored coordinates, then M, then sqrt(x*x + y*y + z*z), with nothing
    /// contracted.
    double distance(std::size_t i, std::size_t j) const;

    const ParticleSource& source() const { return *mSource; }

private:
    std::shared_ptr<const ParticleSource> mSource;
};

} // namespace vdb_nns
