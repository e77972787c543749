// Positions of an OpenVDB point grid, read where they lie: nothing is copied but one entry a leaf. Delayed loading is never used: an out-of-core leaf is refused, so that reading
// needs no locks.
#include "vdb_nns/openvdb_bridge.h"

#include "points/leaf_lookup.h"
#include "points/occupied_voxels.h"
#include "points/particle_source.h"
#include "points/transform_check.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"

#include <openvdb/points/AttributeArray.h>

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <memory>
#include <vector>

namespace vdb_nns {

namespace {

namespace points = openvdb::points;
using Leaf = points::PointDataTree::LeafNodeType;
using Vec3f = openvdb::Vec3f;
using VoxelOffset = Leaf::ValueType; // end of a voxel's points within its leaf

static_assert(sizeof(VoxelOffset) == sizeof(openvdb::Index32), "a leaf's offsets are 32-bit");

using NullCodec = points::NullCodec;
using TruncateCodec = points::TruncateCodec;
using Fixed16Codec = points::FixedPointCodec<false, points::PositionRange>;
using Fixed8Codec = points::FixedPointCodec<true, points::PositionRange>;

enum class PositionCodec : std::uint8_t { kNull, kTruncate, kFixed16, kFixed8 };

// One leaf that holds points.
struct LeafPoints {
    const VoxelOffset* ends = nullptr; // of Leaf::SIZE voxels
    const void* values = nullptr;      // encoded P
    openvdb::Coord origin;
    PositionCodec codec = PositionCodec::kNull;
    bool isUniform = false; // values holds one, for all points
};

std::string coordText(const openvdb::Coord& c)
{
    return "(" + std::to_string(c.x()) + ", " + std::to_string(c.y()) + ", " + std::to_string(c.z()) + ")";
}

std::string gridText(const points::PointDataGrid& grid)
{
    return "point grid '" + grid.getName() + "': ";
}

// Decodes with OpenVDB's own code, so that the values are those of AttributeHandle<Vec3f>.
template <typename Codec>
Vec3f decoded(const void* values, std::size_t index)
{
    using Storage = typename Codec::template Storage<Vec3f>::Type;
    Vec3f value;
    Codec::decode(static_cast<const Storage*>(values)[index], value);
    return value;
}

Vec3f decodedBy(PositionCodec codec, const void* values, std::size_t index)
{
    switch (codec) {
    case PositionCodec::kTruncate:
        return decoded<TruncateCodec>(values, index);
    case PositionCodec::kFixed16:
        return decoded<Fixed16Codec>(values, index);
    case PositionCodec::kFixed8:
        return decoded<Fixed8Codec>(values, index);
    case PositionCodec::kNull:
        break;
    }
    return decoded<NullCodec>(values, index);
}

// ------------------------------------------------------------------------------------------------ checks

// M and the translation of a grid's transform, as column vectors take them.
void readTransform(const points::PointDataGrid& grid, Matrix3& linear, Vec3d& translation)
{
    const openvdb::math::Transform& transform = grid.constTransform();
    if (!transform.isLinear()) {
        throw InputError(gridText(grid) + "its transform (" + transform.baseMap()->type() +
                         ") is not linear; resample the points to a grid with an affine transform");
    }
    openvdb::Mat4d matrix;
    try {
        matrix = transform.baseMap()->getAffineMap()->getMat4();
    } catch (const openvdb::ArithmeticError&) { // OpenVDB itself refuses |determinant| < 3e-15
        throw InputError(gridText(grid) +
                         "its transform's matrix is singular to OpenVDB; scale the scene up or repair " +
                         "the transform");
    }
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) {
            linear[row][column] = matrix(column, row); // OpenVDB multiplies row vectors
        }
        translation[row] = matrix(3, row);
    }
    if (!isInvertible(linear, translation)) {
        throw InputError(gridText(grid) +
                         "the matrix of its transform is singular or not finite, so that its points " +
                         "have no place in space; repair the transform");
    }
}

