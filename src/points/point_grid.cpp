#include "points/point_grid.h"

#include "points/value_check.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/openvdb_bridge.h"

#include <openvdb/points/AttributeArray.h>
#include <openvdb/points/AttributeGroup.h>
#include <openvdb/points/AttributeSet.h>
#include <openvdb/points/PointAttribute.h>
#include <openvdb/points/PointGroup.h>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

namespace points = openvdb::points;
using points::PointDataGrid;

using Leaf = PointDataGrid::TreeType::LeafNodeType;

// Between two questions whether to stop: some ms where each is alone in its leaf.
constexpr std::size_t kParticlesPerCheck = 4096;
constexpr std::size_t kLeavesPerCheck = 1024;

std::string gridText(const PointDataGrid& grid)
{
    return "point grid '" + grid.getName() + "': ";
}

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

openvdb::Coord coordOf(const Vec3i& voxel)
{
    return {voxel[0], voxel[1], voxel[2]};
}

// Where a particle goes. Their order is that of the tree's leaves, of the voxels in a leaf, and of the particles in a voxel.
struct Place {
    // 128 bits: root's entry 3 x 20, upper node 15, lower node 12, voxel 9, particle 32.
    std::uint64_t high, low;

    std::uint32_t particle() const { return static_cast<std::uint32_t>(low); }
    openvdb::Index voxel() const { return static_cast<openvdb::Index>(low >> 32) % Leaf::SIZE; }
    bool hasLeafOf(const Place& other) const { return high == other.high && low >> 41 == other.low >> 41; }
    bool operator<(const Place& other) const
    {
        return high != other.high ? high < other.high : low < other.low;
    }
};

Place placeOf(const openvdb::Coord& voxel, std::size_t particle)
{
    using Upper = PointDataGrid::TreeType::RootNodeType::ChildNodeType;
    using Lower = Upper::ChildNodeType;
    static_assert(Upper::DIM == 4096 && Lower::DIM == 128 && Leaf::DIM == 8);
    const auto root = [&](int axis) { // the root's entries ascend with their signs
        constexpr std::uint32_t kSign = 0x80000000u;
        return std::uint64_t((static_cast<std::uint32_t>(voxel[axis]) ^ kSign) / Upper::DIM);
    };
    const std::uint64_t upper = Upper::coordToOffset(voxel), lower = Lower::coordToOffset(voxel);
    return {root(0) << 44 | root(1) << 24 | root(2) << 4 | upper >> 11,
            upper << 53 | lower << 41 | std::uint64_t(Leaf::coordToOffset(voxel)) << 32 | particle};
}

using Places = std::unique_ptr<Place[]>; // made without a first, serial pass that fills it

Places sortedPlaces(const GridPositions& positions, const CancelCheck& cancel)
{
    const std::size_t size = positions.size();
    Places places(new Place[size]);
    forRanges(size, cancel, [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i)
            places[i] = placeOf(coordOf(positions.at(i).voxel), i);
    });
    tbb::parallel_sort(places.get(), places.get() + size, [&](const Place& a, const Place& b) {
        // Every 65536th comparison or so, which ones is up to the particles: one thread asks as often in each run.
        constexpr std::uint32_t kGolden = 2654435769u;
        if ((a.particle() * kGolden + b.particle()) % (16 * kParticlesPerCheck) == 0) cancel.check();
        return a < b;
    });
    return places;
}

// What all leaves share.
struct LeafAttributes {
    points::AttributeSet::Descriptor::Ptr descriptor;
    points::AttributeArray::ScopedRegistryLock lock; // else each leaf takes it
};

// Of the places of one leaf.
template <typename Codec>
std::unique_ptr<Leaf> makeLeaf(const GridPositions& positions, const Place* begin, const Place* end,
                               const LeafAttributes& attributes, const CancelCheck& cancel)
{
    using openvdb::Vec3f;
    auto leaf = std::make_unique<Leaf>(coordOf(positions.at(begin->particle()).voxel));
    leaf->initializeAttributes(attributes.descriptor, static_cast<openvdb::Index>(end - begin),
                               &attributes.lock);
    const auto handle = points::AttributeWriteHandle<Vec3f, Codec>::create(leaf->attributeArray(0));
    std::vector<Leaf::ValueType> voxelEnds(Leaf::SIZE);
    openvdb::Index count = 0, voxel = 0;
    for (const Place* place = begin; place != end; ++place) {
        for (; voxel < place->voxel(); ++voxel) voxelEnds[voxel] = count;
        const std::array<float, 3> offset = positions.at(place->particle()).offset;
        handle->set(count, Vec3f(offset[0], offset[1], offset[2]));
        if (++count % kParticlesPerCheck == 0) cancel.check();
    }
    for (; voxel < Leaf::SIZE; ++voxel) voxelEnds[voxel] = count;
    leaf->setOffsets(voxelEnds);
    return leaf;
}

