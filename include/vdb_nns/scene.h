// Sample scenes: deterministic particle sets for tests, benchmarks and first steps.
#pragma once

#include "vdb_nns/output.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

/// Parameters of a scene; empty ones take the default of the scene. Name, count and parameters determine
/// every bit.
struct SceneOptions {
    std::string name; ///< one of sceneNames()
    /// Particles, met exactly. A lattice is a full cube if this is n^3; otherwise its last slab is cut.
    std::uint64_t count = 0;
    std::uint64_t seed = 1;
    std::optional<double> spacing;      ///< h, world units
    std::optional<double> radiusFactor; ///< suggested radius / h
    std::optional<double> voxelSize;    ///< world units; default 2 h (`lattice`: h)
    std::string codec = "null";         ///< codec of P: null, trnc, fxpt16 or fxpt8
    std::optional<double> offset;       ///< `far`: voxels from the origin
    std::optional<double> distance;     ///< `outlier`: voxels to the lone particle
    std::optional<double> fraction;     ///< `coincident`: share of the particles at one point
};

/// A scene in memory: positions in world units as doubles, x y z triples.
struct Scene {
    std::vector<double> positions;
    double suggestedRadius = 0; ///< world units
    double voxelSize = 0;       ///< world units
};

/// Names with a one-line description each, in the order of the documentation.
struct SceneName {
    const char* name;
    const char* what;
};
const std::vector<SceneName>& sceneNames();

/// Makes the particles of a scene.
/// @throws InvalidInput for an unknown name, a count of 0 or above 2^32-1, or a parameter that is out of
///         range or belongs to another scene
Scene makeScene(const SceneOptions& options, Progress* progress = nullptr);

/// Writes a scene as a .vdb with one point grid named `points`, P with `options.codec`, and the radius in the
/// grid's metadata (float64 `suggested_radius`). The same options give the same bytes, except for the UUID
/// that OpenVDB draws.
/// @throws OutputExists, OutputError, InvalidInput (unknown codec), Cancelled
void writeScene(const std::string& path, const Scene& scene, const SceneOptions& options,
                const OutputOptions& output = {}, Progress* progress = nullptr);

} // namespace vdb_nns
