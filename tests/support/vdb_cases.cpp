#include "support/vdb_cases.h"

#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointAttribute.h>
#include <openvdb/points/PointDataGrid.h>
#include <openvdb/points/PointDelete.h>
#include <openvdb/points/PointGroup.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <random>
#include <sstream>
#include <stdexcept>

namespace vdb_nns::testing {

namespace {

using namespace openvdb;
using points::AttributeSet;
using points::PointDataGrid;
using points::PointDataTree;
using Descriptor = AttributeSet::Descriptor;
using Leaf = PointDataTree::LeafNodeType;

using Truncate = points::TruncateCodec;
using Position8 = points::FixedPointCodec<true, points::PositionRange>;
using Position16 = points::FixedPointCodec<false, points::PositionRange>;
using Unit8 = points::FixedPointCodec<true, points::UnitRange>;
using Unit16 = points::FixedPointCodec<false, points::UnitRange>;

constexpr std::uint32_t kPlain = io::COMPRESS_NONE, kZip = io::COMPRESS_ZIP, kBlosc = io::COMPRESS_BLOSC,
                        kActive = io::COMPRESS_ACTIVE_MASK;

class Random {
public:
    explicit Random(std::uint32_t seed) : mWords(seed) {}

    std::uint32_t below(std::uint32_t limit) { return static_cast<std::uint32_t>(mWords()) % limit; }
    bool flip() { return mWords() & 1; }
    double real(double low, double high)
    {
        return low + (high - low) * (double(below(1u << 30)) / (1u << 30));
    }

private:
    std::mt19937 mWords;
};

// Real values mostly of the size of a position in a voxel, some far outside of it, and now and then none at all.
template <typename Real>
Real anyReal(Random& random)
{
    const std::uint32_t kind = random.below(40);
    if (kind == 0) return std::numeric_limits<Real>::quiet_NaN();
    if (kind == 1) return -std::numeric_limits<Real>::infinity();
    if (kind == 2) return std::numeric_limits<Real>::denorm_min();
    if (kind == 3) return Real(-0.0);
    if (kind < 8) return static_cast<Real>(random.real(-1e6, 1e6));
    return static_cast<Real>(random.real(-0.5, 0.5));
}

template <typename T>
T anyValue(Random& random)
{
    if constexpr (std::is_same<T, bool>::value) {
        return random.flip();
    } else if constexpr (std::is_integral<T>::value) {
        return static_cast<T>(std::uint64_t(random.below(~0u)) << 32 | random.below(~0u));
    } else if constexpr (std::is_floating_point<T>::value) {
        return anyReal<T>(random);
    } else if constexpr (VecTraits<T>::IsVec) {
        T value;
        for (int i = 0; i < VecTraits<T>::Size; ++i) value[i] = anyValue<typename T::ValueType>(random);
        return value;
    } else {
        std::array<typename T::ValueType, sizeof(T) / sizeof(typename T::ValueType)> numbers;
        for (auto& number : numbers) number = anyValue<typename T::ValueType>(random);
        return T(numbers.data());
    }
}

// OpenVDB's fixed-point codecs make integers of what they are given, and have none for NaN.
template <typename T, typename Codec>
T encodable(T value)
{
    constexpr bool isKept =
        std::is_same<Codec, points::NullCodec>::value || std::is_same<Codec, points::TruncateCodec>::value;
    if constexpr (!isKept && VecTraits<T>::IsVec) {
        for (int i = 0; i < VecTraits<T>::Size; ++i) value[i] = std::isfinite(value[i]) ? value[i] : 0;
    } else if constexpr (!isKept && std::is_floating_point<T>::value) {
        value = std::isfinite(value) ? value : 0;
    }
    return value;
}

template <typename T, typename Codec>
void fill(points::AttributeArray& array, Random& random)
{
    points::AttributeWriteHandle<T, Codec> handle(array);
    if (array.hasConstantStride()) {
        for (Index i = 0; i < handle.size(); ++i) {
            for (Index j = 0; j < handle.stride(); ++j)
                handle.set(i, j, encodable<T, Codec>(anyValue<T>(random)));
        }
    } else {
        for (Index i = 0; i < array.dataSize(); ++i) handle.set(i, encodable<T, Codec>(anyValue<T>(random)));
    }
}

// One type of attribute with one codec.
struct Kind {
    const char* name;
    NamePair type;
    std::function<void(points::AttributeArray&, Random&)> fill;
};

template <typename T, typename Codec = points::NullCodec>
Kind kind(const char* name)
{
    return {name, points::TypedAttributeArray<T, Codec>::attributeType(), fill<T, Codec>};
}

const std::vector<Kind>& kinds()
{
    using math::Mat3, math::Mat4, math::Quat;
    static const std::vector<Kind> all = {
        kind<bool>("bool"),
        kind<std::int8_t>("int8"),
        kind<std::int16_t>("int16"),
        kind<std::int32_t>("int32"),
        kind<std::int64_t>("int64"),
        kind<float>("float"),
        kind<double>("double"),
        kind<Vec3i>("vec3i"),
        kind<Vec3f>("vec3s"),
        kind<Vec3d>("vec3d"),
        kind<Quat<float>>("quats"),
        kind<Quat<double>>("quatd"),
        kind<Mat3<float>>("mat3s"),
        kind<Mat3<double>>("mat3d"),
        kind<Mat4<float>>("mat4s"),
        kind<Mat4<double>>("mat4d"),
        kind<float, Truncate>("float_trnc"),
        kind<float, Unit8>("float_ufxpt8"),
        kind<float, Unit16>("float_ufxpt16"),
        kind<Vec3f, Truncate>("vec3s_trnc"),
        kind<Vec3f, Position8>("vec3s_fxpt8"),
        kind<Vec3f, Position16>("vec3s_fxpt16"),
        kind<Vec3f, Unit8>("vec3s_ufxpt8"),
        kind<Vec3f, Unit16>("vec3s_ufxpt16"),
        {"vec3s_uvec", points::TypedAttributeArray<Vec3f, points::UnitVecCodec>::attributeType(),
         [](points::AttributeArray& array, Random& random) {
             points::AttributeWriteHandle<Vec3f, points::UnitVecCodec> handle(array);
             for (Index i = 0; i < handle.size(); ++i)
                 handle.set(i, Vec3f(float(random.real(0.1, 1)), float(random.real(-1, 1)), 0).unit());
         }}};
    return all;
}

const Kind& kindOf(const std::string& name)
{
    const auto found =
        std::find_if(kinds().begin(), kinds().end(), [&](const Kind& kind) { return name == kind.name; });
    if (found == kinds().end()) throw std::invalid_argument("no kind of attribute " + name);
    return *found;
}

// Leaves of a grid with random points, as many in each on average.
struct Cloud {
    std::vector<Coord> origins;
    std::uint32_t pointsPerLeaf = 20;
    const char* position = "vec3s";
    math::Transform::Ptr transform = math::Transform::createLinearTransform(0.5);
    std::string name = "points";
};

std::vector<Leaf::ValueType> anyOffsets(std::uint32_t points, Random& random)
{
    std::vector<std::uint32_t> counts(Leaf::SIZE);
    for (std::uint32_t i = 0; i < points; ++i) ++counts[random.below(Leaf::SIZE)];
    std::vector<Leaf::ValueType> ends(Leaf::SIZE);
    std::uint32_t sum = 0;
    for (Index n = 0; n < Leaf::SIZE; ++n) ends[n] = static_cast<Leaf::ValueType>(sum += counts[n]);
    return ends;
}

// Gives a leaf a new set of attributes and random points.
void givePoints(Leaf& leaf, const Descriptor::Ptr& descriptor, const Kind& position, std::uint32_t points,
                Random& random)
{
    leaf.replaceAttributeSet(new AttributeSet(descriptor, points), true);
    leaf.setOffsets(anyOffsets(points, random));
    if (points > 0) position.fill(leaf.attributeArray("P"), random);
}

PointDataGrid::Ptr makeGrid(const Cloud& cloud, Random& random)
{
    const Kind& position = kindOf(cloud.position);
    const auto descriptor = Descriptor::create(position.type);
    const auto grid = PointDataGrid::create();
    for (const Coord& origin : cloud.origins) {
        const std::uint32_t points =
            cloud.pointsPerLeaf == 0 ? 0 : cloud.pointsPerLeaf / 2 + random.below(cloud.pointsPerLeaf + 1);
        givePoints(*grid->tree().touchLeaf(origin), descriptor, position, points, random);
    }
    grid->setName(cloud.name);
    grid->setTransform(cloud.transform);
    return grid;
}

std::vector<Coord> anyOrigins(std::uint32_t count, std::int32_t reach, Random& random)
{
    std::vector<Coord> origins;
    for (std::uint32_t i = 0; i < count; ++i) {
        Coord origin;
        for (int k = 0; k < 3; ++k)
            origin[k] = (static_cast<std::int32_t>(random.below(2 * reach)) - reach) & ~Int32(Leaf::DIM - 1);
        origins.push_back(origin);
    }
    return origins;
}

PointDataGrid::Ptr simpleGrid(Random& random, const char* position = "vec3s",
                              const std::string& name = "points")
{
    Cloud cloud;
    cloud.origins = {Coord(0), Coord(8, 0, 64), Coord(0, 120, 8), Coord(64, 8, 16), Coord(120)};
    cloud.position = position;
    cloud.name = name;
    return makeGrid(cloud, random);
}

void append(PointDataGrid& grid, const Kind& kind, const std::string& name, Random& random, Index stride = 1,
            bool hasConstantStride = true, bool isHidden = false, bool isTransient = false)
{
    points::appendAttribute(grid.tree(), name, kind.type, stride, hasConstantStride, nullptr, isHidden,
                            isTransient);
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        points::AttributeArray& array = leaf->attributeArray(name);
        // The one value that stands in for those of a leaf without points stays as it is.
        if (leaf->getLastValue() > 0) kind.fill(array, random);
    }
}

void appendTexts(PointDataGrid& grid, const std::string& name, Random& random)
{
    points::appendAttribute(grid.tree(), name, points::StringAttributeArray::attributeType());
    if (!grid.tree().beginLeaf()) return;
    const std::vector<std::string> texts = {"water", "", "air and more", "\xc3\xa9"};
    MetaMap& metadata = points::makeDescriptorUnique(grid.tree())->getMetadata();
    points::StringMetaInserter inserter(metadata);
    for (const std::string& text : texts) {
        if (!text.empty()) inserter.insert(text);
    }
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        points::StringAttributeWriteHandle handle(leaf->attributeArray(name), metadata);
        for (Index i = 0; i < leaf->getLastValue(); ++i)
            handle.set(i, texts[random.below(static_cast<std::uint32_t>(texts.size()))]);
    }
}

