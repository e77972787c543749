// Scenes into .vdb files: one point grid named `points`. The only file of the scenes with OpenVDB. Points of a voxel
// keep the order of the scene, whatever the number of threads (OpenVDB's partitioner sorts stably).
#include "io/output_file.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointConversion.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cmath>
#include <limits>
#include <ostream>

namespace vdb_nns {

namespace {

using openvdb::points::PointDataGrid;

// Positions in voxels, as OpenVDB's point partitioner wants them. The offset from the voxel's centre is rounded to a
// multiple of 2^-26, finer than float resolves at a quarter of a voxel: i * h / h need not be i in double, and a point
// of a lattice with h as the voxel size must have P = 0 exactly.
class VoxelPositions {
public:
    using PosType = openvdb::Vec3d;
    using value_type = openvdb::Vec3d;

    VoxelPositions(const std::vector<double>& positions, double voxelSize, const CancelCheck& cancel)
        : mPositions(positions), mVoxelSize(voxelSize), mCancel(cancel)
    {
    }

    std::size_t size() const { return mPositions.size() / 3; }

    void getPos(std::size_t n, PosType& position) const
    {
        if (n % 16384 == 0) mCancel.check(); // OpenVDB asks nobody
        for (int axis = 0; axis < 3; ++axis) {
            const double inVoxels = mPositions[3 * n + static_cast<std::size_t>(axis)] / mVoxelSize;
            const double voxel = std::floor(inVoxels + 0.5);
            position[axis] = voxel + std::floor((inVoxels - voxel) * 0x1p26 + 0.5) * 0x1p-26;
        }
    }

private:
    const std::vector<double>& mPositions;
    double mVoxelSize;
    const CancelCheck& mCancel;
};

// Voxel coordinates are 32-bit; NaN fails too.
void checkRange(const Scene& scene)
{
    constexpr double kLimit = std::numeric_limits<std::int32_t>::max();
    const std::vector<double>& all = scene.positions;
    const bool fits = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, all.size(), 65536), true,
        [&](const tbb::blocked_range<std::size_t>& range, bool good) {
            for (std::size_t k = range.begin(); k < range.end(); ++k) {
                good &= std::fabs(all[k] / scene.voxelSize) < kLimit;
            }
            return good;
        },
        [](bool a, bool b) { return a && b; });
    if (!fits) {
        throw InvalidInput(
            "scene: a position is more than 2147483647 voxels from the origin, which a .vdb cannot "
            "hold; use a larger --voxel-size or a smaller --distance or --offset");
    }
}

template <typename Codec>
PointDataGrid::Ptr makeGrid(const VoxelPositions& positions)
{
    namespace points = openvdb::points;
    const auto identity = openvdb::math::Transform::createLinearTransform(1.0);
    const auto index =
        openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(positions, *identity);
    return points::createPointDataGrid<Codec, PointDataGrid>(*index, positions, *identity);
}

PointDataGrid::Ptr makeGrid(const VoxelPositions& positions, const std::string& codec)
{
    using namespace openvdb::points;
    if (codec == "null") return makeGrid<NullCodec>(positions);
    if (codec == "trnc") return makeGrid<TruncateCodec>(positions);
    if (codec == "fxpt16") return makeGrid<FixedPointCodec<false, PositionRange>>(positions);
    if (codec == "fxpt8") return makeGrid<FixedPointCodec<true, PositionRange>>(positions);
    throw InvalidInput("scene: unknown codec '" + codec + "'; P can have null, trnc, fxpt16 or fxpt8");
}

// OpenVDB's io::File writes to paths only, and its io::Stream leaves out the offsets that io::File wants to read.
class SeekableArchive : public openvdb::io::Archive {
public:
    void writeGrid(std::ostream& stream, const openvdb::GridBase::ConstPtr& grid) const
    {
        this->write(stream, openvdb::GridCPtrVec{grid}, /*seekable=*/true);
    }
};

void writeSceneFile(const std::string& path, const Scene& scene, const SceneOptions& options,
                    const OutputOptions& output, Progress* progress)
{
    const CancelCheck cancel(progress, "write");
    checkRange(scene);
    OutputFile file(path, output);
    openvdb::initialize();
    cancel.check();
    const PointDataGrid::Ptr grid =
        makeGrid(VoxelPositions(scene.positions, scene.voxelSize, cancel), options.codec);
    cancel.update(0.5);
    grid->setTransform(openvdb::math::Transform::createLinearTransform(scene.voxelSize));
    grid->setName("points");
    grid->insertMeta("suggested_radius", openvdb::DoubleMetadata(scene.suggestedRadius));
    OutputStreamBuffer buffer(file, [&](std::uint64_t) { cancel.check(); });
    std::ostream stream(&buffer);
    stream.exceptions(std::ios::badbit);
    const SeekableArchive archive;
    archive.writeGrid(stream, grid);
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
