// Positions in arrays, and ParticleView. Knows nothing of OpenVDB.
#include "vdb_nns/particle_view.h"

#include "points/particle_source.h"
#include "vdb_nns/error.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <string>

namespace vdb_nns {

namespace {

// Three components at a common stride in bytes: serves x y z triples with any stride and three arrays alike.
template <typename Real>
class ArraySource final : public ParticleSource {
public:
    ArraySource(const Real* x, const Real* y, const Real* z, std::size_t count, std::size_t strideBytes)
        : mComponent{reinterpret_cast<const char*>(x), reinterpret_cast<const char*>(y),
                     reinterpret_cast<const char*>(z)},
          mStrideBytes(strideBytes)
    {
        mSize = count;
        mHasFloats = sizeof(Real) == sizeof(float);
    }

    StoredPosition stored(std::size_t i) const override
    {
        return {{0, 0, 0}, {value(0, i), value(1, i), value(2, i)}};
    }

    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override
    {
        double* const out[3] = {x, y, z};
        for (int k = 0; k < 3; ++k) {
            for (std::size_t i = 0; i < count; ++i) out[k][i] = value(k, begin + i) - reference[k];
        }
    }

private:
    double value(int k, std::size_t i) const
    {
        Real v;
        std::memcpy(&v, mComponent[k] + i * mStrideBytes, sizeof v); // a caller's stride need not align
        return static_cast<double>(v);
    }

    const char* mComponent[3];
    std::size_t mStrideBytes;
};

template <typename Real>
ParticleView makeView(const Real* x, const Real* y, const Real* z, std::size_t count, std::size_t strideBytes)
{
    if (count > std::numeric_limits<std::uint32_t>::max()) {
        throw InvalidInput(std::to_string(count) + " particles are more than one view holds (4294967295): " +
                           "split them into several views");
    }
    if (count > 0 && (!x || !y || !z)) {
        throw InvalidInput("the position array of " + std::to_string(count) + " particles is null");
    }
    return ParticleView(std::make_shared<ArraySource<Real>>(x, y, z, count, strideBytes));
}

template <typename Real>
ParticleView makeInterleavedView(const Real* xyz, std::size_t count, std::size_t strideBytes)
{
    if (strideBytes < 3 * sizeof(Real)) {
        throw InvalidInput("a stride of " + std::to_string(strideBytes) +
                           " bytes is too small for a position of " + std::to_string(3 * sizeof(Real)) +
                           " bytes");
    }
    return makeView(xyz, xyz ? xyz + 1 : nullptr, xyz ? xyz + 2 : nullptr, count, strideBytes);
}

} // namespace

ParticleView::ParticleView() : ParticleView(fromArray(static_cast<const float*>(nullptr), 0)) {}

ParticleView::ParticleView(std::shared_ptr<const ParticleSource> source) : mSource(std::move(source)) {}

ParticleView ParticleView::fromArray(const float* xyz, std::size_t count, std::size_t strideBytes)
{
    return makeInterleavedView(xyz, count, strideBytes);
}

ParticleView ParticleView::fromArray(const double* xyz, std::size_t count, std::size_t strideBytes)
{
    return makeInterleavedView(xyz, count, strideBytes);
}

ParticleView ParticleView::fromArrays(const float* x, const float* y, const float* z, std::size_t count)
{
    return makeView(x, y, z, count, sizeof(float));
}

ParticleView ParticleView::fromArrays(const double* x, const double* y, const double* z, std::size_t count)
{
    return makeView(x, y, z, count, sizeof(double));
}

std::size_t ParticleView::size() const
{
    return mSource->size();
}

StoredPosition ParticleView::stored(std::size_t i) const
{
    return mSource->stored(i);
}

const Matrix3& ParticleView::linear() const
{
    return mSource->linear();
}

Vec3d ParticleView::worldPosition(std::size_t i) const
{
    const StoredPosition p = mSource->stored(i);
    const Matrix3& m = mSource->linear();
    Vec3d world = mSource->translation();
    if (mSource->isArray()) return {p.offset[0], p.offset[1], p.offset[2]}; // 0 * inf would make NaN of it
    for (int k = 0; k < 3; ++k) {
        double sum = 0;
        for (int c = 0; c < 3; ++c) sum += m[k][c] * (static_cast<double>(p.voxel[c]) + p.offset[c]);
        world[k] += sum;
    }
    return world;
}

double ParticleView::distance(std::size_t i, std::size_t j) const
{
    const StoredPosition a = mSource->stored(i), b = mSource->stored(j);
    double d[3], w[3];
    for (int c = 0; c < 3; ++c) {
        d[c] = static_cast<double>(b.voxel[c] - a.voxel[c]) + (b.offset[c] - a.offset[c]);
    }
    if (mSource->isArray()) {
        for (int k = 0; k < 3; ++k) w[k] = d[k];
    } else {
        const Matrix3& m = mSource->linear();
        for (int k = 0; k < 3; ++k) w[k] = (m[k][0] * d[0] + m[k][1] * d[1]) + m[k][2] * d[2];
    }
    return std::sqrt((w[0] * w[0] + w[1] * w[1]) + w[2] * w[2]);
}

} // namespace vdb_nns
