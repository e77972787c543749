// Points of an array with values of their own into a .vdb for a VFX package and a .ply for a viewer: the number of
// neighbors as an attribute, and those without any as a group.
//   sample_write_points [IN OUT_WITHOUT_EXTENSION RADIUS]
// Without arguments it makes some points, writes them into the system's temporary folder, and checks what comes back.
#include <vdb_nns/point_file.h>
#include <vdb_nns/search.h>
#include <vdb_nns/write_points.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>
#include <vector>

namespace {

void writeCounted(const vdb_nns::ParticleView& view, double radius, const std::string& name)
{
    const std::vector<std::uint32_t> counts = vdb_nns::countNeighbors(view, radius);
    std::vector<std::int32_t> attribute(counts.begin(), counts.end());
    std::vector<std::uint8_t> isAlone;
    for (const std::uint32_t count : counts) isAlone.push_back(count == 0);

    vdb_nns::PointValues values; // views of the arrays above
    values.attributes = {vdb_nns::viewAttribute("neighbors", vdb_nns::AttributeType::kInt32, attribute.data(),
                                                attribute.size())};
    values.groups = {vdb_nns::viewGroup("alone", {isAlone.data(), isAlone.size()})};

    vdb_nns::NewGridOptions grid;
    grid.voxelSize = radius;
    const vdb_nns::OutputOptions overwrite{true};
    const vdb_nns::WrittenPoints written = vdb_nns::writeNewVdb(name + ".vdb", view, values, grid, overwrite);
    vdb_nns::writePly(name + ".ply", view, values, overwrite);
    std::printf("%llu points, rounded by at most %g in the .vdb\n",
                static_cast<unsigned long long>(written.points), written.largestRounding);
}

// Ten points in a row, 1 apart, and one far away.
int demo()
{
    std::vector<float> positions;
    for (int i = 0; i < 10; ++i) positions.insert(positions.end(), {static_cast<float>(i), 0.5f, 0.5f});
    positions.insert(positions.end(), {100, 0.5f, 0.5f});
    const std::string name =
        (std::filesystem::temp_directory_path() / "vdb_nns_sample_write_points").string();
    writeCounted(vdb_nns::ParticleView::fromArray(positions.data(), positions.size() / 3), 1.0, name);

    const vdb_nns::PointFile file = vdb_nns::PointFile::read(name + ".vdb");
    std::size_t alone = 0;
    for (const std::uint8_t member : file.readGroups("alone")) alone += member;
    double neighbors = 0;
    for (const double count : vdb_nns::PointFile::read(name + ".ply").readScalars("neighbors"))
        neighbors += count;
    for (const char* extension : {".vdb", ".ply"}) std::filesystem::remove(name + extension);
    return alone == 1 && neighbors == 18 ? 0 : 1;
}

} // namespace

int main(int argc, char** argv)
{
    try {
        if (argc != 4) return demo();
        const vdb_nns::PointFile file = vdb_nns::PointFile::read(argv[1]);
        writeCounted(file.view(), std::stod(argv[3]), argv[2]);
        return 0;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