void appendGroup(PointDataGrid& grid, const std::string& name, Random& random)
{
    points::appendGroup(grid.tree(), name);
    for (auto leaf = grid.tree().beginLeaf(); leaf; ++leaf) {
        points::GroupWriteHandle handle = leaf->groupWriteHandle(name);
        for (Index i = 0; i < leaf->getLastValue(); ++i) handle.set(i, random.flip());
    }
}

// With leaves, tiles of all levels, and values of all kinds.
template <typename GridT>
GridBase::Ptr makeVolume(const typename GridT::ValueType& background, const typename GridT::ValueType& value,
                         const typename GridT::ValueType& other, const std::string& name)
{
    const auto grid = GridT::create(background);
    grid->fill(CoordBBox(Coord(-20), Coord(13)), value);
    grid->fill(CoordBBox(Coord(200), Coord(203)), other, false);
    grid->fill(CoordBBox(Coord(-300, 0, 0), Coord(-290, 3, 3)), other);
    grid->tree().setValueOff(Coord(2, 2, 2), other);
    grid->tree().setValueOff(Coord(3, 2, 2), background);
    grid->tree().addTile(3, Coord(8192), value, true);
    grid->tree().addTile(2, Coord(4096, 0, 0), other, true);
    grid->tree().addTile(1, Coord(4096, 256, 0), other, false);
    grid->setName(name);
    return grid;
}