// What OpenVDB's createPointDataGrid() makes, which cannot be stopped while it sorts.
template <typename Codec>
PointDataGrid::Ptr makeGrid(const GridPositions& positions, const CancelCheck& cancel,
                            PageArray<std::uint32_t>& numbers)
{
    const std::size_t size = positions.size();
    const Places places = sortedPlaces(positions, cancel);
    const LeafAttributes attributes{points::AttributeSet::Descriptor::create(
                                        points::TypedAttributeArray<openvdb::Vec3f, Codec>::attributeType()),
                                    {}};
    const PointDataGrid::Ptr grid = PointDataGrid::create();
    numbers.resizeDiscarding(size);
    std::mutex mutex; // of the tree
    forRanges(size, cancel, [&](const auto& range) {
        std::vector<std::unique_ptr<Leaf>> leaves; // that begin in the range
        const Place* const end = places.get() + size;
        const Place* next = places.get() + range.begin();
        while (next < places.get() + range.end()) {
            const Place* const first = next;
            next = std::partition_point(first, end, [&](const Place& p) { return p.hasLeafOf(*first); });
            if (first == places.get() || !first->hasLeafOf(first[-1]))
                leaves.push_back(makeLeaf<Codec>(positions, first, next, attributes, cancel));
        }
        for (std::size_t i = range.begin(); i < range.end(); ++i)
            numbers[i] = positions.number(places[i].particle());
        const std::lock_guard<std::mutex> lock(mutex);
        for (auto& leaf : leaves) grid->tree().addLeaf(leaf.release());
    });
    return grid;
}

// ------------------------------------------------------------------------------------------------ values

// The leaves of a grid, and where the values of their points come from.
struct Destination {
    std::vector<Leaf*> leaves;
    std::vector<std::uint64_t> starts; // number of a leaf's first point; one more at the end
    const std::uint32_t* numbers;      // null: of a point its own

    explicit Destination(PointDataGrid& grid, const std::uint32_t* numbersOfPoints)
        : starts(1, 0), numbers(numbersOfPoints)
    {
        grid.tree().getNodes(leaves); // in the order of cbeginLeaf()
        for (const Leaf* leaf : leaves)
            starts.push_back(starts.back() + openvdb::Index32(leaf->getLastValue()));
    }

    std::size_t source(std::uint64_t point) const
    {
        return static_cast<std::size_t>(numbers ? numbers[point] : point);
    }

    // f(leaf, number of its first point, number of its points) in parallel.
    template <typename F>
    void forEachLeaf(const CancelCheck& cancel, F&& f) const
    {
        tbb::parallel_for(std::size_t(0), leaves.size(), [&](std::size_t i) {
            if (i % kLeavesPerCheck == 0) cancel.check();
            f(*leaves[i], starts[i], static_cast<openvdb::Index>(starts[i + 1] - starts[i]));
        });
    }
};

void checkName(const std::string& name)
{
    if (!points::AttributeSet::Descriptor::validName(name))
        throw InvalidInput("'" + name + "' is no valid attribute name; use letters, digits and _ | :");
}

// What must be so before anything is changed.
void checkNames(const PointDataGrid& grid, const PointValues& values, bool overwrite)
{
    const std::string text = gridText(grid);
    const points::AttributeSet& attributes = grid.tree().cbeginLeaf()->attributeSet();
    for (const PointAttribute& attribute : values.attributes) {
        const std::string& name = attribute.name;
        checkName(name);
        const std::size_t existing = attributes.find(name);
        if (existing == points::AttributeSet::INVALID_POS) continue;
        if (!overwrite) {
            throw InvalidInput(text + "attribute '" + name +
                               "' exists already; allow overwriting (--force) or choose another prefix");
        }
        if (name == "P" || points::isGroup(*attributes.getConst(existing))) {
            throw InvalidInput(text + "attribute '" + name +
                               "' holds positions or groups and is never replaced; choose another prefix");
        }
    }
    for (const PointGroup& group : values.groups) {
        checkName(group.name);
        if (!overwrite && attributes.descriptor().hasGroup(group.name)) {
            throw InvalidInput(text + "group '" + group.name +
                               "' exists already; allow overwriting (--force) or choose another prefix");
        }
    }
}

