// Which points are spray: those that nobody is near, and those whose density is far below that of the water. They go into
// a group `spray`, beside the density and the group `isolated`, for a whitewater solver or a shader to pick up.
//   sample_whitewater [IN OUT.vdb RADIUS]
// Without arguments it throws some drops out of a block of water, and checks that those and no others are in the group.
#include <vdb_nns/measure.h>
#include <vdb_nns/point_file.h>
#include <vdb_nns/write_points.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>
#include <vector>

namespace {

// A drop that is alone has a third of the water's density for itself, at a radius of two spacings, and a corner of the water
// three fifths.
const float kSprayDensity = 0.45f; // of the median

std::vector<std::uint8_t> findSpray(const vdb_nns::PointValues& values)
{
    const float* const density = static_cast<const float*>(values.attributes.at(0).values.get());
    const std::size_t count = static_cast<std::size_t>(values.attributes[0].count);
    std::vector<float> sorted(density, density + count);
    std::nth_element(sorted.begin(), sorted.begin() + count / 2, sorted.end());
    const float limit = count > 0 ? kSprayDensity * sorted[count / 2] : 0;

    std::vector<std::uint8_t> isSpray(count);
    for (std::size_t i = 0; i < count; ++i)
        isSpray[i] = values.groups.at(0).members.get()[i] || density[i] < limit;
    return isSpray;
}

void markSpray(const vdb_nns::PointFile& file, double radius, const std::string& path)
{
    // One mass serves all here: the default of 1 makes the density a number of points a volume.
    vdb_nns::PointValues values = vdb_nns::measure(file.view(), radius, {"density", "isolated"});
    const std::vector<std::uint8_t> isSpray = findSpray(values);
    values.groups.push_back(vdb_nns::viewGroup("spray", {isSpray.data(), isSpray.size()}));

    const vdb_nns::OutputOptions overwrite{true};
    if (file.info().format == "vdb")
        file.writeVdb(path, values, overwrite); // the same points with what was added
    else
        vdb_nns::writeNewVdb(path, file.view(), values, {}, overwrite);
    const std::uint8_t* const isolated = values.groups[0].members.get();
    std::printf("%zu points, %td of them spray, %td isolated\n", isSpray.size(),
                std::count(isSpray.begin(), isSpray.end(), 1),
                std::count(isolated, isolated + isSpray.size(), 1));
}

// A block of water, 1 apart, and above it drops of one, two and three points.
std::vector<float> makeWater(int edge, int drops)
{
    std::vector<float> xyz;
    const auto add = [&](int x, int y, float z) {
        xyz.insert(xyz.end(), {static_cast<float>(x), static_cast<float>(y), z});
    };
    for (int x = 0; x < edge; ++x)
        for (int y = 0; y < edge; ++y)
            for (int z = 0; z < edge; ++z) add(x, y, static_cast<float>(z));
    for (int drop = 0; drop < drops; ++drop)
        for (int part = 0; part <= drop % 3; ++part)
            add(6 * drop, drop, static_cast<float>(edge) + 5 + 1.6f * static_cast<float>(part));
    return xyz;
}

int demo()
{
    const int edge = 20, drops = 30;
    const std::vector<float> xyz = makeWater(edge, drops);
    const auto folder = std::filesystem::temp_directory_path();
    const std::string in = (folder / "vdb_nns_sample_water.npy").string();
    const std::string out = (folder / "vdb_nns_sample_whitewater.vdb").string();
    vdb_nns::writePointsNpy(in, vdb_nns::ParticleView::fromArray(xyz.data(), xyz.size() / 3), {true});
    markSpray(vdb_nns::PointFile::read(in), 2.0, out);

    const vdb_nns::PointFile marked = vdb_nns::PointFile::read(out);
    const auto countOf = [&](const char* group) {
        const std::vector<std::uint8_t> members = marked.readGroups(group);
        return std::count(members.begin(), members.end(), 1);
    };
    const bool isRight = countOf("spray") == drops / 3 * (1 + 2 + 3) && countOf("isolated") == drops / 3;
    for (const std::string& path : {in, out}) std::filesystem::remove(path);
    return isRight ? 0 : 1;
}

} // namespace

int main(int argc, char** argv)
{
    try {
        if (argc != 4) return demo();
        markSpray(vdb_nns::PointFile::read(argv[1]), std::stod(argv[3]), argv[2]);
        return 0;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