// With one leaf and one tile.
template <typename GridT>
GridBase::Ptr makeSmallVolume(const typename GridT::ValueType& background,
                              const typename GridT::ValueType& value, const typename GridT::ValueType& other,
                              const std::string& name)
{
    const auto grid = GridT::create(background);
    grid->tree().setValueOn(Coord(1, 2, 3), value);
    grid->tree().setValueOff(Coord(2, 2, 3), other);
    grid->tree().setValueOff(Coord(4, 2, 3), value);
    grid->tree().addTile(1, Coord(64, 0, 0), other, true);
    grid->setName(name);
    return grid;
}

struct VolumeMaker {
    const char* type;
    std::function<GridBase::Ptr(const std::string& name, bool isSmall)> make;
};

template <typename GridT>
VolumeMaker volume(const char* type, const typename GridT::ValueType& background,
                   const typename GridT::ValueType& value, const typename GridT::ValueType& other)
{
    return {type, [=](const std::string& name, bool isSmall) {
                return isSmall ? makeSmallVolume<GridT>(background, value, other, name)
                               : makeVolume<GridT>(background, value, other, name);
            }};
}

const std::vector<VolumeMaker>& volumeMakers()
{
    static const std::vector<VolumeMaker> all = {
        volume<FloatGrid>("float", 0.1f, 2.7f, -3.3f),
        volume<DoubleGrid>("double", 0.1, 2.7, -3.3),
        volume<Int32Grid>("int32", 1, 7, -9),
        volume<Int64Grid>("int64", 1, 7, -9),
        volume<BoolGrid>("bool", false, true, false),
        volume<MaskGrid>("mask", false, true, false),
        volume<Vec3SGrid>("vec3s", Vec3f(0.1f), Vec3f(2, 3, 4), Vec3f(-1)),
        volume<Vec3DGrid>("vec3d", Vec3d(0.1), Vec3d(2, 3, 4), Vec3d(-1)),
        volume<Vec3IGrid>("vec3i", Vec3i(1), Vec3i(2, 3, 4), Vec3i(-1))};
    return all;
}