PositionCodec codecOf(const points::PointDataGrid& grid, const points::AttributeArray& array)
{
    const std::string codec = array.codecType();
    if (array.valueType() == openvdb::typeNameAsString<Vec3f>()) {
        if (codec == NullCodec::name()) return PositionCodec::kNull;
        if (codec == TruncateCodec::name()) return PositionCodec::kTruncate;
        if (codec == Fixed16Codec::name()) return PositionCodec::kFixed16;
        if (codec == Fixed8Codec::name()) return PositionCodec::kFixed8;
    }
    throw InputError(gridText(grid) + "P has type " + array.valueType() + " with codec " + codec +
                     ", which is not supported; convert it to vec3s with codec null, trnc, fxpt16 or fxpt8");
}

template <typename Codec>
const void* rawValues(const points::AttributeArray& array)
{
    return points::TypedAttributeArray<Vec3f, Codec>::cast(array).constData();
}

const void* rawValuesBy(PositionCodec codec, const points::AttributeArray& array)
{
    switch (codec) {
    case PositionCodec::kTruncate:
        return rawValues<TruncateCodec>(array);
    case PositionCodec::kFixed16:
        return rawValues<Fixed16Codec>(array);
    case PositionCodec::kFixed8:
        return rawValues<Fixed8Codec>(array);
    case PositionCodec::kNull:
        break;
    }
    return rawValues<NullCodec>(array);
}

#if OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER < 13 ||                                                             \
    (OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER == 13 && OPENVDB_LIBRARY_MINOR_VERSION_NUMBER < 2)
bool isLoaded(const Leaf& leaf)
{
    return !leaf.buffer().isOutOfCore();
}

bool isLoaded(const points::AttributeArray& array)
{
    return array.isDataLoaded();
}
#else // Delayed loading went with 13.2, and so did what is out of core.
bool isLoaded(const Leaf&)
{
    return true;
}

bool isLoaded(const points::AttributeArray&)
{
    return true;
}
#endif

// Number of points of a leaf, from offsets that have been found sound.
std::size_t checkOffsets(const points::PointDataGrid& grid, const Leaf& leaf, const VoxelOffset* ends)
{
    bool isMonotone = true;
    for (openvdb::Index n = 1; n < Leaf::SIZE; ++n) {
        isMonotone &= openvdb::Index32(ends[n - 1]) <= openvdb::Index32(ends[n]);
    }
    const std::size_t count = openvdb::Index32(ends[Leaf::SIZE - 1]);
    if (!isMonotone) {
        throw InputError(gridText(grid) + "the leaf at " + coordText(leaf.origin()) +
                         " has voxel offsets that decrease; the file is damaged");
    }
    const points::AttributeSet& attributes = leaf.attributeSet();
    for (std::size_t i = 0; i < attributes.size(); ++i) {
        // OpenVDB holds no array shorter than one.
        const std::size_t size = attributes.getConst(i)->size();
        if (size != count && !(count == 0 && size <= 1)) {
            throw InputError(gridText(grid) + "the leaf at " + coordText(leaf.origin()) + " has " +
                             std::to_string(count) + " points by its voxel offsets, but " +
                             std::to_string(size) + " values of attribute number " + std::to_string(i) +
                             "; the file is damaged");
        }
    }
    return count;
}

// Checks a leaf and notes where its points are. Returns their number; leaves without points need no P.
std::size_t readLeaf(const points::PointDataGrid& grid, const Leaf& leaf, LeafPoints& out)
{
    if (!isLoaded(leaf)) {
        throw InputError(gridText(grid) + "the leaf at " + coordText(leaf.origin()) +
                         " is out of core; open the file without delayed loading");
    }
    out.ends = leaf.buffer().data();
    out.origin = leaf.origin();
    const std::size_t count = out.ends ? checkOffsets(grid, leaf, out.ends) : 0;
    if (count == 0) return 0;

    const std::size_t position = leaf.attributeSet().find("P");
    if (position == points::AttributeSet::INVALID_POS) {
        throw InputError(gridText(grid) + "the leaf at " + coordText(leaf.origin()) + " has no attribute P");
    }
    const points::AttributeArray& array = *leaf.attributeSet().getConst(position);
    out.codec = codecOf(grid, array);
    if (array.stride() != 1) {
        throw InputError(gridText(grid) + "P has " + std::to_string(array.stride()) +
                         " values a point instead of one");
    }
    if (!isLoaded(array)) {
        throw InputError(gridText(grid) + "P of the leaf at " + coordText(leaf.origin()) +
                         " is out of core; open the file without delayed loading");
    }
    out.isUniform = array.isUniform();
    out.values = rawValuesBy(out.codec, array);
    return count;
}

