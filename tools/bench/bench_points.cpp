#include "bench/bench_points.h"

#include "numbers.h"

#include <filesystem>
#include <utility>

namespace vdb_nns::cli {
namespace {

void setPositions(BenchPoints& points, std::vector<float> positions)
{
    points.positions = std::make_shared<const std::vector<float>>(std::move(positions));
    points.view = ParticleView::fromArray(points.positions->data(), points.positions->size() / 3);
}

} // namespace

BenchPoints sceneBenchPoints(const SceneOptions& options, Progress* progress)
{
    const Scene scene = makeScene(options, progress);
    BenchPoints points;
    points.scene = options.name;
    points.suggestedRadius = scene.suggestedRadius;
    points.voxelSize = scene.voxelSize;
    std::vector<float> positions(scene.positions.size());
    for (std::size_t i = 0; i < positions.size(); ++i) positions[i] = static_cast<float>(scene.positions[i]);
    setPositions(points, std::move(positions));
    return points;
}

BenchPoints fileBenchPoints(const std::string& path, const PointFileOptions& options, bool asFloats)
{
    BenchPoints points;
    points.scene = std::filesystem::path(path).filename().string();
    points.file = PointFile::read(path, options);
    points.view = points.file->view();
    points.suggestedRadius = points.file->info().suggestedRadius;
    if (points.file->info().voxelSize) points.voxelSize = (*points.file->info().voxelSize)[0];
    if (!asFloats) return points;
    std::vector<float> positions;
    positions.reserve(points.view.size() * 3);
    for (std::size_t i = 0; i < points.view.size(); ++i) {
        for (const double x : points.view.worldPosition(i)) positions.push_back(static_cast<float>(x));
    }
    setPositions(points, std::move(positions));
    points.file.reset();
    return points;
}

void shuffle(BenchPoints& points, std::uint64_t seed)
{
    std::vector<float> positions = *points.positions;
    const std::uint64_t start = mix64(seed);
    for (std::uint64_t i = positions.size() / 3; i > 1; --i) {
        // Fisher-Yates; the modulo's bias of i / 2^64 is of no matter here.
        const std::uint64_t j = mix64(start + i) % i;
        for (std::uint64_t k = 0; k < 3; ++k) std::swap(positions[3 * (i - 1) + k], positions[3 * j + k]);
    }
    setPositions(points, std::move(positions));
}

} // namespace vdb_nns::cli
