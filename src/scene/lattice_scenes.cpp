// Scenes made of cubic lattices: block, lattice, coincident, outlier, far, seam. The last slab of a lattice is filled as
// far as the count goes, so every count is met exactly; n^3 particles are a full cube.
#include "scene_families.h"

#include <algorithm>

namespace vdb_nns::scenes {

namespace {

// `count` particles of a jittered cube from particle `first` on, its low corner at `origin` (world units).
void placeBlock(const Job& job, std::uint64_t first, std::uint64_t count, const Vec3d& origin)
{
    const std::uint64_t n = cubeEdge(count);
    const Random random(job.options.seed, kJitterStream);
    place(job, first, count, origin, [&](std::uint64_t k, std::uint64_t index) {
        Vec3d p = latticePoint(k, n);
        for (double& x : p) x += 0.5;
        return jittered(random, index, p);
    });
}

} // namespace

std::vector<Vec3d> latticeBall(int radius2)
{
    std::vector<Vec3d> ball;
    int edge = 0;
    while (edge * edge < radius2) ++edge;
    for (int x = -edge; x <= edge; ++x) {
        for (int y = -edge; y <= edge; ++y) {
            for (int z = -edge; z <= edge; ++z) {
                if (x * x + y * y + z * z <= radius2) ball.push_back({double(x), double(y), double(z)});
            }
        }
    }
    return ball;
}

void makeBlock(const Job& job)
{
    placeBlock(job, 0, job.count, {0, 0, 0});
}

void makeLattice(const Job& job)
{
    const std::uint64_t n = cubeEdge(job.count);
    place(job, 0, job.count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t) { return latticePoint(k, n); });
}

// A share of the particles in the middle of a block of the others.
void makeCoincident(const Job& job)
{
    const double share = job.options.fraction.value_or(1.0);
    const auto atPoint = static_cast<std::uint64_t>(share * static_cast<double>(job.count) + 0.5);
    const std::uint64_t others = job.count - std::min(atPoint, job.count);
    const double middle = 0.5 * static_cast<double>(others ? cubeEdge(others) : 0);
    placeBlock(job, 0, others, {0, 0, 0});
    place(job, others, job.count - others, {0, 0, 0}, [&](std::uint64_t, std::uint64_t) {
        return Vec3d{middle, middle, middle};
    });
}

// The lone particle comes last; it stands along (2, -1, 2)/3, a unit vector that is off every axis and diagonal.
void makeOutlier(const Job& job)
{
    const double third = job.options.distance.value_or(1e6) * job.voxelSize / 3;
    placeBlock(job, 0, job.count - 1, {0, 0, 0});
    place(job, job.count - 1, 1, {2 * third, -third, 2 * third}, [](std::uint64_t, std::uint64_t) {
        return Vec3d{0.5, 0.5, 0.5};
    });
}

void makeFar(const Job& job)
{
    const double shift = job.options.offset.value_or(1e5) * job.voxelSize;
    placeBlock(job, 0, job.count, {shift, shift, shift});
}

// Small blocks around each of the 7^3 corners whose coordinates are 0, +-8, +-128 or +-4096 cells, a cell being the
// radius: they straddle zero and all node faces, edges and corners of a tree of 8, 128 and 4096 cells. One particle in
// eight lies exactly on the faces of one axis.
void makeSeam(const Job& job)
{
    static constexpr double kFaces[7] = {-4096, -128, -8, 0, 8, 128, 4096};
    static constexpr std::uint64_t kBlobs = 343;
    std::vector<std::uint64_t> firsts;
    for (std::uint64_t b = 0; b < kBlobs; ++b) firsts.push_back(b * job.count / kBlobs);
    const double cell = job.radius / job.spacing; // in h
    const Random jitter(job.options.seed, kJitterStream), scatter(job.options.seed, kScatterStream);
    const std::uint64_t n = cubeEdge((job.count + kBlobs - 1) / kBlobs);
    const double half = 0.5 * (static_cast<double>(n) - 1);
    place(job, 0, job.count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const std::uint64_t blob = pieceOf(firsts, k);
        const Vec3d corner{cell * kFaces[blob / 49], cell * kFaces[blob / 7 % 7], cell * kFaces[blob % 7]};
        Vec3d p = jittered(jitter, index, latticePoint(k - firsts[blob], n));
        for (int axis = 0; axis < 3; ++axis) p[axis] += corner[axis] - half;
        const std::uint64_t draw = scatter.bits(index);
        if (draw % 8 == 0) p[draw / 8 % 3] = corner[draw / 8 % 3];
        return p;
    });
}

} // namespace vdb_nns::scenes
