// Positions of particles in world units, as writers need them.
#pragma once

#include "util/cancel.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cmath>
#include <cstddef>
#include <cstdint>

namespace vdb_nns {

// What one pass over the positions finds.
struct PositionFacts {
    std::uint64_t nonfinite = 0;
    bool areFloats = true;      // every finite coordinate is a float exactly
    double largestRounding = 0; // of a position, world units: of the doubles that read() gives
    Vec3d min{HUGE_VAL, HUGE_VAL, HUGE_VAL}, max{-HUGE_VAL, -HUGE_VAL, -HUGE_VAL}; // of the finite ones
};

class WorldPositions {
public:
    // The view has to outlive it.
    explicit WorldPositions(const ParticleView& view);

    std::size_t size() const { return mSize; }

    // x y z of particles [begin, begin + count). Those of arrays are as they are; those of a grid are worked out in long
    // double and rounded once. Thread-safe.
    void read(std::size_t begin, std::size_t count, double* xyz) const;

    PositionFacts measure(const CancelCheck& cancel) const;

private:
    template <typename Use>
    void forEachOfGrid(std::size_t begin, std::size_t count, const Use& use) const;

    const ParticleView& mView;
    std::size_t mSize;
    bool mIsArray;
};

inline bool isFinite(const double* xyz)
{
    return std::isfinite(xyz[0]) && std::isfinite(xyz[1]) && std::isfinite(xyz[2]);
}

// Of a vector, without overflow.
inline double lengthOf(double x, double y, double z)
{
    return std::hypot(std::hypot(x, y), z);
}

} // namespace vdb_nns