GridPtrVec allVolumes(bool areSmall)
{
    GridPtrVec grids;
    for (const bool savesHalf : {false, true}) {
        for (const VolumeMaker& maker : volumeMakers()) {
            grids.push_back(maker.make(maker.type + std::string(savesHalf ? "_half" : ""), areSmall));
            grids.back()->setSaveFloatAsHalf(savesHalf);
        }
    }
    return grids;
}

class MemoryArchive : public io::Archive {
public:
    std::string bytesOf(const GridPtrVec& grids, std::uint32_t compression, bool hasOffsets)
    {
        setCompression(compression);
        std::ostringstream out(std::ios::binary);
        MetaMap metadata;
        metadata.insertMeta("creator", StringMetadata("tests"));
        Archive::write(out, grids, hasOffsets, metadata);
        return out.str();
    }
};

std::string file(const GridPtrVec& grids, std::uint32_t compression = kActive)
{
    return MemoryArchive().bytesOf(grids, compression, true);
}

std::string stream(const GridPtrVec& grids, std::uint32_t compression = kActive)
{
    return MemoryArchive().bytesOf(grids, compression, false);
}

// A node of the root in a file: where its origin is, and it follows.
std::size_t findOrigin(const std::string& bytes, const Coord& origin)
{
    return bytes.find(std::string(reinterpret_cast<const char*>(origin.data()), sizeof(Coord)));
}

// Two nodes of one size change places, so that those of the root do not ascend as OpenVDB writes them.
std::string swappedRoots()
{
    Random random(50);
    Cloud cloud;
    // None is a corner of the bounding box, whose numbers stand in the file too.
    cloud.origins = {Coord(-8192, -4096, 4096), Coord(0, 4096, -8192), Coord(4096, -8192, -4096)};
    std::string bytes = file({makeGrid(cloud, random)});
    const std::size_t first = findOrigin(bytes, cloud.origins[0]),
                      third = findOrigin(bytes, cloud.origins[2]);
    const std::size_t size = (third - first) / 2;
    if (third <= first || third > bytes.size() - size)
        throw std::logic_error("swappedRoots: not as expected");
    std::swap_ranges(bytes.begin() + std::ptrdiff_t(first), bytes.begin() + std::ptrdiff_t(first + size),
                     bytes.begin() + std::ptrdiff_t(third));
    return bytes;
}

// A grid whose leaves have different attributes, and some of which have none.
PointDataGrid::Ptr unequalLeaves(Random& random)
{
    const auto grid = PointDataGrid::create();
    const auto position = Descriptor::create(kindOf("vec3s").type);
    const auto more = position->duplicateAppend("density", kindOf("float").type)
                          ->duplicateAppend("id", kindOf("int64").type);
    const auto others = Descriptor::create(kindOf("vec3s_fxpt16").type)
                            ->duplicateAppend("density", kindOf("float_trnc").type);
    int n = 0;
    for (const Coord& origin : anyOrigins(12, 60, random)) {
        Leaf& leaf = *grid->tree().touchLeaf(origin);
        const int which = n++ % 4;
        const auto& descriptor = which == 0 ? position : which == 1 ? more : others;
        if (which == 3) continue; // without attributes
        givePoints(leaf, descriptor, kindOf(which == 2 ? "vec3s_fxpt16" : "vec3s"), 10 + random.below(20),
                   random);
        if (which == 1) {
            kindOf("float").fill(leaf.attributeArray("density"), random);
            kindOf("int64").fill(leaf.attributeArray("id"), random);
        }
        if (which == 2) kindOf("float_trnc").fill(leaf.attributeArray("density"), random);
    }
    grid->setName("points");
    return grid;
}

math::Transform::Ptr transformOf(const std::string& map)
{
    using namespace math;
    const Vec3d scale(0.3, 0.7, 1.1), move(-3, 0.1, 1e5);
    MapBase::Ptr base;
    if (map == "uniform") base.reset(new UniformScaleMap(0.37));
    if (map == "scale") base.reset(new ScaleMap(scale));
    if (map == "negative_scale") base.reset(new ScaleMap(-scale));
    if (map == "uniform_translate") base.reset(new UniformScaleTranslateMap(0.37, move));
    if (map == "scale_translate") base.reset(new ScaleTranslateMap(scale, move));
    if (map == "translate") base.reset(new TranslationMap(move));
    if (map == "unitary") base.reset(new UnitaryMap(Vec3d(1, 2, 3).unit(), 0.6));
    if (map == "affine") {
        base.reset(new AffineMap(
            Mat4d(0.9, 0.2, -0.1, 0., -0.3, 1.1, 0.25, 0., 0.05, -0.4, -0.8, 0., 10., -20., 5., 1.)));
    }
    if (map == "frustum") return Transform::createFrustumTransform(BBoxd(Vec3d(-10), Vec3d(10)), 0.5, 10, 1);
    if (!base) throw std::invalid_argument("no map " + map);
    return Transform::Ptr(new Transform(base));
}

