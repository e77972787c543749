// The particles of a benchmark: a scene or a file, in their order or a random one.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/scene.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// A scene, and a file that is shuffled or handed out, is searched as an array of floats (x y z triples), so
/// that other programs can be timed on exactly the same points. Any other file is searched as it is.
struct BenchPoints {
    std::string scene;                                   ///< scene name, or the file's name
    std::shared_ptr<const std::vector<float>> positions; ///< null: the view is of the file
    std::optional<PointFile> file;
    ParticleView view;
    std::optional<double> suggestedRadius; ///< world units
    std::optional<double> voxelSize;       ///< world edge along x; none for files without voxels
};

BenchPoints sceneBenchPoints(const SceneOptions& options, Progress* progress);
BenchPoints fileBenchPoints(const std::string& path, const PointFileOptions& options, bool asFloats);

/// Puts the particles of an array in random order; the same seed gives the same order.
void shuffle(BenchPoints& points, std::uint64_t seed);

} // namespace vdb_nns::cli
