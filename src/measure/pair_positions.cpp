#include "measure/pair_positions.h"

#include "measure/chunks.h"
#include "points/pair_geometry.h"
#include "points/particle_source.h"
#include "util/ieee_mode.h"

#include <Eigen/Dense>

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace vdb_nns {

namespace {

// That the voxels of two neighbors differ by, for packed ones: those have nine bits, and what rounding adds is far below the voxels that
// are spared.
constexpr double kMostVoxels = 250;

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

std::uint64_t particlesOf(const ParticleView& queries, const ParticleView& candidates)
{
    return candidates.size() + (&queries.source() == &candidates.source() ? 0 : queries.size());
}

// The most that the voxels of two neighbors may differ by beside the offsets: their distance in voxels.
double voxelsApart(const ParticleSource& source, double radius)
{
    using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    const RowMajor inverse = Eigen::Map<const RowMajor>(source.linear()[0].data()).inverse();
    return radius * inverse.rowwise().norm().maxCoeff();
}

float offset(const StoredPosition& p, int k)
{
    return static_cast<float>(p.offset[k]);
}

// What is the same for all particles of a copy.
struct CopyRule {
    const ParticleSource& source;
    bool isWorld;
    Vec3d reference;
};

// Copies of positions, and what a chunk of them is found to have.
struct FloatCopy {
    using Record = FloatPosition;
    void copy(const CopyRule&, const StoredPosition& p, Record& out)
    {
        out = {offset(p, 0), offset(p, 1), offset(p, 2), 0};
    }
    void join(const FloatCopy&) {}
};

struct DoubleCopy {
    using Record = DoublePosition;
    void copy(const CopyRule& rule, const StoredPosition& p, Record& out)
    {
        const Vec3d at =
            rule.isWorld ? worldOf(rule.source, p) : Vec3d{p.offset[0], p.offset[1], p.offset[2]};
        out = {at[0], at[1], at[2], 0};
    }
    void join(const DoubleCopy&) {}
};

struct LargestOffset {
    double largest = 0; // magnitude of the finite offsets

    void note(const StoredPosition& p)
    {
        for (const double x : p.offset) {
            if (std::isfinite(x)) largest = std::max(largest, std::fabs(x));
        }
    }
    void join(const LargestOffset& other) { largest = std::max(largest, other.largest); }
};

struct VoxelCopy : LargestOffset {
    using Record = VoxelPosition9;
    void copy(const CopyRule&, const StoredPosition& p, Record& out)
    {
        out = {offset(p, 0), offset(p, 1), offset(p, 2),
               VoxelPosition9::pack(p.voxel[0], p.voxel[1], p.voxel[2])};
        note(p);
    }
};

struct WideVoxelCopy : LargestOffset {
    using Record = WideVoxelPosition;
    void copy(const CopyRule&, const StoredPosition& p, Record& out)
    {
        out = {};
        for (int k = 0; k < 3; ++k) {
            out.voxel[k] = static_cast<std::int32_t>(p.voxel[k]);
            out.offset[k] = offset(p, k);
        }
    }
};

// Voxel and offset as one double. Of two such positions the difference, rounded once, is what the voxels' difference plus that of the
// offsets rounds to: all offsets are multiples of 2^-39 below 2^12, so their difference is a double; voxels from the reference are below
// 2^13, so each sum is one too. NaN where that does not hold: about one in 10^4 of random floats.
struct WholeCopy {
    using Record = DoublePosition;
    std::uint64_t unknown = 0;

    void copy(const CopyRule& rule, const StoredPosition& p, Record& out)
    {
        constexpr double kMostOffset = 4096, kMostVoxel = 8192;
        constexpr double kRounding = 1.5 * 8192; // whose last bit is 2^-39
        bool isKnown = true;
        double at[3];
        for (int k = 0; k < 3; ++k) {
            const double voxel = static_cast<double>(p.voxel[k]) - rule.reference[k], by = p.offset[k];
            isKnown = isKnown & (std::fabs(voxel) < kMostVoxel) & (std::fabs(by) < kMostOffset) &
                      ((by + kRounding) - kRounding == by);
            at[k] = voxel + by;
        }
        constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
        out = {isKnown ? at[0] : kNan, at[1], at[2], 0};
        unknown += isKnown ? 0 : 1;
    }
    void join(const WholeCopy& other) { unknown += other.unknown; }
};

template <typename Copy>
Copy copyPositions(const CopyRule& rule, const CancelCheck& cancel, PageArray<char>& out)
{
    using Record = typename Copy::Record;
    constexpr std::size_t kChunk = 256;
    const ParticleSource& source = rule.source;
    out.resizeDiscarding(source.size() * sizeof(Record));
    Record* const records = reinterpret_cast<Record*>(out.data());
    return tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, source.size(), 16 * kChunk), Copy(),
        [&](const auto& range, Copy copy) {
            cancel.check();
            const IeeeMode mode;
            StoredPosition stored[kChunk];
            for (std::size_t i = range.begin(); i < range.end();) {
                const std::size_t count = std::min(kChunk, range.end() - i);
                source.readStored(i, count, stored);
                for (std::size_t k = 0; k < count; ++k, ++i) copy.copy(rule, stored[k], records[i]);
            }
            return copy;
        },
        [](Copy a, const Copy& b) {
            a.join(b);
            return a;
        });
}

} // namespace