std::string withTransform(const std::string& map)
{
    Random random(60);
    const auto grid = simpleGrid(random);
    grid->setTransform(transformOf(map));
    return file({grid});
}

// Uniform arrays, arrays that were filled and then collapsed, and such that are neither.
std::string uniformArrays()
{
    Random random(3);
    const auto grid = simpleGrid(random);
    points::appendAttribute<float>(grid->tree(), "uniform", 2.5f);
    points::appendAttribute<Vec3f, Position16>(grid->tree(), "uniform_fixed", Vec3f(0.2f, -0.1f, 0.5f));
    append(*grid, kindOf("mat4d"), "collapsed", random);
    points::collapseAttribute<math::Mat4<double>>(grid->tree(), "collapsed");
    append(*grid, kindOf("int32"), "mixed", random);
    int n = 0;
    for (auto leaf = grid->tree().beginLeaf(); leaf; ++leaf) {
        if (n++ % 2) leaf->attributeArray("mixed").compact();
        if (n % 3 == 0) points::AttributeWriteHandle<std::int32_t>(leaf->attributeArray("mixed")).collapse(n);
        if (n == 4) points::AttributeWriteHandle<Vec3f>(leaf->attributeArray("P")).collapse(Vec3f(0.25f));
    }
    return file({grid}, kBlosc | kActive);
}

std::string strided()
{
    Random random(4);
    const auto grid = simpleGrid(random);
    append(*grid, kindOf("float"), "three", random, 3);
    append(*grid, kindOf("vec3s_fxpt16"), "two", random, 2);
    append(*grid, kindOf("int32"), "dynamic", random, 100, false);
    append(*grid, kindOf("float"), "plain", random);
    points::appendAttribute(grid->tree(), "uniform", kindOf("int32").type, 5);
    return file({grid}, kBlosc | kActive);
}

std::string hiddenAndTransient(std::uint32_t compression)
{
    Random random(5);
    const auto grid = simpleGrid(random);
    append(*grid, kindOf("float"), "hidden", random, 1, true, true, false);
    append(*grid, kindOf("double"), "transient", random, 1, true, false, true);
    append(*grid, kindOf("int32"), "both", random, 1, true, true, true);
    append(*grid, kindOf("float"), "last", random);
    return file({grid}, compression);
}

std::string deletedPoints()
{
    Random random(6);
    const auto grid = simpleGrid(random);
    append(*grid, kindOf("int32"), "id", random);
    appendGroup(*grid, "dead", random);
    points::deleteFromGroup(grid->tree(), "dead");
    return file({grid});
}

std::string emptyLeaves()
{
    Random random(7);
    const auto grid = simpleGrid(random);
    append(*grid, kindOf("float"), "density", random);
    const auto descriptor = grid->tree().cbeginLeaf()->attributeSet().descriptorPtr();
    for (const Coord& origin : {Coord(800, 0, 0), Coord(-800, 0, 0), Coord(0, 800, 8)}) {
        Leaf& leaf = *grid->tree().touchLeaf(origin);
        leaf.replaceAttributeSet(new AttributeSet(descriptor, 0), true);
    }
    return file({grid}, kBlosc | kActive);
}

std::string tiles(std::uint32_t compression)
{
    Random random(8);
    const auto grid = simpleGrid(random);
    PointDataTree& tree = grid->tree();
    for (const bool isActive : {false, true}) {
        const int side = isActive ? 1 : -1;
        tree.addTile(3, Coord(side * 16384, 0, 0), 7, isActive);
        tree.addTile(2, Coord(1024 + side * 128, 128, 0), 5, isActive);
        tree.addTile(1, Coord(64 + side * 32, 64, 64), 3, isActive);
    }
    tree.fill(CoordBBox(Coord(100), Coord(120)), 0);
    for (auto leaf = tree.beginLeaf(); leaf; ++leaf) { // those that fill() makes have no attributes
        if (leaf->attributeSet().size() == 0) leaf->setOffsets(std::vector<Leaf::ValueType>(Leaf::SIZE));
    }
    return file({grid}, compression);
}

std::string seams()
{
    Random random(9);
    Cloud cloud;
    for (const std::int32_t seam : {0, 8, 128, 4096, -8, -128, -4096, 8192, -1048576, 1048576}) {
        cloud.origins.push_back(Coord(seam, 0, -seam));
        cloud.origins.push_back(Coord(seam - 8, seam, 0));
    }
    cloud.pointsPerLeaf = 5;
    return file({makeGrid(cloud, random)});
}

