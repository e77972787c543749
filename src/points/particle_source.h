// What a ParticleView stands for. A stored position is voxel + offset in the coordinates of the source (arrays: voxel 0,
// offset the position); its world position is linear() * (voxel + offset) + translation(). Implementations: arrays
// (array_source.cpp), VDB point grids of a host program (vdb_source.cpp) and of files (grid_points.cpp). Knows nothing of cells,
// radii or devices.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>

namespace vdb_nns {

// A leaf of 8^3 voxels of a VDB point grid, with particles.
struct FileLeaf {
    Vec3i origin;                // its lowest voxel
    std::uint64_t firstParticle; // its particles are numbered on from there, voxel by voxel
    std::uint32_t count;
};

class ParticleSource {
public:
    virtual ~ParticleSource() = default;

    std::size_t size() const { return mSize; }
    const Matrix3& linear() const { return mLinear; }
    const Vec3d& translation() const { return mTranslation; }
    // True for arrays: linear() is the identity and voxels are 0.
    bool isArray() const { return mIsArray; }

    // Whether each offset is a float.
    bool hasFloats() const { return mHasFloats; }

    // A point in stored coordinates near the particles, found without a pass over them: the middle of the leaves of a
    // grid (integers), 0 for arrays.
    const Vec3d& reference() const { return mReference; }

    // Exact position of particle i. Thread-safe; a few ns for arrays, tens of ns for grids.
    virtual StoredPosition stored(std::size_t i) const = 0;

    // Of particles [begin, begin + count), faster than one by one. Thread-safe.
    virtual void readStored(std::size_t begin, std::size_t count, StoredPosition* out) const
    {
        for (std::size_t i = 0; i < count; ++i) out[i] = stored(begin + i);
    }

    // Stored coordinates of particles [begin, begin + count) less `reference`, each rounded to double at most once
    // after an exact integer difference: |error| <= 2^-53 |result|. Grids need an integer reference.
    // Non-finite positions come out non-finite. Thread-safe.
    virtual void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
                      double* z) const = 0;

    // Leaves with particles, in the order of their particles. None for arrays.
    virtual std::size_t fileLeafCount() const { return 0; }
    virtual FileLeaf fileLeaf(std::size_t) const { return {}; }

    // The voxel of each of particles [begin, begin + count) in its leaf: 64 x + 8 y + z. Grids only. Thread-safe.
    virtual void readVoxels(std::size_t /*begin*/, std::size_t /*count*/, std::uint16_t* /*out*/) const {}

protected:
    std::size_t mSize = 0;
    Matrix3 mLinear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Vec3d mTranslation{};
    Vec3d mReference{};
    bool mIsArray = true;
    bool mHasFloats = true;
};

} // namespace vdb_nns
