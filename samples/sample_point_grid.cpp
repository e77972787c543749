// An OpenVDB point grid in, the same grid with an attribute `nns_count` out: how many neighbors each point has.
//   sample_point_grid [IN.vdb OUT.vdb RADIUS]
// Without arguments it makes a small grid, counts, and checks what came back.
#include <vdb_nns/error.h>
#include <vdb_nns/openvdb_bridge.h>
#include <vdb_nns/search.h>

#include <openvdb/io/File.h>
#include <openvdb/points/AttributeArray.h>
#include <openvdb/points/PointConversion.h>

#include <cstdint>
#include <cstdio>
#include <exception>
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

PointDataGrid::Ptr makePoints()
{
    std::vector<openvdb::Vec3s> positions; // a line of points, 1 apart
    for (int i = 0; i < 1000; ++i) positions.emplace_back(static_cast<float>(i), 0.25f, 0.25f);
    const auto transform = openvdb::math::Transform::createLinearTransform(/*voxelSize=*/2.0);
    return openvdb::points::createPointDataGrid<openvdb::points::NullCodec, PointDataGrid>(positions,
                                                                                           *transform);
}

// Reads the attribute back as any other program would.
std::uint64_t sumOf(const PointDataGrid& grid, const std::string& name)
{
    std::uint64_t sum = 0;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const openvdb::points::AttributeHandle<std::int32_t> handle(leaf->constAttributeArray(name));
        for (auto point = leaf->beginIndexAll(); point; ++point)
            sum += static_cast<std::uint64_t>(handle.get(*point));
    }
    return sum;
}

int run(int argc, char** argv)
{
    const bool demo = argc != 4;
    openvdb::initialize();
    const PointDataGrid::Ptr grid = demo ? makePoints() : readPoints(argv[1]);
    const double radius = demo ? 3.0 : std::stod(argv[3]);

    const vdb_nns::ParticleView view = vdb_nns::viewOf(grid);
    const std::vector<std::uint32_t> counts = vdb_nns::countNeighbors(view, radius);
    vdb_nns::setPointAttribute(*grid, "nns_count", {counts.data(), counts.size()}, /*overwrite=*/true);

    const std::uint64_t pairs = sumOf(*grid, "nns_count");
    std::printf("%zu points, %llu pairs\n", view.size(), static_cast<unsigned long long>(pairs));
    if (!demo) {
        openvdb::io::File(argv[2]).write({grid});
        return 0;
    }
    return pairs == 2 * (999 + 998 + 997) ? 0 : 1; // neighbors 1, 2 and 3 (a tie) along the line
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