std::string texts(std::uint32_t compression)
{
    Random random(10);
    const auto grid = simpleGrid(random);
    appendTexts(*grid, "material", random);
    append(*grid, kindOf("float"), "density", random);
    appendTexts(*grid, "owner", random);
    return file({grid}, compression);
}

std::string groups(std::uint32_t compression)
{
    Random random(11);
    const auto grid = simpleGrid(random);
    for (int i = 0; i < 11; ++i) appendGroup(*grid, "group" + std::to_string(i), random);
    append(*grid, kindOf("float"), "density", random);
    return file({grid}, compression);
}

std::string names()
{
    Random random(12);
    const GridPtrVec grids = {simpleGrid(random, "vec3s", "twice"),
                              makeSmallVolume<FloatGrid>(0, 1, 2, "twice"),
                              simpleGrid(random, "vec3s_trnc", "twice"), simpleGrid(random, "vec3s", ""),
                              simpleGrid(random, "vec3s", "odd[1]")};
    grids[0]->insertMeta("suggested_radius", DoubleMetadata(0.75));
    grids[2]->insertMeta("suggested_radius", FloatMetadata(0.3f));
    grids[4]->insertMeta("suggested_radius", StringMetadata("a text"));
    grids[3]->insertMeta("vector", Vec3DMetadata(Vec3d(1, 2, 3)));
    grids[3]->insertMeta("yes", BoolMetadata(true));
    grids[3]->insertMeta("matrix", Mat4DMetadata(math::Mat4d::identity()));
    return file(grids);
}

GridPtrVec someInstances()
{
    Random random(13);
    const auto grid = simpleGrid(random);
    append(*grid, kindOf("float_ufxpt8"), "density", random);
    const auto instance = PointDataGrid::create(grid->treePtr());
    instance->setName("instance");
    instance->setTransform(math::Transform::createLinearTransform(3));
    instance->insertMeta("suggested_radius", DoubleMetadata(2));
    const auto other = simpleGrid(random, "vec3s_fxpt8", "other");
    const auto volume = gridPtrCast<FloatGrid>(makeSmallVolume<FloatGrid>(0, 1, 2, "volume"));
    const auto volumeInstance = FloatGrid::create(volume->treePtr());
    volumeInstance->setName("volume instance");
    return {grid, volume, instance, volumeInstance, other};
}

std::string withP(const char* position, std::uint32_t compression)
{
    Random random(14);
    return file({simpleGrid(random, position)}, compression);
}

std::string everyAttribute(std::uint32_t compression)
{
    Random random(15);
    const auto grid = simpleGrid(random);
    for (const Kind& kind : kinds()) append(*grid, kind, std::string("a_") + kind.name, random);
    return file({grid}, compression);
}

std::string halfSaved(std::uint32_t compression, bool isStream)
{
    Random random(16);
    const auto grid = simpleGrid(random);
    grid->setSaveFloatAsHalf(true);
    append(*grid, kindOf("float"), "density", random);
    return isStream ? stream({grid, simpleGrid(random, "vec3s", "next")}, compression)
                    : file({grid}, compression);
}

std::string volumesBefore(std::uint32_t compression, bool isStream)
{
    Random random(17);
    GridPtrVec grids = allVolumes(false);
    for (const GridBase::Ptr& grid : someInstances()) grids.push_back(grid);
    grids.push_back(makeVolume<FloatGrid>(0, 1, 2, "behind"));
    return isStream ? stream(grids, compression) : file(grids, compression);
}

// A stream, whose points are found once the volume before them is walked through.
std::string volumeBefore(const VolumeMaker& maker, bool savesHalf, std::uint32_t compression)
{
    Random random(23);
    const GridBase::Ptr volume = maker.make("volume", true);
    volume->setSaveFloatAsHalf(savesHalf);
    return stream({volume, simpleGrid(random)}, compression);
}

// Leaves of which each has more than a page of P.
std::string largeLeaves(std::uint32_t compression)
{
    Random random(18);
    Cloud cloud;
    cloud.origins = {Coord(0), Coord(8, 0, 0), Coord(-800, 0, 0)};
    cloud.pointsPerLeaf = 120000;
    const auto grid = makeGrid(cloud, random);
    append(*grid, kindOf("int8"), "id", random);
    return file({grid}, compression);
}

std::string manyLeaves(std::uint32_t compression)
{
    Random random(19);
    Cloud cloud;
    cloud.origins = anyOrigins(6000, 700, random);
    cloud.pointsPerLeaf = 3;
    const auto grid = makeGrid(cloud, random);
    append(*grid, kindOf("double"), "density", random);
    append(*grid, kindOf("vec3s_fxpt8"), "v", random);
    appendGroup(*grid, "some", random);
    return file({grid}, compression);
}

