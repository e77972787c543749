// Scenes into .vdb files: one point grid named `points`. The only file of the scenes with OpenVDB. Points of a voxel
// keep the order of the scene, whatever the number of threads.
#include "io/output_file.h"
#include "io/vdb/seekable_archive.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <openvdb/openvdb.h>
#include <openvdb/points/AttributeArray.h>
#include <openvdb/points/AttributeSet.h>
#include <openvdb/points/PointDataGrid.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <ostream>
#include <vector>

namespace vdb_nns {

namespace {

using openvdb::points::PointDataGrid;

using Leaf = PointDataGrid::TreeType::LeafNodeType;

// Between two questions whether to stop: some ms where each is alone in its leaf.
constexpr std::size_t kParticlesPerCheck = 4096;

// Calls f(range) in parallel for ranges of so many particles, and asks before each whether to stop.
template <typename F>
void forRanges(std::size_t particles, const CancelCheck& cancel, F&& f)
{
    using Range = tbb::blocked_range<std::size_t>;
    const auto task = [&](const Range& range) {
        cancel.check();
        f(range);
    };
    tbb::parallel_for(Range(0, particles, kParticlesPerCheck), task, tbb::simple_partitioner());
}

// A position in voxels. The offset from the voxel's centre is rounded to a multiple of 2^-26, finer than float
// resolves at a quarter of a voxel: i * h / h need not be i in double, and a point of a lattice with h as the voxel
// size must have P = 0 exactly.
openvdb::Vec3d positionInVoxels(const Scene& scene, std::size_t particle)
{
    openvdb::Vec3d position;
    for (int axis = 0; axis < 3; ++axis) {
        const double inVoxels =
            scene.positions[3 * particle + static_cast<std::size_t>(axis)] / scene.voxelSize;
        const double voxel = std::floor(inVoxels + 0.5);
        position[axis] = voxel + std::floor((inVoxels - voxel) * 0x1p26 + 0.5) * 0x1p-26;
    }
    return position;
}

// Where a particle goes. Their order is that of the tree's leaves, of the voxels in a leaf, and of the particles' numbers
// in a voxel.
struct Place {
    // 128 bits: root's entry 3 x 20, upper node 15, lower node 12, voxel 9, number of the particle 32.
    std::uint64_t high, low;

    std::uint32_t particle() const { return static_cast<std::uint32_t>(low); }
    openvdb::Index voxel() const { return static_cast<openvdb::Index>(low >> 32) % Leaf::SIZE; }
    bool hasLeafOf(const Place& other) const { return high == other.high && low >> 41 == other.low >> 41; }
    bool operator<(const Place& other) const
    {
        return high != other.high ? high < other.high : low < other.low;
    }
};

Place placeOf(const Scene& scene, std::size_t particle)
{
    using Upper = PointDataGrid::TreeType::RootNodeType::ChildNodeType;
    using Lower = Upper::ChildNodeType;
    static_assert(Upper::DIM == 4096 && Lower::DIM == 128 && Leaf::DIM == 8);
    const openvdb::Coord voxel = openvdb::Coord::round(positionInVoxels(scene, particle));
    const auto root = [&](int axis) {
        return std::uint64_t(static_cast<std::uint32_t>(voxel[axis]) / Upper::DIM);
    };
    const std::uint64_t upper = Upper::coordToOffset(voxel), lower = Lower::coordToOffset(voxel);
    return {root(0) << 44 | root(1) << 24 | root(2) << 4 | upper >> 11,
            upper << 53 | lower << 41 | std::uint64_t(Leaf::coordToOffset(voxel)) << 32 | particle};
}

using Places = std::unique_ptr<Place[]>; // made without a first, serial pass that fills it

Places sortedPlaces(const Scene& scene, std::size_t size, const CancelCheck& cancel)
{
    Places places(new Place[size]);
    forRanges(size, cancel, [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i) places[i] = placeOf(scene, i);
    });
    tbb::parallel_sort(places.get(), places.get() + size, [&](const Place& a, const Place& b) {
        thread_local std::size_t comparisons = 0;
        if (++comparisons % (16 * kParticlesPerCheck) == 0) cancel.check();
        return a < b;
    });
    return places;
}

// Voxel coordinates are 32-bit; NaN fails too.
void checkRange(const Scene& scene, const CancelCheck& cancel)
{
    constexpr double kLimit = std::numeric_limits<std::int32_t>::max();
    const std::vector<double>& all = scene.positions;
    const bool fits = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, all.size(), 65536), true,
        [&](const tbb::blocked_range<std::size_t>& range, bool good) {
            cancel.check();
            for (std::size_t k = range.begin(); k < range.end(); ++k) {
                good &= std::fabs(all[k] / scene.voxelSize) < kLimit;
            }
            return good;
        },
        [](bool a, bool b) { return a && b; }, tbb::simple_partitioner());
    if (!fits) {
        throw InvalidInput(
            "scene: a position is more than 2147483647 voxels from the origin, which a .vdb cannot "
            "hold; use a larger --voxel-size or a smaller --distance or --offset");
    }
}

