// Rows are taken in chunks: differences are gathered, distances and weights computed by whatever vectors the processor has, and
// sums made in the order of the row, a neighbor at a time.
#include "bench/methods/measure_methods.h"
#include "machine.h"
#include "numbers.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/search.h"

#include <Eigen/Eigenvalues>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

namespace vdb_nns::cli {
namespace {

constexpr float kPi = 3.14159265358979f;
constexpr std::size_t kChunk = 64;
constexpr std::size_t kLanes = 8; // chunks are filled up with zeros to whole vectors

// Neighbors of a row: numbers, differences to the query, and then weights.
struct Chunk {
    alignas(64) float x[kChunk], y[kChunk], z[kChunk], weight[kChunk];
    std::uint32_t number[kChunk];
    std::size_t count = 0;
};

enum class Weighting { kCubic, kPca };

// Without the factor before the kernel.
template <Weighting kWeighting>
__attribute__((always_inline)) inline void weighChunk(float inverseRadius, Chunk& chunk)
{
    const std::size_t lanes = (chunk.count + kLanes - 1) / kLanes * kLanes;
    for (std::size_t k = 0; k < lanes; ++k) {
        const float x = chunk.x[k], y = chunk.y[k], z = chunk.z[k];
        const float distance = std::sqrt(x * x + y * y + z * z) * inverseRadius;
        const float q = distance < 1 ? distance : 1, rest = 1 - q;
        if constexpr (kWeighting == Weighting::kPca) {
            chunk.weight[k] = 1 - q * q * q;
        } else {
            const float inner = 1 - 6 * q * q * rest, outer = 2 * rest * rest * rest;
            chunk.weight[k] = q <= 0.5f ? inner : outer;
        }
    }
}

template <Weighting kWeighting>
__attribute__((target("avx2"))) void weighAvx2(float inverseRadius, Chunk& chunk)
{
    weighChunk<kWeighting>(inverseRadius, chunk);
}

template <Weighting kWeighting>
void weigh(float inverseRadius, Chunk& chunk)
{
    static const bool hasAvx2 = __builtin_cpu_supports("avx2");
    if (hasAvx2) {
        weighAvx2<kWeighting>(inverseRadius, chunk);
    } else {
        weighChunk<kWeighting>(inverseRadius, chunk);
    }
}

struct Sums {
    float weight = 0;
    std::array<float, 3> first{};
    std::array<float, 6> second{}; // xx xy xz yy yz zz
};

bool isKept(std::uint32_t a, std::uint32_t b)
{
    const std::uint64_t low = std::min(a, b), high = std::max(a, b);
    return (mix64(low << 32 | high) & 1) != 0;
}

class FloatMeasures final : public MeasureMethod {
public:
    FloatMeasures(const ParticleView& view, double radius, const SearchOptions& options, NeighborShare share)
        : mView(view), mRadius(radius), mOptions(options), mShare(share), mPositions(view.size())
    {
        forParticles([this](std::size_t i) {
            const Vec3d at = mView.worldPosition(i);
            for (std::size_t k = 0; k < 3; ++k) mPositions[i][k] = static_cast<float>(at[k]);
        });
    }

    MeasureRun run(const std::string& measure) override
    {
        discard();
        MeasureRun result;
        const ParticleSet all(mView);
        const Stopwatch gridWatch;
        const SearchSets sets = mEngine.sort(all, all, mRadius, mOptions);
        result.gridSeconds = gridWatch.seconds();
        const Stopwatch passWatch;
        measure == "density"  ? measureDensity(sets)
        : measure == "normal" ? measureNormal(sets)
                              : measurePca(sets);
        result.passSeconds = passWatch.seconds();
        return result;
    }

    MeasureValues values() const override { return mValues; }
    void discard() override { mValues = {}; }

private:
    using Row = Span<const std::uint32_t>;