std::string severalPages(std::uint32_t compression)
{
    Random random(20);
    Cloud cloud;
    cloud.origins = anyOrigins(200, 80, random);
    cloud.pointsPerLeaf = 700;
    const auto grid = makeGrid(cloud, random);
    append(*grid, kindOf("int64"), "id", random);
    return file({grid}, compression);
}

using Maker = std::function<std::string()>;

struct Named {
    std::string name;
    Maker make;
    bool isLarge;
};

void add(std::vector<Named>& cases, const std::string& name, Maker make, bool isLarge = false)
{
    cases.push_back({name, std::move(make), isLarge});
}

std::vector<Named> allCases()
{
    std::vector<Named> cases;
    const std::pair<const char*, std::uint32_t> compressions[] = {
        {"plain", kPlain}, {"mask", kActive},
        {"zip", kZip},     {"zip_mask", kZip | kActive},
        {"blosc", kBlosc}, {"blosc_mask", kBlosc | kActive}};
    for (const auto& [text, flags] : compressions) {
        const std::string suffix = std::string("_") + text;
        const std::uint32_t c = flags;
        for (const char* p : {"vec3s", "vec3s_trnc", "vec3s_fxpt8", "vec3s_fxpt16"})
            add(cases, std::string("p_") + p + suffix, [p, c] { return withP(p, c); });
        add(cases, "attributes" + suffix, [c] { return everyAttribute(c); });
        add(cases, "texts" + suffix, [c] { return texts(c); });
        add(cases, "groups" + suffix, [c] { return groups(c); });
        add(cases, "tiles" + suffix, [c] { return tiles(c); });
        add(cases, "hidden" + suffix, [c] { return hiddenAndTransient(c); });
        add(cases, "half" + suffix, [c] { return halfSaved(c, false); });
        add(cases, "half_stream" + suffix, [c] { return halfSaved(c, true); });
        add(
            cases, "volumes" + suffix, [c] { return volumesBefore(c, false); }, true);
        add(
            cases, "volumes_stream" + suffix, [c] { return volumesBefore(c, true); }, true);
        for (const VolumeMaker& maker : volumeMakers()) {
            for (const bool savesHalf : {false, true}) {
                add(cases, std::string("volume_") + maker.type + (savesHalf ? "_half" : "") + suffix,
                    [&maker, savesHalf, c] { return volumeBefore(maker, savesHalf, c); });
            }
        }
        add(cases, "unequal" + suffix, [c] {
            Random random(21);
            return file({unequalLeaves(random)}, c);
        });
        add(
            cases, "large_leaves" + suffix, [c] { return largeLeaves(c); }, true);
        add(
            cases, "many_leaves" + suffix, [c] { return manyLeaves(c); }, true);
        add(
            cases, "several_pages" + suffix, [c] { return severalPages(c); }, true);
    }
    for (const char* map : {"uniform", "scale", "negative_scale", "uniform_translate", "scale_translate",
                            "translate", "unitary", "affine", "frustum"})
        add(cases, std::string("map_") + map, [map] { return withTransform(map); });
    add(cases, "map_frustum_stream", [] {
        Random random(61);
        const auto grid = simpleGrid(random, "vec3s", "bent");
        grid->setTransform(transformOf("frustum"));
        return stream({grid, simpleGrid(random)});
    });
    add(cases, "uniform_arrays", uniformArrays);
    add(cases, "strided", strided);
    add(cases, "deleted", deletedPoints);
    add(cases, "empty_leaves", emptyLeaves);
    add(cases, "seams", seams);
    add(cases, "names", names);
    add(cases, "swapped_roots", swappedRoots);
    add(cases, "instances", [] { return file(someInstances()); });
    add(cases, "instances_stream", [] { return stream(someInstances(), kBlosc | kActive); });
    add(cases, "no_leaves", [] {
        Random random(1);
        return file({makeGrid(Cloud(), random)});
    });
    add(cases, "no_leaves_stream", [] {
        Random random(1);
        return stream({makeGrid(Cloud(), random), simpleGrid(random, "vec3s", "next")});
    });
    add(cases, "no_points", [] {
        Random random(1);
        Cloud cloud;
        cloud.origins = {Coord(0), Coord(800)};
        cloud.pointsPerLeaf = 0;
        return file({makeGrid(cloud, random)});
    });
    add(cases, "no_grids", [] { return file({}); });
    return cases;
}

std::vector<std::string> namesOf(bool withLarge)
{
    std::vector<std::string> names;
    for (const Named& item : allCases()) {
        if (withLarge || !item.isLarge) names.push_back(item.name);
    }
    return names;
}

