// What a ParticleView stands for. A stored position is voxel + offset in the coordinates of the source (arrays: voxel 0,
// offset the position); its world position is linear() * (voxel + offset) + translation(). Implementations: arrays
// (array_source.cpp), VDB point grids (vdb_source.cpp). Knows nothing of cells, radii or devices.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>

namespace vdb_nns {

// A leaf of 8^3 voxels of a VDB point grid, with particles.
struct FileLeaf {
    Vec3i origin;                // its lowest voxel
    std::uint64_t firstParticle; // its particles are numbered on from there, voxel by voxel
    const std::uint32_t* ends;   // of 512 voxels, z fastest: its particles end there, counted in the leaf
};

class ParticleSource {
public:
    virtual ~ParticleSource() = default;

    std::size_t size() const { return mSize; }
    const Matrix3& linear() const { return mLinear; }
    const Vec3d& translation() const { return mTranslation; }
    // True for arrays: linear() is the identity and voxels are 0.
    bool isArray() const { return mIsArray; }

    // A point in stored coordinates near the particles, found without a pass over them: the middle of the leaves of a
    // grid (integers), 0 for arrays.
    const Vec3d& reference() const { return mReference; }

    // Exact position of particle i. Thread-safe; a few ns for arrays, tens of ns for grids.
    virtual StoredPosition stored(std::size_t i) const = 0;

    // Stored coordinates of particles [begin, begin + count) less `reference`, each rounded to double at most once
    // after an exact integer difference: |error| <= 2^-53 |result|. Grids need an integer reference.
    // Non-finite positions come out non-finite. Thread-safe.
    virtual void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
                      double* z) const = 0;

    // Leaves with particles, in the order of their particles. None for arrays.
    virtual std::size_t fileLeafCount() const { return 0; }
    virtual FileLeaf fileLeaf(std::size_t) const { return {}; }

protected:
    std::size_t mSize = 0;
    Matrix3 mLinear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Vec3d mTranslation{};
    Vec3d mReference{};
    bool mIsArray = true;
};

} // namespace vdb_nns
