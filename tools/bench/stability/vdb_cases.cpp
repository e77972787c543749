// Cases about point grids: transforms, codecs, offsets and grids that are unusual. The only ones with OpenVDB's headers.
#include "bench/stability/case_points.h"
#include "vdb_nns/openvdb_bridge.h"

#include <openvdb/points/PointAttribute.h>

#include <cmath>
#include <limits>
#include <map>

namespace vdb_nns::cli {
namespace {

using openvdb::Coord;
using openvdb::points::PointDataGrid;
using openvdb::points::PointDataTree;
using TransformPtr = openvdb::math::Transform::Ptr;
namespace points = openvdb::points;

using NullP = points::TypedAttributeArray<openvdb::Vec3f, points::NullCodec>;
using TruncateP = points::TypedAttributeArray<openvdb::Vec3f, points::TruncateCodec>;
using Fixed16P =
    points::TypedAttributeArray<openvdb::Vec3f, points::FixedPointCodec<false, points::PositionRange>>;
using Fixed8P =
    points::TypedAttributeArray<openvdb::Vec3f, points::FixedPointCodec<true, points::PositionRange>>;

struct VoxelPoint {
    Coord voxel;
    openvdb::Vec3f offset; // in voxels; as it is, inside the voxel or not
};

// A grid with such a P, written leaf by leaf: createPointDataGrid() would move points to the voxels that they are in.
template <typename P>
PointDataGrid::Ptr makeGrid(const std::vector<VoxelPoint>& stored, const TransformPtr& transform)
{
    using Leaf = PointDataTree::LeafNodeType;
    openvdb::initialize();
    const auto descriptor = points::AttributeSet::Descriptor::create(P::attributeType());
    std::map<Coord, std::map<openvdb::Index, std::vector<openvdb::Vec3f>>> leaves;
    for (const VoxelPoint& point : stored) {
        leaves[point.voxel & ~openvdb::Int32(Leaf::DIM - 1)][Leaf::coordToOffset(point.voxel)].push_back(
            point.offset);
    }
    const auto grid = PointDataGrid::create();
    for (const auto& [origin, voxels] : leaves) {
        std::vector<openvdb::Vec3f> values;
        std::vector<Leaf::ValueType> ends(Leaf::SIZE);
        auto voxel = voxels.begin();
        for (openvdb::Index n = 0; n < Leaf::SIZE; ++n) {
            if (voxel != voxels.end() && voxel->first == n) {
                values.insert(values.end(), voxel->second.begin(), voxel->second.end());
                ++voxel;
            }
            ends[n] = static_cast<openvdb::Index32>(values.size());
        }
        Leaf* const leaf = grid->tree().touchLeaf(origin);
        leaf->initializeAttributes(descriptor, static_cast<openvdb::Index>(values.size()));
        leaf->setOffsets(ends);
        points::AttributeWriteHandle<openvdb::Vec3f> handle(leaf->attributeArray("P"));
        for (openvdb::Index i = 0; i < values.size(); ++i) handle.set(i, values[i]);
    }
    grid->setTransform(transform);
    return grid;
}

CaseParticles asParticles(const PointDataGrid::Ptr& grid, double radius)
{
    CaseParticles particles = {viewOf(grid), radius, KnownRows::kUnknown, grid};
    const openvdb::Vec3d origin = grid->indexToWorld(openvdb::Vec3d(0)); // exact: the transform is affine
    particles.translation = {origin[0], origin[1], origin[2]};
    return particles;
}

// Two points in every voxel of a cube whose middle is that voxel.
std::vector<VoxelPoint> cloud(int edge, const Coord& middle = Coord(0))
{
    std::vector<VoxelPoint> stored;
    CaseRandom random(11);
    for (int i = 0; i < edge * edge * edge; ++i) {
        const Coord voxel(i / (edge * edge) - edge / 2, i / edge % edge - edge / 2, i % edge - edge / 2);
        for (int k = 0; k < 2; ++k)
            stored.push_back({voxel + middle, openvdb::Vec3f(random.point(0.5).data())});
    }
    return stored;
}

TransformPtr voxelsOf(double edge)
{
    return openvdb::math::Transform::createLinearTransform(edge);
}

// The images of the axes, as OpenVDB's row vectors have them.
TransformPtr affine(const openvdb::Vec3d& x, const openvdb::Vec3d& y, const openvdb::Vec3d& z,
                    const openvdb::Vec3d& translation = openvdb::Vec3d(0))
{
    openvdb::Mat4d matrix = openvdb::Mat4d::identity();
    matrix.setMat3(openvdb::Mat3d(x, y, z, true));
    matrix.setTranslation(translation);
    return openvdb::math::Transform::createLinearTransform(matrix);
}

TransformPtr rotated(double degrees)
{
    const TransformPtr transform = voxelsOf(1);
    transform->postRotate(degrees * M_PI / 180, openvdb::math::Z_AXIS);
    transform->postRotate(0.4 * degrees * M_PI / 180, openvdb::math::X_AXIS);
    return transform;
}

constexpr int kEdge = 13; // 4394 points

void addTransforms(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, double radius,
                              TransformPtr (*transform)()) {
        cases.push_back({"transforms", name, what,
                         [=] { return asParticles(makeGrid<NullP>(cloud(kEdge), transform()), radius); }});
    };
    add("non-uniform", "voxels of 1 x 2 x 0.5: OpenVDB's radial queries ask for cubes and do not check", 1.4,
        [] {
            return affine({1, 0, 0}, {0, 2, 0}, {0, 0, 0.5});
        });
    add("rotated", "voxels turned by 30 degrees: NanoVDB #1840 mistakes their size", 1.4,
        [] { return rotated(30); });
    add("sheared", "voxels sheared: MDAnalysis #2657, triclinic cells", 1.4, [] {
        return affine({1, 0.5, -0.3}, {0, 1, 0.7}, {0, 0, 1});
    });
    add("reflected", "voxels of negative determinant", 0.42, [] {
        return affine({0.3, 0, 0}, {0, -0.3, 0}, {0, 0, 0.3});
    });
    add("rotated-non-uniform", "voxels turned, of 1 x 2 x 0.01", 1.4, [] {
        return affine({0.6, 0.8, 0}, {-1.6, 1.2, 0}, {0, 0, 0.01});
    });
    add("translated",
        "voxels of 0.7 turned by 45 degrees and half a voxel off: a cull in voxels at world radii", 1, [] {
            const TransformPtr transform = rotated(45);
            transform->preScale(0.7);
            transform->postTranslate({0.35, -0.35, 1e4});
            return transform;
        });
    add("far-transform", "voxels of 0.1 at 1e6: float32 world positions have steps of 0.06", 0.14, [] {
        const TransformPtr transform = voxelsOf(0.1);
        transform->postTranslate({1e6, -1e6, 3e5});
        return transform;
    });
    add("voxels-1e-4", "voxels of 1e-4", 1.4e-4, [] { return voxelsOf(1e-4); });
    add("voxels-1e6", "voxels of 1e6", 1.4e6, [] { return voxelsOf(1e6); });
    cases.push_back({"transforms", "far-voxels",
                     "1e7 voxels from the origin, where voxels are exact and floats are not", [] {
                         return asParticles(
                             makeGrid<NullP>(cloud(kEdge, Coord(10'000'000, -9'999'999, 7)), voxelsOf(0.1)),
                             0.14);
                     }});
    cases.push_back({"transforms",
                     "frustum",
                     "a frustum has no linear part: to be refused, OpenVDB #2087",
                     [] {
                         const auto frustum = openvdb::math::Transform::createFrustumTransform(
                             openvdb::BBoxd(openvdb::Vec3d(-10), openvdb::Vec3d(10)), 0.5, 10, 1);
                         return asParticles(makeGrid<NullP>(cloud(3), frustum), 1);
                     },
                     {},
                     [](const MethodSpec&) { return RightOutcome::kRefusal; },
                     "resample the points"});
}

template <typename P>
CaseParticles encoded()
{
    return asParticles(makeGrid<P>(cloud(kEdge), voxelsOf(0.1)), 0.14);
}

void addCodecs(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, CaseParticles (*make)()) {
        cases.push_back({"codecs", name, what, make});
    };
    add("codec-null", "P as floats", encoded<NullP>);
    add("codec-trnc", "P as half floats", encoded<TruncateP>);
    add("codec-fxpt16", "P in steps of 1 / 65535 voxel: dneg #4, half of the range", encoded<Fixed16P>);
    add("codec-fxpt8", "P in steps of 1 / 255 voxel, with points on the faces of voxels", encoded<Fixed8P>);
    add("voxel-cells", "radius between half a voxel and one, where voxels serve as cells",
        [] { return asParticles(makeGrid<Fixed8P>(cloud(kEdge), voxelsOf(1)), 0.875); });
}

