// Writes the .vdb files that the command line tests need and that no scene makes: unsupported, damaged and unusual ones.
// Usage: make_fixtures FOLDER
#include <openvdb/openvdb.h>
#include <openvdb/points/PointAttribute.h>
#include <openvdb/points/PointDataGrid.h>
#include <openvdb/points/PointGroup.h>

#include <cmath>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <string>
#include <vector>

namespace {

using namespace openvdb;
using points::PointDataGrid;
using points::PointDataTree;

struct StoredPoint {
    Coord voxel;
    Vec3f offset;
};

using PlainP = points::TypedAttributeArray<Vec3f>;

std::string gFolder;

// A point grid whose P array is of any type; offsets are stored as they are, in range or not.
template <typename ArrayT>
PointDataGrid::Ptr makeGrid(const std::string& name, const std::vector<StoredPoint>& stored,
                            const math::Transform::Ptr& transform)
{
    using Leaf = PointDataTree::LeafNodeType;
    const auto descriptor = points::AttributeSet::Descriptor::create(ArrayT::attributeType());
    std::map<Coord, std::map<Index, std::vector<Vec3f>>> leaves;
    for (const StoredPoint& point : stored) {
        const Coord origin = point.voxel & ~Int32(Leaf::DIM - 1);
        leaves[origin][Leaf::coordToOffset(point.voxel)].push_back(point.offset);
    }
    const auto grid = PointDataGrid::create();
    for (const auto& [origin, voxels] : leaves) {
        std::vector<Vec3f> values;
        std::vector<Leaf::ValueType> offsets(Leaf::SIZE);
        auto voxel = voxels.begin();
        for (Index n = 0; n < Leaf::SIZE; ++n) {
            if (voxel != voxels.end() && voxel->first == n) {
                values.insert(values.end(), voxel->second.begin(), voxel->second.end());
                ++voxel;
            }
            offsets[n] = static_cast<Index32>(values.size());
        }
        Leaf* leaf = grid->tree().touchLeaf(origin);
        // Not initializeAttributes(): that allows no P but vec3s.
        leaf->replaceAttributeSet(new points::AttributeSet(descriptor, static_cast<Index>(values.size())),
                                  true);
        leaf->setOffsets(offsets);
        points::AttributeWriteHandle<typename ArrayT::ValueType> handle(leaf->attributeArray("P"));
        for (Index i = 0; i < values.size(); ++i) handle.set(i, typename ArrayT::ValueType(values[i]));
    }
    grid->setName(name);
    grid->setTransform(transform);
    return grid;
}

math::Transform::Ptr unit(double voxelSize = 1)
{
    return math::Transform::createLinearTransform(voxelSize);
}

void write(const std::string& name, const GridPtrVec& grids)
{
    io::File file(gFolder + "/" + name);
    file.write(grids);
    file.close();
}

// Counter-based noise in [-0.5, 0.5), the same everywhere.
float noise(std::uint64_t n)
{
    n = (n + 1) * 0x9e3779b97f4a7c15ull;
    n = (n ^ (n >> 30)) * 0xbf58476d1ce4e5b9ull;
    n = (n ^ (n >> 27)) * 0x94d049bb133111ebull;
    return static_cast<float>(static_cast<double>((n ^ (n >> 31)) >> 40) / 16777216.0 - 0.5);
}

// `side`^3 voxels around the origin with two points each.
std::vector<StoredPoint> cloud(int side)
{
    std::vector<StoredPoint> points;
    std::uint64_t n = 0;
    for (int i = 0; i < side * side * side; ++i) {
        const Coord voxel(i / (side * side) - side / 2, i / side % side - side / 2, i % side - side / 2);
        for (int k = 0; k < 2; ++k, n += 3) points.push_back({voxel, {noise(n), noise(n + 1), noise(n + 2)}});
    }
    return points;
}

void writeUnsupported()
{
    const std::vector<StoredPoint> few = cloud(4);
    write("no_points.vdb", {FloatGrid::create(1.0f)});
    write("p_vec3d.vdb", {makeGrid<points::TypedAttributeArray<Vec3d>>("points", few, unit())});
    write("p_uvec.vdb",
          {makeGrid<points::TypedAttributeArray<Vec3f, points::UnitVecCodec>>("points", few, unit())});
    using UnitRange = points::FixedPointCodec<false, points::UnitRange>;
    write("p_ufxpt16.vdb", {makeGrid<points::TypedAttributeArray<Vec3f, UnitRange>>("points", few, unit())});

    const auto renamed = makeGrid<PlainP>("points", few, unit());
    points::renameAttribute(renamed->tree(), "P", "Q");
    write("p_missing.vdb", {renamed});

    const BBoxd box(Vec3d(-10), Vec3d(10));
    const auto frustum = math::Transform::createFrustumTransform(box, 0.5, 10, 1);
    write("frustum.vdb", {makeGrid<PlainP>("points", few, frustum)});

    // The scale is a number that a test finds in the file and overwrites with zeros: OpenVDB makes no singular map.
    math::Mat4d matrix = math::Mat4d::identity();
    matrix[0][0] = 0.7310585786300049;
    write("scale_to_patch.vdb",
          {makeGrid<PlainP>("points", few, math::Transform::createLinearTransform(matrix))});
}

void writeDamaged()
{
    const auto grid = makeGrid<PlainP>("points", cloud(4), unit());
    auto leaf = grid->tree().beginLeaf();
    std::vector<PointDataTree::LeafNodeType::ValueType> offsets(PointDataTree::LeafNodeType::SIZE);
    for (Index n = 0; n < offsets.size(); ++n) offsets[n] = n * 1000; // far past the end of P
    leaf->setOffsets(offsets);
    write("bad_offsets.vdb", {grid});
}

void writeUnusual()
{
    write("two_grids.vdb", {makeGrid<PlainP>("first", cloud(3), unit()),
                            makeGrid<PlainP>("second", cloud(5), unit()), FloatGrid::create(1.0f)});
    write("empty.vdb", {makeGrid<PlainP>("points", {}, unit())});
    write("one.vdb", {makeGrid<PlainP>("points", {{Coord(3, -4, 5), Vec3f(0.25f, 0, 0)}}, unit())});
    const auto tiles = makeGrid<PlainP>("points", {}, unit());
    tiles->tree().addTile(1, Coord(0), PointDataTree::ValueType(0), true);
    write("tiles.vdb", {tiles});

    std::vector<StoredPoint> spoilt = cloud(4);
    const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    spoilt[5].offset[1] = nan;
    spoilt[70].offset[0] = inf;
    spoilt[100].offset[2] = -inf;
    write("nonfinite.vdb", {makeGrid<PlainP>("points", spoilt, unit())});
}

// Where points are in the world, as raw doubles.
void writePositions(const std::string& name, const PointDataGrid& grid)
{
    std::ofstream positions(gFolder + "/" + name, std::ios::binary);
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const points::AttributeHandle<Vec3f> handle(leaf->constAttributeArray("P"));
        for (auto index = leaf->beginIndexAll(); index; ++index) {
            const Vec3d world = grid.indexToWorld(index.getCoord().asVec3d() + Vec3d(handle.get(*index)));
            positions.write(reinterpret_cast<const char*>(world.asV()), 3 * sizeof(double));
        }
    }
}

