// An OpenVDB point grid in, the same grid with ellipsoids out, from which the rasterizeSdf() of OpenVDB makes a surface that
// is thin where the fluid is (Yu and Turk 2010): `stretch`, `xform`, `pws` and the group `ellipsoids`.
//   sample_surfacing [IN.vdb OUT.vdb RADIUS]
// Without arguments it makes a sheet of points and checks that its ellipsoids are flat and lie in it.
// Built with OpenVDB 13 it also makes the surface; before, EllipsoidSettings does not take these attributes.
#include <vdb_nns/error.h>
#include <vdb_nns/measure.h>
#include <vdb_nns/openvdb_bridge.h>

#include <openvdb/io/File.h>
#include <openvdb/points/AttributeArray.h>
#include <openvdb/points/PointConversion.h>
#if OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER >= 13
#include <openvdb/points/PointRasterizeSDF.h>
#endif

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>
#include <vector>

using openvdb::points::PointDataGrid;

namespace {

PointDataGrid::Ptr readPoints(const std::string& path)
{
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false);
    const openvdb::GridPtrVecPtr grids = file.getGrids();
    for (const openvdb::GridBase::Ptr& grid : *grids)
        if (grid->isType<PointDataGrid>()) return openvdb::gridPtrCast<PointDataGrid>(grid);
    throw vdb_nns::InputError(path + " has no point grid");
}

// A sheet two points thick, 1 apart, in a plane that no axis of the grid lies in.
PointDataGrid::Ptr makeSheet(openvdb::Vec3d& normal)
{
    const openvdb::Vec3d across = openvdb::Vec3d(1, -1, 0).unit(), along = openvdb::Vec3d(1, 1, 1).unit();
    normal = across.cross(along);
    std::vector<openvdb::Vec3s> positions;
    for (int u = 0; u < 60; ++u)
        for (int v = 0; v < 60; ++v)
            for (int w = 0; w < 2; ++w) positions.emplace_back(u * across + v * along + w * normal);
    const auto transform = openvdb::math::Transform::createLinearTransform(/*voxelSize=*/2.0);
    return openvdb::points::createPointDataGrid<openvdb::points::NullCodec, PointDataGrid>(positions,
                                                                                           *transform);
}

openvdb::GridPtrVec makeSurface(const PointDataGrid::Ptr& grid, [[maybe_unused]] double radius)
{
    openvdb::GridPtrVec grids = {grid};
#if OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER >= 13
    openvdb::points::EllipsoidSettings<> settings;
    settings.radius = "stretch";
    settings.radiusScale = openvdb::Vec3d(0.4 * radius); // world units, of a point that is not stretched
    settings.pws = "pws"; // by default the smoothed positions are not looked at
    settings.transform = openvdb::math::Transform::createLinearTransform(radius / 6);
    for (const openvdb::GridBase::Ptr& surface : openvdb::points::rasterizeSdf(*grid, settings)) {
        surface->setName("surface");
        std::printf("surface of %llu voxels\n", static_cast<unsigned long long>(surface->activeVoxelCount()));
        grids.push_back(surface);
    }
#endif
    return grids;
}

// How many points have an ellipsoid whose shortest axis is the normal, within a degree or so, and at least 1.5 times shorter
// than the others.
std::size_t flatPoints(const PointDataGrid& grid, const openvdb::Vec3d& normal)
{
    std::size_t flat = 0;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const openvdb::points::AttributeHandle<openvdb::Vec3s> stretch(leaf->constAttributeArray("stretch"));
        const openvdb::points::AttributeHandle<openvdb::Mat3s> xform(leaf->constAttributeArray("xform"));
        for (auto point = leaf->beginIndexAll(); point; ++point) {
            const openvdb::Vec3s lengths = stretch.get(*point); // descending
            const openvdb::Vec3d shortest = xform.get(*point).col(2);
            flat += lengths[1] > 1.5f * lengths[2] && std::abs(shortest.dot(normal)) > 0.9998;
        }
    }
    return flat;
}

int run(int argc, char** argv)
{
    const bool isDemo = argc != 4;
    openvdb::initialize();
    openvdb::Vec3d normal;
    const PointDataGrid::Ptr grid = isDemo ? makeSheet(normal) : readPoints(argv[1]);
    const double radius = isDemo ? 4.0 : std::stod(argv[3]); // some four spacings give an ellipsoid its shape
    const std::string out =
        isDemo ? (std::filesystem::temp_directory_path() / "vdb_nns_sample_surfacing.vdb").string() : argv[2];

    const vdb_nns::PointValues ellipsoids = vdb_nns::measure(vdb_nns::viewOf(grid), radius, {"pca"});
    vdb_nns::addPointValues(*grid, ellipsoids);
    openvdb::io::File(out).write(makeSurface(grid, radius));

    const std::uint8_t* const isIn = ellipsoids.groups.at(0).members.get();
    const std::size_t points = static_cast<std::size_t>(ellipsoids.groups[0].count);
    std::printf("%zu points, %td with an ellipsoid\n", points, std::count(isIn, isIn + points, 1));
    if (!isDemo) return 0;
    const std::size_t flat = flatPoints(*readPoints(out), normal);
    std::filesystem::remove(out);
    std::printf("%zu flat and in the sheet\n", flat);
    return flat > points * 85 / 100 ? 0 : 1; // those at the rim lean
}

} // namespace

int main(int argc, char** argv)
{
    try {
        return run(argc, argv);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
