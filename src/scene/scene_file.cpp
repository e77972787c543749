// Scenes into .vdb files: one point grid named `points`. Points of a voxel keep the order of the scene, whatever the number of
// threads.
#include "io/output_file.h"
#include "io/vdb/grid_writer.h"
#include "points/grid_positions.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/scene.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace vdb_nns {

namespace {

class ScenePositions final : public GridPositions {
public:
    explicit ScenePositions(const Scene& scene) : mScene(scene) {}

    std::size_t size() const override { return mScene.positions.size() / 3; }

    // The offset from the voxel's centre is rounded to a multiple of 2^-26, finer than float resolves at a quarter of a
    // voxel: i * h / h need not be i in double, and a point of a lattice with h as the voxel size must have P = 0 exactly.
    VoxelPosition at(std::size_t i) const override
    {
        VoxelPosition result;
        for (std::size_t axis = 0; axis < 3; ++axis) {
            const double inVoxels = mScene.positions[3 * i + axis] / mScene.voxelSize;
            const double near = std::floor(inVoxels + 0.5);
            const double rounded = near + std::floor((inVoxels - near) * 0x1p26 + 0.5) * 0x1p-26;
            const double voxel = std::floor(rounded + 0.5);
            result.voxel[axis] = static_cast<std::int32_t>(voxel);
            result.offset[axis] = static_cast<float>(rounded - voxel);
        }
        return result;
    }

private:
    const Scene& mScene;
};

// Voxel coordinates are 32-bit; NaN fails too.
void checkRange(const Scene& scene, const CancelCheck& cancel)
{
    constexpr double kLimit = std::numeric_limits<std::int32_t>::max();
    const std::vector<double>& all = scene.positions;
    const bool fits = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, all.size(), 65536), true,
        [&](const tbb::blocked_range<std::size_t>& range, bool good) {
            cancel.check();
            for (std::size_t k = range.begin(); k < range.end(); ++k) {
                good &= std::fabs(all[k] / scene.voxelSize) < kLimit;
            }
            return good;
        },
        [](bool a, bool b) { return a && b; }, tbb::simple_partitioner());
    if (!fits) {
        throw InvalidInput(
            "scene: a position is more than 2147483647 voxels from the origin, which a .vdb cannot "
            "hold; use a larger --voxel-size or a smaller --distance or --offset");
    }
}

void writeSceneFile(const std::string& path, const Scene& scene, const SceneOptions& options,
                    const OutputOptions& output, Progress* progress)
{
    const CancelCheck cancel(progress, "write");
    checkRange(scene, cancel);
    OutputFile file(path, output);
    const ScenePositions positions(scene);
    NewGrid grid{positions};
    grid.codec = options.codec;
    grid.voxelSize = scene.voxelSize;
    grid.suggestedRadius = scene.suggestedRadius;
    grid.valueCount = positions.size();
    writeNewGrid(file, grid, cancel);
}

} // namespace

void writeScene(const std::string& path, const Scene& scene, const SceneOptions& options,
                const OutputOptions& output, Progress* progress)
{
    isolated([&] { writeSceneFile(path, scene, options, output, progress); });
}

} // namespace vdb_nns
