// Two sets of particles in one space: the difference of two positions, each as its source stores it. Sets with one transform
// are compared without its translation, which then decides nothing. Knows nothing of radii, cells or who is a neighbor.
#pragma once

#include "points/particle_source.h"
#include "vdb_nns/particle_view.h"

#include <cstdint>

namespace vdb_nns {

// Whether the stored coordinates of two sources mean the same places.
bool haveSameCoordinates(const ParticleSource& a, const ParticleSource& b);

// The world position of stored coordinates `a` of one source less that of `b` of another, each component rounded once from the
// exact value (within 2^-52 relatively).
Vec3d worldOffset(const ParticleSource& sourceA, const Vec3d& a, const ParticleSource& sourceB,
                  const Vec3d& b);

// M p + t of a stored position, ((m0 p0 + m1 p1) + m2 p2) + t in double; of an array the position.
Vec3d worldOf(const ParticleSource& source, const StoredPosition& p);

// World distances between particles of two views, by one fixed sequence of IEEE double operations: for one transform that
// of ParticleView::distance(); else each position M p + t, ((m0 p0 + m1 p1) + m2 p2) + t, their difference, and
// sqrt((x x + y y) + z z).
class PairDistance {
public:
    PairDistance(const ParticleView& queries, const ParticleView& candidates)
        : mQueries(queries),
          mCandidates(candidates),
          mIsShared(&queries.source() == &candidates.source()),
          mIsAlike(haveSameCoordinates(queries.source(), candidates.source()))
    {
    }

    double operator()(std::size_t query, std::size_t candidate) const
    {
        return mIsShared ? mQueries.distance(query, candidate) : ofTwo(query, candidate);
    }

private:
    double ofTwo(std::size_t query, std::size_t candidate) const;

    ParticleView mQueries, mCandidates;
    bool mIsShared, mIsAlike;
};

} // namespace vdb_nns