// ------------------------------------------------------------------------------------------------ the source

// Where the next output goes.
struct Output {
    double *x, *y, *z;
};

class VdbSource final : public ParticleSource {
public:
    explicit VdbSource(const points::PointDataGrid::ConstPtr& grid);
    // OpenVDB frees the leaves of the last handle in parallel.
    ~VdbSource() override
    {
        isolated([this] { mGrid.reset(); });
    }

    StoredPosition stored(std::size_t i) const override;
    void read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
              double* z) const override;
    std::size_t fileLeafCount() const override { return mLeaves.size(); }
    FileLeaf fileLeaf(std::size_t i) const override;
    void readVoxels(std::size_t begin, std::size_t count, std::uint16_t* out) const override;

private:
    points::PointDataGrid::ConstPtr mGrid; // keeps the leaves
    std::vector<LeafPoints> mLeaves;       // those with points
    std::vector<std::uint64_t> mStarts;    // number of a leaf's first point; one more at the end
};

VdbSource::VdbSource(const points::PointDataGrid::ConstPtr& grid) : mGrid(grid)
{
    readTransform(*grid, mLinear, mTranslation);
    mIsArray = false;

    std::vector<const Leaf*> nodes;
    nodes.reserve(grid->tree().leafCount());
    grid->tree().getNodes(nodes); // in the order of cbeginLeaf()
    std::vector<LeafPoints> leaves(nodes.size());
    std::vector<std::uint64_t> counts(nodes.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, nodes.size(), 64), [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i)
            counts[i] = readLeaf(*grid, *nodes[i], leaves[i]);
    });

    mStarts.assign(1, 0);
    for (std::size_t i = 0; i < nodes.size(); ++i) {
        if (counts[i] == 0) continue;
        mLeaves.push_back(leaves[i]);
        mStarts.push_back(mStarts.back() + counts[i]);
    }
    mSize = mStarts.back();
    if (mSize > std::numeric_limits<std::uint32_t>::max()) {
        throw InvalidInput(gridText(*grid) + std::to_string(mSize) +
                           " points are more than one view holds (" +
                           std::to_string(std::numeric_limits<std::uint32_t>::max()) + "): split the grid");
    }
    mReference = middleOfLeaves(mLeaves.size(), [this](std::size_t i) { return fileLeaf(i).origin; });
}

FileLeaf VdbSource::fileLeaf(std::size_t i) const
{
    const openvdb::Coord& origin = mLeaves[i].origin;
    return {{origin.x(), origin.y(), origin.z()},
            mStarts[i],
            static_cast<std::uint32_t>(mStarts[i + 1] - mStarts[i])};
}

// The voxel of a leaf's point: how many voxels end at or before it. Where points are spread evenly, as on a lattice, the
// first guess is right; else a search without branches over the 512 voxels.
openvdb::Index voxelOf(const VoxelOffset* ends, openvdb::Index32 point)
{
    const auto guess = static_cast<openvdb::Index>(std::uint64_t(point) * Leaf::SIZE /
                                                   openvdb::Index32(ends[Leaf::SIZE - 1]));
    const openvdb::Index32 before = guess ? openvdb::Index32(ends[guess - 1]) : 0;
    if (before <= point && point < openvdb::Index32(ends[guess])) return guess;
    openvdb::Index voxel = 0;
    for (openvdb::Index step = Leaf::SIZE / 2; step > 0; step /= 2) {
        voxel += openvdb::Index32(ends[voxel + step - 1]) <= point ? step : 0;
    }
    return voxel;
}

StoredPosition VdbSource::stored(std::size_t i) const
{
    const std::size_t index = leafOf(mStarts, i);
    const LeafPoints& leaf = mLeaves[index];
    const openvdb::Index32 local = static_cast<openvdb::Index32>(i - mStarts[index]);
    const openvdb::Coord inLeaf = Leaf::offsetToLocalCoord(voxelOf(leaf.ends, local));
    const Vec3f offset = decodedBy(leaf.codec, leaf.values, leaf.isUniform ? 0 : local);
    StoredPosition position;
    for (int k = 0; k < 3; ++k) {
        position.voxel[k] = std::int64_t(leaf.origin[k]) + inLeaf[k];
        position.offset[k] = offset[k];
    }
    return position;
}

