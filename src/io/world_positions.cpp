#include "io/world_positions.h"

#include "points/particle_source.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_reduce.h>

#include <algorithm>

namespace vdb_nns {

namespace {

// Positions of a task, which are read in blocks that stay in the first-level cache.
constexpr std::size_t kTask = 16384, kBlock = 512;

bool areFloats(const double* xyz)
{
    const auto isFloat = [](double value) { return static_cast<double>(static_cast<float>(value)) == value; };
    return isFloat(xyz[0]) && isFloat(xyz[1]) && isFloat(xyz[2]);
}

PositionFacts joined(const PositionFacts& a, const PositionFacts& b)
{
    PositionFacts sum;
    sum.nonfinite = a.nonfinite + b.nonfinite;
    sum.areFloats = a.areFloats && b.areFloats;
    sum.largestRounding = std::max(a.largestRounding, b.largestRounding);
    for (std::size_t k = 0; k < 3; ++k) {
        sum.min[k] = std::min(a.min[k], b.min[k]);
        sum.max[k] = std::max(a.max[k], b.max[k]);
    }
    return sum;
}

void add(PositionFacts& facts, const double* xyz)
{
    if (!isFinite(xyz)) {
        ++facts.nonfinite;
        return;
    }
    facts.areFloats = facts.areFloats && areFloats(xyz);
    for (std::size_t k = 0; k < 3; ++k) {
        facts.min[k] = std::min(facts.min[k], xyz[k]);
        facts.max[k] = std::max(facts.max[k], xyz[k]);
    }
}

} // namespace

WorldPositions::WorldPositions(const ParticleView& view)
    : mView(view), mSize(view.size()), mIsArray(view.source().isArray())
{
}

// use(particle, its three coordinates)
template <typename Use>
void WorldPositions::forEachOfGrid(std::size_t begin, std::size_t count, const Use& use) const
{
    const Matrix3& m = mView.source().linear();
    const Vec3d& t = mView.source().translation();
    for (std::size_t i = begin; i < begin + count; ++i) {
        const StoredPosition p = mView.stored(i);
        long double in[3], world[3];
        for (std::size_t k = 0; k < 3; ++k)
            in[k] = static_cast<long double>(p.voxel[k]) + static_cast<long double>(p.offset[k]);
        for (std::size_t k = 0; k < 3; ++k) {
            world[k] = static_cast<long double>(t[k]);
            for (std::size_t c = 0; c < 3; ++c) world[k] += static_cast<long double>(m[k][c]) * in[c];
        }
        use(i, world);
    }
}

void WorldPositions::read(std::size_t begin, std::size_t count, double* xyz) const
{
    if (!mIsArray) {
        forEachOfGrid(begin, count, [&](std::size_t i, const long double* world) {
            for (std::size_t k = 0; k < 3; ++k) xyz[3 * (i - begin) + k] = static_cast<double>(world[k]);
        });
        return;
    }
    double x[kBlock], y[kBlock], z[kBlock];
    for (std::size_t done = 0; done < count;) {
        const std::size_t block = std::min(kBlock, count - done);
        mView.source().read(begin + done, block, Vec3d{}, x, y, z);
        for (std::size_t i = 0; i < block; ++i, xyz += 3) xyz[0] = x[i], xyz[1] = y[i], xyz[2] = z[i];
        done += block;
    }
}

PositionFacts WorldPositions::measure(const CancelCheck& cancel) const
{
    const auto measureRange = [&](const tbb::blocked_range<std::size_t>& range, PositionFacts facts) {
        cancel.check();
        if (!mIsArray) {
            forEachOfGrid(range.begin(), range.size(), [&](std::size_t, const long double* world) {
                const double rounded[3] = {static_cast<double>(world[0]), static_cast<double>(world[1]),
                                           static_cast<double>(world[2])};
                add(facts, rounded);
                if (!isFinite(rounded)) return;
                double error[3];
                for (std::size_t k = 0; k < 3; ++k) error[k] = static_cast<double>(world[k] - rounded[k]);
                facts.largestRounding =
                    std::max(facts.largestRounding, lengthOf(error[0], error[1], error[2]));
            });
            return facts;
        }
        double xyz[3 * kBlock];
        for (std::size_t begin = range.begin(); begin < range.end(); begin += kBlock) {
            const std::size_t count = std::min(kBlock, range.end() - begin);
            read(begin, count, xyz);
            for (std::size_t i = 0; i < count; ++i) add(facts, xyz + 3 * i);
        }
        return facts;
    };
    return tbb::parallel_reduce(tbb::blocked_range<std::size_t>(0, mSize, kTask), PositionFacts{},
                                measureRange, joined);
}

} // namespace vdb_nns
