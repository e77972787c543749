// The generators behind makeScene(), by family, and what they share. Coordinates inside generators are in units of h
// (the particle spacing) unless a name says otherwise; a generator fills exactly `count` particles.
// Knows random.h and the public scene.h; nothing of files or grids.
#pragma once

#include "util/cancel.h"
#include "util/random.h"
#include "vdb_nns/scene.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstdint>
#include <vector>

namespace vdb_nns::scenes {

// Half the width of the jitter of one axis, in h (the scenes' documentation).
constexpr double kJitter = 0.2;

// Streams of random numbers, one for each use, so that no two uses share a number.
enum Stream : std::uint64_t { kJitterStream, kPieceStream, kPlaceStream, kShapeStream, kScatterStream };

struct Job {
    const SceneOptions& options;
    std::uint64_t count;
    double spacing;   // h, world units
    double radius;    // world units
    double voxelSize; // world units
    double* positions;
    CancelCheck cancel;
};

using Generator = void (*)(const Job&);

void makeBlock(const Job& job);
void makeLattice(const Job& job);
void makeCoincident(const Job& job);
void makeOutlier(const Job& job);
void makeFar(const Job& job);
void makeSeam(const Job& job);
void makeDamBreak(const Job& job);
void makeTwoSources(const Job& job);
void makeSheet(const Job& job);
void makeSpray(const Job& job);
void makeClusters(const Job& job);

// Places particles [first, first + count) in parallel: particle first + k goes to origin + h * unit(k, first + k).
// origin is in world units; `unit` returns a Vec3d in h and must be a pure function.
template <typename Unit>
void place(const Job& job, std::uint64_t first, std::uint64_t count, const Vec3d& origin, const Unit& unit)
{
    // 16384 particles a task: about a millisecond, so that a cancel is seen soon and tasks cost nothing.
    const tbb::blocked_range<std::uint64_t> all(0, count, 16384);
    tbb::parallel_for(all, [&](const tbb::blocked_range<std::uint64_t>& range) {
        job.cancel.check();
        for (std::uint64_t k = range.begin(); k < range.end(); ++k) {
            const Vec3d p = unit(k, first + k);
            double* out = job.positions + 3 * (first + k);
            for (int axis = 0; axis < 3; ++axis) out[axis] = origin[axis] + p[axis] * job.spacing;
        }
    });
    job.cancel.update(static_cast<double>(first + count) / static_cast<double>(job.count));
}

// p moved by the jitter of particle `index`.
inline Vec3d jittered(const Random& random, std::uint64_t index, Vec3d p)
{
    for (std::uint64_t axis = 0; axis < 3; ++axis) {
        p[axis] += random.uniform(3 * index + axis, -kJitter, kJitter);
    }
    return p;
}

// Smallest n with n^3 >= count.
inline std::uint64_t cubeEdge(std::uint64_t count)
{
    std::uint64_t n = 1;
    while (n * n * n < count) ++n;
    return n;
}

// Point k of a lattice filled z first, then y, then x, whose y and z edges are n.
inline Vec3d latticePoint(std::uint64_t k, std::uint64_t n)
{
    return {static_cast<double>(k / (n * n)), static_cast<double>(k / n % n), static_cast<double>(k % n)};
}

// Number of the piece that holds particle k, where firsts[p] is the first particle of piece p and firsts[0] is 0.
inline std::size_t pieceOf(const std::vector<std::uint64_t>& firsts, std::uint64_t k)
{
    return static_cast<std::size_t>(std::upper_bound(firsts.begin(), firsts.end(), k) - firsts.begin()) - 1;
}

// Lattice points within sqrt(radius2) of the origin, in lattice order: a droplet.
std::vector<Vec3d> latticeBall(int radius2);

} // namespace vdb_nns::scenes