    template <typename Function>
    void forParticles(const Function& function) const
    {
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, mView.size(), 4096), [&](const auto& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i) function(i);
        });
    }

    // Hands weighed neighbors to `sum`, in order. Returns how many there are.
    template <Weighting kWeighting, typename Sum>
    std::size_t forNeighbors(std::uint32_t query, Row row, const Sum& sum) const
    {
        const auto inverseRadius = static_cast<float>(1 / mRadius);
        std::size_t kept = 0;
        Chunk chunk;
        for (std::size_t begin = 0; begin < row.size(); begin += kChunk) {
            choose(query, {row.data() + begin, std::min(kChunk, row.size() - begin)}, chunk);
            gather(query, chunk);
            weigh<kWeighting>(inverseRadius, chunk);
            for (std::size_t k = 0; k < chunk.count; ++k)
                sum(chunk.weight[k], chunk.x[k], chunk.y[k], chunk.z[k]);
            kept += chunk.count;
        }
        return kept;
    }

    void choose(std::uint32_t query, Row row, Chunk& chunk) const
    {
        const bool isHalf = mShare == NeighborShare::kHalf;
        chunk.count = 0;
        for (const std::uint32_t other :
             row) { // without a branch, which would be mispredicted every other time
            chunk.number[chunk.count] = other;
            chunk.count += !isHalf || isKept(query, other) ? 1 : 0;
        }
    }

    void gather(std::uint32_t query, Chunk& chunk) const
    {
        const std::array<float, 4> at = mPositions[query];
        for (std::size_t k = 0; k < chunk.count; ++k) {
            const std::array<float, 4>& other = mPositions[chunk.number[k]];
            chunk.x[k] = other[0] - at[0];
            chunk.y[k] = other[1] - at[1];
            chunk.z[k] = other[2] - at[2];
        }
        for (std::size_t k = chunk.count; k % kLanes != 0; ++k) chunk.x[k] = chunk.y[k] = chunk.z[k] = 0;
    }

    // Of a neighbor that is summed up.
    float standsFor() const { return mShare == NeighborShare::kHalf ? 2.0f : 1.0f; }

    void measureDensity(const SearchSets& sets)
    {
        const auto radius = static_cast<float>(mRadius);
        const float factor = 8 / (kPi * radius * radius * radius);
        mDensity.assign(mView.size(), factor);
        mEngine.visitRows(
            sets,
            [&](std::uint32_t query, Row row) {
                float density = 0;
                forNeighbors<Weighting::kCubic>(query, row,
                                                [&](float w, float, float, float) { density += w; });
                mDensity[query] = factor * (1 + standsFor() * density);
            },
            mOptions);
        mValues.density = mDensity.data();
    }

    void measureNormal(const SearchSets& sets)
    {
        mNormal.assign(3 * mView.size(), 0);
        mEngine.visitRows(
            sets,
            [&](std::uint32_t query, Row row) {
                float x = 0, y = 0, z = 0;
                forNeighbors<Weighting::kCubic>(query, row, [&](float w, float dx, float dy, float dz) {
                    x -= w * dx;
                    y -= w * dy;
                    z -= w * dz;
                });
                const float length = std::sqrt(x * x + y * y + z * z);
                if (!(length > 0)) return;
                float* const normal = mNormal.data() + 3 * static_cast<std::size_t>(query);
                normal[0] = x / length;
                normal[1] = y / length;
                normal[2] = z / length;
            },
            mOptions);
        mValues.normal = mNormal.data();
    }

    void measurePca(const SearchSets& sets)
    {
        mStretch.resize(3 * mView.size());
        mXform.resize(9 * mView.size());
        mEllipsoids.resize(mView.size());
        mMoved.resize(mView.size());
        forParticles([this](std::size_t i) { // what points have that nobody is near
            for (std::size_t k = 0; k < 3; ++k) mStretch[3 * i + k] = static_cast<float>(mPca.stretch);
            for (std::size_t k = 0; k < 9; ++k) mXform[9 * i + k] = k % 4 == 0 ? 1.0f : 0.0f;
            mEllipsoids[i] = 0;
            mMoved[i] = mView.worldPosition(i);
        });
        mEngine.visitRows(
            sets, [this](std::uint32_t query, Row row) { writeEllipsoid(query, row); }, mOptions);
        mValues.stretch = mStretch.data();
        mValues.xform = mXform.data();
        mValues.ellipsoids = mEllipsoids.data();
    }

    void writeEllipsoid(std::uint32_t query, Row row)
    {
        Sums sums;
        const std::size_t count =
            forNeighbors<Weighting::kPca>(query, row, [&](float w, float x, float y, float z) {
                sums.weight += w;
                const float wx = w * x, wy = w * y, wz = w * z;
                sums.first[0] += wx;
                sums.first[1] += wy;
                sums.first[2] += wz;
                sums.second[0] += wx * x;
                sums.second[1] += wx * y;
                sums.second[2] += wx * z;
                sums.second[3] += wy * y;
                sums.second[4] += wy * z;
                sums.second[5] += wz * z;
            });
        const float scale = standsFor() / (1 + standsFor() * sums.weight); // the query itself weighs 1
        const float c[3] = {scale * sums.first[0], scale * sums.first[1], scale * sums.first[2]};
        for (std::size_t k = 0; k < 3; ++k) mMoved[query][k] += mPca.average * static_cast<double>(c[k]);
        if (standsFor() * static_cast<float>(count) + 1 < static_cast<float>(mPca.threshold)) return;
        mEllipsoids[query] = 1;
        Eigen::Matrix3f covariance;
        for (int a = 0, at = 0; a < 3; ++a) {
            for (int b = a; b < 3; ++b, ++at)
                covariance(a, b) = covariance(b, a) =
                    scale * sums.second[static_cast<std::size_t>(at)] - c[a] * c[b];
        }
        writeAxes(query, covariance);
    }

    void writeAxes(std::uint32_t query, const Eigen::Matrix3f& covariance)
    {
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3f> solver;
        solver.computeDirect(covariance);
        const float largest = solver.eigenvalues()(2);
        if (!(largest > 0)) return;
        std::array<float, 3> lengths{};
        float product = 1;
        for (int k = 0; k < 3; ++k) { // Eigen's are ascending
            const float length =
                std::max(solver.eigenvalues()(2 - k), static_cast<float>(mPca.anisotropy) * largest);
            lengths[static_cast<std::size_t>(k)] = length;
            product *= length / largest;
        }
        const float mean = std::cbrt(product) * largest;
        float* const stretch = mStretch.data() + 3 * static_cast<std::size_t>(query);
        float* const xform = mXform.data() + 9 * static_cast<std::size_t>(query);
        for (std::size_t k = 0; k < 3; ++k) {
            stretch[k] = lengths[k] / mean;
            for (std::size_t axis = 0; axis < 3; ++axis)
                xform[3 * axis + k] = solver.eigenvectors()(static_cast<int>(axis), 2 - static_cast<int>(k));
        }
    }

    const ParticleView mView;
    const double mRadius;
    const SearchOptions mOptions;
    const NeighborShare mShare;
    const PcaOptions mPca;
    std::vector<std::array<float, 4>> mPositions; // of 16 bytes, so that none lies in two cache lines
    SearchEngine mEngine;
    std::vector<float> mDensity, mNormal, mStretch, mXform;
    std::vector<std::uint8_t> mEllipsoids;
    std::vector<Vec3d> mMoved; // what a surface is made about; nobody reads it here
    MeasureValues mValues;
};

} // namespace

std::unique_ptr<MeasureMethod> makeFloatMeasures(const ParticleView& view, double radius,
                                                 const SearchOptions& options, NeighborShare share)
{
    return std::make_unique<FloatMeasures>(view, radius, options, share);
}

} // namespace vdb_nns::cli
