// Times points::pca() of OpenVDB 13, without sampling, on the points of a .vdb that are put into voxels of another size.
//   pca_peer IN.vdb RADIUS VOXEL_SIZE THREADS OUT.f64
// Prints the seconds of the call alone, the second of two, and its CPU seconds. OUT.f64 has seven doubles for each point, by its number in IN.vdb:
// stretch, 1 in the group `ellipsoids` or else 0, pws.
#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <openvdb/points/PrincipalComponentAnalysis.h>
#include <openvdb/tools/PointIndexGrid.h>

#include <tbb/global_control.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <exception>
#include <fstream>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>
#include <vector>

using namespace openvdb::points;

namespace {

constexpr std::size_t kColumns = 7;

// World positions by number, in the order of the leaves.
std::vector<openvdb::Vec3d> readPositions(const std::string& path)
{
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false);
    std::vector<openvdb::Vec3d> positions;
    const auto grid = openvdb::gridPtrCast<PointDataGrid>(file.readGrid("points"));
    for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
        const AttributeHandle<openvdb::Vec3f> offsets(leaf->constAttributeArray("P"));
        for (auto point = leaf->beginIndexOn(); point; ++point)
            positions.push_back(
                grid->transform().indexToWorld(point.getCoord().asVec3d() + offsets.get(*point)));
    }
    return positions;
}

// The points in voxels of this size, with their numbers.
PointDataGrid::Ptr makeGrid(const std::vector<openvdb::Vec3d>& positions, double voxelSize)
{
    const auto transform = openvdb::math::Transform::createLinearTransform(voxelSize);
    const PointAttributeVector<openvdb::Vec3d> points(positions);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(points, *transform);
    const auto grid = createPointDataGrid<NullCodec, PointDataGrid>(*index, points, *transform);
    std::vector<std::int32_t> list(positions.size());
    std::iota(list.begin(), list.end(), 0);
    appendAttribute<std::int32_t>(grid->tree(), "number");
    const PointAttributeVector<std::int32_t> numbers(list);
    populateAttribute(grid->tree(), index->tree(), "number", numbers);
    return grid;
}

struct Seconds {
    double clock, cpu;
};

Seconds timePca(PointDataGrid& grid, double radius)
{
    PcaSettings settings;
    settings.searchRadius = static_cast<float>(radius);
    settings.maxSourcePointsPerVoxel = std::numeric_limits<std::size_t>::max(); // all points count
    const auto begin = std::chrono::steady_clock::now();
    const std::clock_t cpuBegin = std::clock(); // of all threads
    pca(grid, settings, PcaAttributes());
    return {std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count(),
            static_cast<double>(std::clock() - cpuBegin) / CLOCKS_PER_SEC};
}

std::vector<double> valuesByNumber(const PointDataGrid& grid, std::size_t points)
{
    std::vector<double> values(points * kColumns);
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) {
        const AttributeHandle<std::int32_t> numbers(leaf->constAttributeArray("number"));
        const AttributeHandle<openvdb::Vec3f> stretches(leaf->constAttributeArray("stretch"));
        const AttributeHandle<openvdb::Vec3d> means(leaf->constAttributeArray("pws"));
        const GroupHandle group = leaf->groupHandle("ellipsoids");
        for (auto point = leaf->beginIndexOn(); point; ++point) {
            double* const row = values.data() + kColumns * static_cast<std::size_t>(numbers.get(*point));
            const openvdb::Vec3f stretch = stretches.get(*point);
            const openvdb::Vec3d mean = means.get(*point);
            for (int k = 0; k < 3; ++k) {
                row[k] = static_cast<double>(stretch[k]);
                row[4 + k] = mean[k];
            }
            row[3] = group.get(*point) ? 1 : 0;
        }
    }
    return values;
}

void write(const std::string& path, const std::vector<double>& values)
{
    std::ofstream file(path, std::ios::binary);
    file.write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(values.size() * sizeof(double)));
    file.close();
    if (!file) throw std::runtime_error("cannot write " + path);
}

} // namespace

int main(int argc, char** argv)
{
    if (argc != 6) {
        std::fprintf(stderr, "usage: pca_peer IN.vdb RADIUS VOXEL_SIZE THREADS OUT.f64\n");
        return 2;
    }
    try {
        const double radius = std::stod(argv[2]), voxelSize = std::stod(argv[3]);
        const tbb::global_control threads(tbb::global_control::max_allowed_parallelism, std::stoul(argv[4]));
        openvdb::initialize();
        const std::vector<openvdb::Vec3d> positions = readPositions(argv[1]);
        const PointDataGrid::Ptr cold = makeGrid(positions, voxelSize);
        const PointDataGrid::Ptr warm = cold->deepCopy(); // attributes of the first call would be in the way
        timePca(*cold, radius);
        const Seconds seconds = timePca(*warm, radius);
        std::printf("%.4f %.4f\n", seconds.clock, seconds.cpu);
        write(argv[5], valuesByNumber(*warm, positions.size()));
        return 0;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "pca_peer: %s\n", error.what());
        return 1;
    }
}