// What all leaves share.
struct LeafAttributes {
    openvdb::points::AttributeSet::Descriptor::Ptr descriptor;
    openvdb::points::AttributeArray::ScopedRegistryLock lock; // else each leaf takes it
};

// Of the places of one leaf.
template <typename Codec>
std::unique_ptr<Leaf> makeLeaf(const Scene& scene, const Place* begin, const Place* end,
                               const LeafAttributes& attributes, const CancelCheck& cancel)
{
    using openvdb::Vec3f;
    auto leaf = std::make_unique<Leaf>(openvdb::Coord::round(positionInVoxels(scene, begin->particle())));
    leaf->initializeAttributes(attributes.descriptor, static_cast<openvdb::Index>(end - begin),
                               &attributes.lock);
    const auto positions =
        openvdb::points::AttributeWriteHandle<Vec3f, Codec>::create(leaf->attributeArray(0));
    std::vector<Leaf::ValueType> voxelEnds(Leaf::SIZE);
    openvdb::Index count = 0, voxel = 0;
    for (const Place* place = begin; place != end; ++place) {
        for (; voxel < place->voxel(); ++voxel) voxelEnds[voxel] = count;
        const openvdb::Vec3d position = positionInVoxels(scene, place->particle());
        positions->set(count, Vec3f(position - openvdb::Coord::round(position).asVec3d()));
        if (++count % kParticlesPerCheck == 0) cancel.check();
    }
    for (; voxel < Leaf::SIZE; ++voxel) voxelEnds[voxel] = count;
    leaf->setOffsets(voxelEnds);
    return leaf;
}

// What OpenVDB's createPointDataGrid() makes, which cannot be stopped while it sorts.
template <typename Codec>
PointDataGrid::Ptr makeGrid(const Scene& scene, const CancelCheck& cancel)
{
    namespace points = openvdb::points;
    const std::size_t size = scene.positions.size() / 3;
    const Places places = sortedPlaces(scene, size, cancel);
    const LeafAttributes attributes{points::AttributeSet::Descriptor::create(
                                        points::TypedAttributeArray<openvdb::Vec3f, Codec>::attributeType()),
                                    {}};
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    std::mutex mutex; // of the tree
    forRanges(size, cancel, [&](const auto& range) {
        std::vector<std::unique_ptr<Leaf>> leaves; // that begin in the range
        const Place* const end = places.get() + size;
        const Place* next = places.get() + range.begin();
        while (next < places.get() + range.end()) {
            const Place* const first = next;
            next = std::partition_point(first, end, [&](const Place& p) { return p.hasLeafOf(*first); });
            if (first == places.get() || !first->hasLeafOf(first[-1]))
                leaves.push_back(makeLeaf<Codec>(scene, first, next, attributes, cancel));
        }
        const std::lock_guard<std::mutex> lock(mutex);
        for (auto& leaf : leaves) grid->tree().addLeaf(leaf.release());
    });
    return grid;
}

PointDataGrid::Ptr makeGrid(const Scene& scene, const std::string& codec, const CancelCheck& cancel)
{
    using namespace openvdb::points;
    if (codec == "null") return makeGrid<NullCodec>(scene, cancel);
    if (codec == "trnc") return makeGrid<TruncateCodec>(scene, cancel);
    if (codec == "fxpt16") return makeGrid<FixedPointCodec<false, PositionRange>>(scene, cancel);
    if (codec == "fxpt8") return makeGrid<FixedPointCodec<true, PositionRange>>(scene, cancel);
    throw InvalidInput("scene: unknown codec '" + codec + "'; P can have null, trnc, fxpt16 or fxpt8");
}

void writeSceneFile(const std::string& path, const Scene& scene, const SceneOptions& options,
                    const OutputOptions& output, Progress* progress)
{
    const CancelCheck cancel(progress, "write");
    checkRange(scene, cancel);
    OutputFile file(path, output);
    openvdb::initialize();
    cancel.check();
    const PointDataGrid::Ptr grid = makeGrid(scene, options.codec, cancel);
    cancel.update(0.5);
    grid->setTransform(openvdb::math::Transform::createLinearTransform(scene.voxelSize));
    grid->setName("points");
    grid->insertMeta("suggested_radius", openvdb::DoubleMetadata(scene.suggestedRadius));
    OutputStreamBuffer buffer(file, [&](std::uint64_t) { cancel.check(); });
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit);
    SeekableArchive().writeTo(stream, {grid});
    stream.flush();
    cancel.update(1);
    file.commit();
}

} // namespace

void writeScene(const std::string& path, const Scene& scene, const SceneOptions& options,
                const OutputOptions& output, Progress* progress)
{
    isolated([&] { writeSceneFile(path, scene, options, output, progress); });
}

} // namespace vdb_nns