void addUnusual(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* group, const char* name, const char* what,
                              CaseParticles (*make)()) {
        cases.push_back({group, name, what, make});
    };
    add("few", "grid-empty", "a grid without leaves",
        [] { return asParticles(makeGrid<NullP>({}, voxelsOf(1)), 1); });
    add("few", "grid-of-tiles", "a grid of active tiles, without a point", [] {
        const PointDataGrid::Ptr grid = makeGrid<NullP>({}, voxelsOf(1));
        grid->tree().addTile(1, Coord(0), PointDataTree::ValueType(0), true);
        return asParticles(grid, 1);
    });
    add("few", "grid-of-voxels", "active voxels without a point beside points", [] {
        const PointDataGrid::Ptr grid = makeGrid<NullP>(cloud(4), voxelsOf(1));
        grid->tree().beginLeaf()->setValuesOn();
        return asParticles(grid, 1.4);
    });
    add("radius", "radius-of-1-voxel-100", "radius of a hundredth of a voxel, 60 points in each", [] {
        std::vector<VoxelPoint> stored;
        for (int k = 0; k < 30; ++k) {
            for (const VoxelPoint& point : cloud(4))
                stored.push_back({point.voxel, point.offset * (1 + 0.003f * static_cast<float>(k))});
        }
        return asParticles(makeGrid<NullP>(stored, voxelsOf(1)), 0.01);
    });
    add("non-finite", "offset-outside", "P up to 3 voxels outside its voxel, which damaged files have", [] {
        std::vector<VoxelPoint> stored = cloud(kEdge);
        for (std::size_t i = 0; i < stored.size(); i += 3) stored[i].offset *= i % 2 ? 1.4f : 6.0f;
        return asParticles(makeGrid<NullP>(stored, voxelsOf(1)), 1.4);
    });
    add("non-finite", "nan-in-grid", "NaN and infinite P: PCL #4414, bad indices", [] {
        std::vector<VoxelPoint> stored = cloud(kEdge);
        const float bad[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()};
        for (std::size_t i = 3; i < stored.size(); i += 101)
            stored[i].offset[static_cast<int>(i % 3)] = bad[i % 2];
        return asParticles(makeGrid<NullP>(stored, voxelsOf(1)), 1.4);
    });
}

} // namespace

std::vector<StabilityCase> vdbCases()
{
    std::vector<StabilityCase> cases;
    addTransforms(cases);
    addCodecs(cases);
    addUnusual(cases);
    return cases;
}

} // namespace vdb_nns::cli