template <typename T>
void addAttribute(PointDataGrid& grid, const Destination& to, const PointAttribute& attribute,
                  const CancelCheck& cancel)
{
    points::PointDataTree& tree = grid.tree();
    const std::string& name = attribute.name;
    if (tree.cbeginLeaf()->attributeSet().find(name) != points::AttributeSet::INVALID_POS)
        points::dropAttribute(tree, name);
    points::appendAttribute<T>(tree, name);
    const std::size_t place = tree.cbeginLeaf()->attributeSet().find(name);
    const T* const values = static_cast<const T*>(attribute.values.get());
    using Array = points::TypedAttributeArray<T, points::NullCodec>;
    to.forEachLeaf(cancel, [&](Leaf& leaf, std::uint64_t first, openvdb::Index count) {
        Array& array = Array::cast(leaf.attributeArray(place));
        array.expand(/*fill=*/false);
        for (openvdb::Index n = 0; n < count; ++n) array.setUnsafe(n, values[to.source(first + n)]);
        if (count == 0) array.fill(openvdb::zeroVal<T>()); // OpenVDB holds no array shorter than one
    });
}

void addAttribute(PointDataGrid& grid, const Destination& to, const PointAttribute& attribute,
                  const CancelCheck& cancel)
{
    switch (attribute.type) {
    case AttributeType::kFloat:
        return addAttribute<float>(grid, to, attribute, cancel);
    case AttributeType::kDouble:
        return addAttribute<double>(grid, to, attribute, cancel);
    case AttributeType::kInt32:
        return addAttribute<std::int32_t>(grid, to, attribute, cancel);
    case AttributeType::kInt64:
        return addAttribute<std::int64_t>(grid, to, attribute, cancel);
    case AttributeType::kVec3s:
        return addAttribute<openvdb::Vec3f>(grid, to, attribute, cancel);
    case AttributeType::kVec3d:
        return addAttribute<openvdb::Vec3d>(grid, to, attribute, cancel);
    case AttributeType::kMat3s:
        return addAttribute<openvdb::Mat3s>(grid, to, attribute, cancel);
    }
}

void addGroups(PointDataGrid& grid, const Destination& to, const std::vector<PointGroup>& groups,
               const CancelCheck& cancel)
{
    std::vector<std::string> names;
    for (const PointGroup& group : groups) names.push_back(group.name);
    points::appendGroups(grid.tree(), names); // those that are there stay
    to.forEachLeaf(cancel, [&](Leaf& leaf, std::uint64_t first, openvdb::Index count) {
        for (const PointGroup& group : groups) {
            points::GroupWriteHandle handle = leaf.groupWriteHandle(group.name);
            if (count == 0) handle.collapse(false);
            for (openvdb::Index n = 0; n < count; ++n)
                handle.set(n, group.members.get()[to.source(first + n)] != 0);
            handle.compact();
        }
    });
}

} // namespace

PointDataGrid::Ptr makePointGrid(const GridPositions& positions, const std::string& codec,
                                 const CancelCheck& cancel, PageArray<std::uint32_t>& numbers)
{
    using namespace openvdb::points;
    if (codec == "null") return makeGrid<NullCodec>(positions, cancel, numbers);
    if (codec == "trnc") return makeGrid<TruncateCodec>(positions, cancel, numbers);
    if (codec == "fxpt16") return makeGrid<FixedPointCodec<false, PositionRange>>(positions, cancel, numbers);
    if (codec == "fxpt8") return makeGrid<FixedPointCodec<true, PositionRange>>(positions, cancel, numbers);
    throw InvalidInput("unknown codec '" + codec + "'; P can have null, trnc, fxpt16 or fxpt8");
}

void addPointValues(PointDataGrid& grid, const PointValues& values, bool overwrite,
                    const std::uint32_t* numbers, std::uint64_t count, const CancelCheck& cancel)
{
    const Destination to(grid, numbers);
    checkValues(gridText(grid), values, numbers ? count : to.starts.back());
    if (to.leaves.empty()) return; // values live in leaves
    checkNames(grid, values, overwrite);
    try {
        isolated([&] {
            for (const PointAttribute& attribute : values.attributes)
                addAttribute(grid, to, attribute, cancel);
            if (!values.groups.empty()) addGroups(grid, to, values.groups, cancel);
        });
    } catch (const openvdb::Exception& error) {
        throw InputError(gridText(grid) + "attributes cannot be added: " + error.what() +
                         "; its leaves must share one set of attributes");
    }
}

void addPointValues(PointDataGrid& grid, const PointValues& values, bool overwrite)
{
    addPointValues(grid, values, overwrite, nullptr, 0, CancelCheck(nullptr, ""));
}

void setPointAttribute(PointDataGrid& grid, const std::string& name, Span<const std::uint32_t> values,
                       bool overwrite)
{
    addPointValues(grid, {{countAttribute(gridText(grid), name, values)}, {}}, overwrite);
}

} // namespace vdb_nns
