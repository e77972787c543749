#include "measure/pair_positions.h"

#include "points/pair_geometry.h"
#include "points/particle_source.h"
#include "util/ieee_mode.h"

#include <Eigen/Dense>

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>

namespace vdb_nns {

namespace {

std::size_t bytesOf(PositionRecord record)
{
    return record == PositionRecord::kFloats || record == PositionRecord::kVoxels ? 16 : 32;
}

PairMap mapOf(const ParticleSource& source, bool isWorld)
{
    PairMap map{};
    map.kind = PairMap::Kind::kIdentity;
    if (isWorld) return map;
    map.kind = PairMap::Kind::kDiagonal;
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) {
            map.m[r][c] = source.linear()[r][c];
            if (r != c && map.m[r][c] != 0) map.kind = PairMap::Kind::kGeneral;
        }
    }
    return map;
}

// The most that the voxels of two neighbors may differ by beside the offsets: their distance in voxels.
double voxelsApart(const ParticleSource& source, double radius)
{
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const RowMajor inverse = Eigen::Map<const RowMajor>(source.linear()[0].data()).inverse();
    return radius * inverse.rowwise().norm().maxCoeff();
}

void copyPosition(const StoredPosition& p, PositionRecord record, const ParticleSource* world, char* out)
{
    const auto offset = [&](int k) { return static_cast<float>(p.offset[k]); };
    switch (record) {
    case PositionRecord::kFloats:
        *reinterpret_cast<FloatPosition*>(out) = {offset(0), offset(1), offset(2), 0};
        break;
    case PositionRecord::kDoubles: {
        const Vec3d at = world ? worldOf(*world, p) : Vec3d{p.offset[0], p.offset[1], p.offset[2]};
        *reinterpret_cast<DoublePosition*>(out) = {at[0], at[1], at[2], 0};
        break;
    }
    case PositionRecord::kVoxels:
        *reinterpret_cast<VoxelPosition10*>(out) = {
            offset(0), offset(1), offset(2), VoxelPosition10::pack(p.voxel[0], p.voxel[1], p.voxel[2])};
        break;
    case PositionRecord::kWideVoxels: {
        WideVoxelPosition& to = *reinterpret_cast<WideVoxelPosition*>(out);
        to = {};
        for (int k = 0; k < 3; ++k) {
            to.voxel[k] = static_cast<std::int32_t>(p.voxel[k]);
            to.offset[k] = offset(k);
        }
        break;
    }
    }
}

// Returns the largest magnitude of the finite offsets.
double copyPositions(const ParticleSource& source, PositionRecord record, bool isWorld,
                     const CancelCheck& cancel, PageArray<char>& out)
{
    constexpr std::size_t kChunk = 256;
    const std::size_t bytes = bytesOf(record);
    out.resizeDiscarding(source.size() * bytes);
    char* const data = out.data();
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, source.size(), 16 * kChunk), 0.0,
        [&](const auto& range, double largest) {
            cancel.check();
            const IeeeMode mode;
            StoredPosition stored[kChunk];
            for (std::size_t i = range.begin(); i < range.end();) {
                const std::size_t count = std::min(kChunk, range.end() - i);
                source.readStored(i, count, stored);
                for (std::size_t k = 0; k < count; ++k, ++i) {
                    copyPosition(stored[k], record, isWorld ? &source : nullptr, data + bytes * i);
                    for (const double offset : stored[k].offset) {
                        if (std::isfinite(offset)) largest = std::max(largest, std::fabs(offset));
                    }
                }
            }
            return largest;
        },
        [](double a, double b) { return std::max(a, b); });
}

} // namespace

void PairPositions::read(const ParticleView& queriesView, const ParticleView& candidatesView, double radius,
                         const CancelCheck& cancel, PageArray<char> (&memory)[2])
{
    // A packed voxel has ten bits; what rounding adds is far below the voxels that are spared.
    constexpr double kMostVoxels = 500;
    const ParticleSource &queries = queriesView.source(), &candidates = candidatesView.source();
    const bool isOne = &queries == &candidates, isAlike = haveSameCoordinates(queries, candidates);
    mMap = mapOf(queries, !isAlike || queries.isArray());
    const auto copy = [&](PositionRecord record) {
        mRecord = record;
        mRecordBytes = bytesOf(record);
        const double ofCandidates = copyPositions(candidates, record, !isAlike, cancel, memory[0]);
        mQueryData = mCandidateData = memory[0].data();
        if (isOne) return 2 * ofCandidates;
        const double ofQueries = copyPositions(queries, record, !isAlike, cancel, memory[1]);
        mQueryData = memory[1].data();
        return ofCandidates + ofQueries;
    };
    if (!isAlike || queries.isArray()) {
        const bool areFloats = isAlike && queries.hasFloats() && candidates.hasFloats();
        copy(areFloats ? PositionRecord::kFloats : PositionRecord::kDoubles);
        return;
    }
    const double offsets = copy(PositionRecord::kVoxels);
    if (!(voxelsApart(queries, radius) + offsets < kMostVoxels)) copy(PositionRecord::kWideVoxels);
}

std::uint64_t PairPositions::bytesFor(const ParticleView& queries, const ParticleView& candidates)
{
    const bool isOne = &queries.source() == &candidates.source();
    const bool isDouble = !haveSameCoordinates(queries.source(), candidates.source()) ||
                          !queries.source().hasFloats() || !candidates.source().hasFloats();
    return (candidates.size() + (isOne ? 0 : queries.size())) *
           bytesOf(isDouble ? PositionRecord::kDoubles : PositionRecord::kFloats);
}

} // namespace vdb_nns