// Points far out of their voxels under a general affine map.
void writeAffine()
{
    std::vector<StoredPoint> stored = cloud(6);
    for (std::size_t i = 0; i < stored.size(); ++i) {
        if (i % 3 == 0) stored[i].offset *= 7.0f;
    }
    const math::Mat4d matrix(0.9, 0.2, -0.1, 0.0, -0.3, 1.1, 0.25, 0.0, 0.05, -0.4, -0.8, 0.0, 10.0, -20.0,
                             5.0, 1.0);
    const auto grid = makeGrid<PlainP>("points", stored, math::Transform::createLinearTransform(matrix));
    write("affine.vdb", {grid});
    writePositions("affine.f64", *grid);
}

// Two grids under two transforms, the first with radii and groups: "pscale" (float) and "mass" (double) are 0.05 times
// 1, 2, ... 7 in turn, "even" and "third" hold every second and third point, "v" is a vector.
void writeNamedValues()
{
    const auto first = makeGrid<PlainP>("points", cloud(7), unit(0.25));
    points::appendAttribute<float>(first->tree(), "pscale");
    points::appendAttribute<double>(first->tree(), "mass");
    points::appendAttribute<Vec3f>(first->tree(), "v");
    points::appendAttribute<Int32>(first->tree(), "id");
    for (const char* const group : {"even", "third"}) points::appendGroup(first->tree(), group);
    int number = 0;
    for (auto leaf = first->tree().beginLeaf(); leaf; ++leaf) {
        points::AttributeWriteHandle<float> floats(leaf->attributeArray("pscale"));
        points::AttributeWriteHandle<double> doubles(leaf->attributeArray("mass"));
        points::GroupWriteHandle even = leaf->groupWriteHandle("even"),
                                 third = leaf->groupWriteHandle("third");
        for (auto index = leaf->beginIndexAll(); index; ++index, ++number) {
            floats.set(*index, 0.05f * static_cast<float>(1 + number % 7));
            doubles.set(*index, 0.05 * (1 + number % 7));
            even.set(*index, number % 2 == 0);
            third.set(*index, number % 3 == 0);
        }
    }
    const math::Mat4d matrix(0.2, 0.03, -0.01, 0.0, -0.02, 0.3, 0.05, 0.0, 0.01, -0.04, -0.25, 0.0, 0.1, -0.2,
                             0.05, 1.0);
    const auto second = makeGrid<PlainP>("probes", cloud(4), math::Transform::createLinearTransform(matrix));
    write("named_values.vdb", {first, second});
    writePositions("named_values_points.f64", *first);
    writePositions("named_values_probes.f64", *second);
}

} // namespace

int main(int argc, char** argv)
{
    if (argc != 2) {
        std::cerr << "usage: make_fixtures FOLDER\n";
        return 2;
    }
    gFolder = argv[1];
    try {
        openvdb::initialize();
        writeUnsupported();
        writeDamaged();
        writeUnusual();
        writeAffine();
        writeNamedValues();
    } catch (const std::exception& e) {
        std::cerr << "make_fixtures: " << e.what() << "\n";
        return 1;
    }
    return 0;
}