PointDataGrid::Ptr randomGrid(Random& random)
{
    static const char* const kPositions[] = {"vec3s", "vec3s_trnc", "vec3s_fxpt8", "vec3s_fxpt16"};
    static const char* const kMaps[] = {"uniform",         "scale",     "negative_scale", "uniform_translate",
                                        "scale_translate", "translate", "unitary",        "affine"};
    if (random.below(8) == 0) return unequalLeaves(random);
    Cloud cloud;
    const bool isSmall = random.flip();
    cloud.origins = anyOrigins(random.below(isSmall ? 8 : 30), isSmall ? 8 : 9000, random);
    cloud.pointsPerLeaf = !isSmall && random.below(3) == 0 ? 900 : random.below(12);
    cloud.position = kPositions[random.below(4)];
    cloud.transform = transformOf(kMaps[random.below(8)]);
    cloud.name = random.below(5) == 0 ? "" : "grid" + std::to_string(random.below(3));
    const auto grid = makeGrid(cloud, random);
    for (std::uint32_t left = random.below(5), n = 0; left > 0; --left, ++n) {
        const std::string name = "attribute" + std::to_string(n);
        const Kind& kind = kinds()[random.below(static_cast<std::uint32_t>(kinds().size()))];
        switch (random.below(6)) {
        case 0:
            appendTexts(*grid, name, random);
            break;
        case 1:
            appendGroup(*grid, name, random);
            break;
        case 2: // uniform
            points::appendAttribute(grid->tree(), name, kind.type, 1, true, nullptr, random.flip());
            break;
        case 3:
            append(*grid, kind, name, random, 1 + random.below(3), true, random.flip(), random.below(3) == 0);
            break;
        default:
            append(*grid, kind, name, random);
        }
    }
    if (random.below(4) == 0) grid->tree().addTile(1 + random.below(3), Coord(1 << 15), 3, random.flip());
    grid->setSaveFloatAsHalf(random.below(4) == 0);
    return grid;
}

} // namespace

std::vector<std::string> vdbCaseNames()
{
    return namesOf(true);
}

std::vector<std::string> smallVdbCaseNames()
{
    return namesOf(false);
}

std::string makeVdbCase(const std::string& name)
{
    openvdb::initialize();
    for (const Named& item : allCases()) {
        if (item.name == name) return item.make();
    }
    throw std::invalid_argument("no kind of .vdb file " + name);
}

std::string makeRandomVdb(std::uint32_t seed)
{
    openvdb::initialize();
    Random random(seed);
    GridPtrVec grids;
    for (std::uint32_t left = 1 + random.below(3); left > 0; --left) {
        if (random.below(5) == 0) {
            const GridPtrVec volumes = allVolumes(random.flip());
            grids.push_back(volumes[random.below(static_cast<std::uint32_t>(volumes.size()))]);
        }
        const auto grid = randomGrid(random);
        grids.push_back(grid);
        if (random.below(4) == 0) {
            const auto instance = PointDataGrid::create(grid->treePtr());
            instance->setName("instance");
            grids.push_back(instance);
        }
    }
    static constexpr std::uint32_t kCompressions[] = {kPlain, kZip, kBlosc};
    const std::uint32_t compression = kCompressions[random.below(3)] | (random.flip() ? kActive : kPlain);
    return random.flip() ? file(grids, compression) : stream(grids, compression);
}

std::string makeManyInstances(std::uint32_t instances)
{
    openvdb::initialize();
    Random random(24);
    const auto grid = simpleGrid(random);
    GridPtrVec grids = {grid};
    for (std::uint32_t i = 0; i < instances; ++i) {
        grids.push_back(PointDataGrid::create(grid->treePtr()));
        grids.back()->setName("instance");
    }
    return stream(grids);
}

std::string makeUniformVdb(std::uint32_t leaves, std::uint32_t pointsPerLeaf)
{
    openvdb::initialize();
    const auto grid = PointDataGrid::create();
    const auto descriptor = Descriptor::create(kindOf("vec3s").type);
    for (std::uint32_t i = 0; i < leaves; ++i) {
        Leaf& leaf = *grid->tree().touchLeaf(Coord(static_cast<std::int32_t>(8 * i), 0, 0));
        leaf.replaceAttributeSet(new AttributeSet(descriptor, pointsPerLeaf), true);
        leaf.setOffsets(std::vector<Leaf::ValueType>(Leaf::SIZE, Leaf::ValueType(pointsPerLeaf)));
    }
    grid->setName("points");
    return file({grid}, kBlosc | kActive);
}

std::string makeScatteredVdb(std::uint32_t points)
{
    openvdb::initialize();
    Random random(22);
    Cloud cloud;
    cloud.origins = anyOrigins(points / 4, 1500, random);
    cloud.pointsPerLeaf = 4;
    return file({makeGrid(cloud, random)}, kBlosc | kActive);
}

} // namespace vdb_nns::testing