// Writes the points [begin, end) of a leaf whose lowest voxel is at `corner` less the reference.
template <typename Codec, bool isUniform>
void readLeafPoints(const LeafPoints& leaf, std::size_t begin, std::size_t end, const double (&corner)[3],
                    Output& out)
{
    std::uint64_t occupied[8];
    findOccupied(reinterpret_cast<const std::uint32_t*>(leaf.ends), occupied);
    std::size_t next = begin;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t bits = occupied[x]; bits != 0 && next < end; bits &= bits - 1) {
            const int yz = __builtin_ctzll(bits);
            const std::size_t last = std::min<std::size_t>(openvdb::Index32(leaf.ends[x * 64 + yz]), end);
            const double voxel[3] = {corner[0] + x, corner[1] + (yz >> 3), corner[2] + (yz & 7)}; // exact
            for (; next < last; ++next) {
                const Vec3f offset = decoded<Codec>(leaf.values, isUniform ? 0 : next);
                *out.x++ = voxel[0] + offset.x(); // the only rounding
                *out.y++ = voxel[1] + offset.y();
                *out.z++ = voxel[2] + offset.z();
            }
        }
    }
}

template <typename Codec>
void readLeafBy(const LeafPoints& leaf, std::size_t begin, std::size_t end, const double (&corner)[3],
                Output& out)
{
    if (leaf.isUniform) {
        readLeafPoints<Codec, true>(leaf, begin, end, corner, out);
    } else {
        readLeafPoints<Codec, false>(leaf, begin, end, corner, out);
    }
}

void VdbSource::read(std::size_t begin, std::size_t count, const Vec3d& reference, double* x, double* y,
                     double* z) const
{
    if (count == 0) return;
    Output out{x, y, z};
    std::size_t index =
        static_cast<std::size_t>(std::upper_bound(mStarts.begin(), mStarts.end(), begin) - mStarts.begin()) -
        1;
    for (std::size_t next = begin; next < begin + count; ++index) {
        const LeafPoints& leaf = mLeaves[index];
        const std::size_t first = next - mStarts[index];
        next = std::min<std::size_t>(mStarts[index + 1], begin + count);
        const std::size_t last = next - mStarts[index];
        // Integers below 2^53: exact.
        const double corner[3] = {leaf.origin.x() - reference[0], leaf.origin.y() - reference[1],
                                  leaf.origin.z() - reference[2]};
        switch (leaf.codec) {
        case PositionCodec::kNull:
            readLeafBy<NullCodec>(leaf, first, last, corner, out);
            break;
        case PositionCodec::kTruncate:
            readLeafBy<TruncateCodec>(leaf, first, last, corner, out);
            break;
        case PositionCodec::kFixed16:
            readLeafBy<Fixed16Codec>(leaf, first, last, corner, out);
            break;
        case PositionCodec::kFixed8:
            readLeafBy<Fixed8Codec>(leaf, first, last, corner, out);
            break;
        }
    }
}

void VdbSource::readVoxels(std::size_t begin, std::size_t count, std::uint16_t* out) const
{
    if (count == 0) return;
    std::size_t index = leafOf(mStarts, begin);
    for (std::size_t next = begin; next < begin + count; ++index) {
        const LeafPoints& leaf = mLeaves[index];
        const std::size_t end = std::min<std::size_t>(mStarts[index + 1], begin + count) - mStarts[index];
        std::size_t point = next - mStarts[index];
        for (openvdb::Index voxel = voxelOf(leaf.ends, static_cast<openvdb::Index32>(point)); point < end;
             ++voxel) {
            const std::size_t last = std::min<std::size_t>(openvdb::Index32(leaf.ends[voxel]), end);
            for (; point < last; ++point) *out++ = static_cast<std::uint16_t>(voxel);
        }
        next = mStarts[index] + end;
    }
}

} // namespace

ParticleView viewOf(const points::PointDataGrid::ConstPtr& grid)
{
    if (!grid) throw InvalidInput("viewOf needs a point grid, not a null pointer");
    return isolated([&] { return ParticleView(std::make_shared<VdbSource>(grid)); });
}

} // namespace vdb_nns