template <typename Copy>
Copy PairPositions::copy(PositionRecord record, bool isWorld, const CancelCheck& cancel,
                         PageArray<char> (&memory)[2])
{
    mRecord = record;
    const Vec3d& reference = mCandidates->reference();
    Copy copied = copyPositions<Copy>({*mCandidates, isWorld, reference}, cancel, memory[0]);
    mQueryData = mCandidateData = memory[0].data();
    if (mQueries == mCandidates) return copied;
    copied.join(copyPositions<Copy>({*mQueries, isWorld, reference}, cancel, memory[1]));
    mQueryData = memory[1].data();
    return copied;
}

void PairPositions::read(const ParticleView& queries, const ParticleView& candidates, double radius,
                         bool mayBeDoubles, const CancelCheck& cancel, PageArray<char> (&memory)[2])
{
    constexpr std::uint64_t kLeastPerUnknown =
        1000; // particles: looking an unknown one up takes a hundred times as long
    mQueries = &queries.source();
    mCandidates = &candidates.source();
    mHasUnknown = false;
    const bool isAlike = haveSameCoordinates(*mQueries, *mCandidates);
    mAreStored = isAlike;
    mMap = mapOf(*mQueries, !isAlike || mQueries->isArray());
    if (!isAlike) {
        copy<DoubleCopy>(PositionRecord::kDoubles, true, cancel, memory);
    } else if (mQueries->isArray() && mQueries->hasFloats() && mCandidates->hasFloats()) {
        copy<FloatCopy>(PositionRecord::kFloats, false, cancel, memory);
    } else if (mQueries->isArray()) {
        copy<DoubleCopy>(PositionRecord::kDoubles, false, cancel, memory);
    } else {
        if (mayBeDoubles) {
            const std::uint64_t unknown =
                copy<WholeCopy>(PositionRecord::kDoubles, false, cancel, memory).unknown;
            mHasUnknown = unknown > 0;
            if (unknown <= particlesOf(queries, candidates) / kLeastPerUnknown) return;
            mHasUnknown = false;
        }
        const double offsets = 2 * copy<VoxelCopy>(PositionRecord::kVoxels, false, cancel, memory).largest;
        if (!(voxelsApart(*mQueries, radius) + offsets < kMostVoxels))
            copy<WideVoxelCopy>(PositionRecord::kWideVoxels, false, cancel, memory);
    }
}

bool PairPositions::canHaveSlots() const
{
    return mQueries == mCandidates &&
           (mRecord == PositionRecord::kFloats || mRecord == PositionRecord::kDoubles);
}

void PairPositions::setSlots(const PageArray<std::uint32_t>& number, std::size_t slots,
                             const CancelCheck& cancel)
{
    const auto write = [&](auto* records) {
        forEachChunk(slots, cancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t slot = begin; slot < end; ++slot)
                records[number[slot]].slot = static_cast<std::uint32_t>(slot);
        });
    };
    if (mRecord == PositionRecord::kFloats) {
        write(reinterpret_cast<FloatPosition*>(mCandidateData));
    } else {
        write(reinterpret_cast<DoublePosition*>(mCandidateData));
    }
}

std::size_t PairPositions::recordBytes() const
{
    switch (mRecord) {
    case PositionRecord::kFloats:
        return sizeof(FloatPosition);
    case PositionRecord::kDoubles:
        return sizeof(DoublePosition);
    case PositionRecord::kVoxels:
        return sizeof(VoxelPosition9);
    case PositionRecord::kWideVoxels:
        break;
    }
    return sizeof(WideVoxelPosition);
}

Vec3d PairPositions::lookUp(std::uint32_t query, std::uint32_t candidate) const
{
    const StoredPosition from = mQueries->stored(query), to = mCandidates->stored(candidate);
    Vec3d d, w;
    for (std::size_t k = 0; k < 3; ++k)
        d[k] = static_cast<double>(to.voxel[k] - from.voxel[k]) + (to.offset[k] - from.offset[k]);
    if (mMap.kind == PairMap::Kind::kIdentity) return d;
    for (std::size_t r = 0; r < 3; ++r) {
        const double(&m)[3] = mMap.m[r];
        w[r] =
            mMap.kind == PairMap::Kind::kDiagonal ? m[r] * d[r] : (m[0] * d[0] + m[1] * d[1]) + m[2] * d[2];
    }
    return w;
}

std::uint64_t PairPositions::bytesFor(const ParticleView& queries, const ParticleView& candidates,
                                      double radius)
{
    const ParticleSource& source = queries.source();
    const bool isAlike = haveSameCoordinates(source, candidates.source());
    const bool areFloats = isAlike && source.hasFloats() && candidates.source().hasFloats() &&
                           (source.isArray() || voxelsApart(source, radius) + 1 < kMostVoxels);
    return particlesOf(queries, candidates) * (areFloats ? sizeof(FloatPosition) : sizeof(DoublePosition));
}

std::uint64_t PairPositions::bytesMoreAsDoubles(const ParticleView& queries, const ParticleView& candidates)
{
    return particlesOf(queries, candidates) * (sizeof(DoublePosition) - sizeof(VoxelPosition9));
}

} // namespace vdb_nns
