// Ways to make density, normals and ellipsoids of all particles: methods of the study of measures.
#pragma once

#include "bench/methods/codec_method.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <memory>
#include <string>

namespace vdb_nns::cli {

/// By particle number, as vdb_nns/measure.h has types and layout; null where not asked for.
struct MeasureValues {
    const float* density = nullptr;
    const float* normal = nullptr;
    const float* stretch = nullptr; ///< this and those below: pca
    const float* xform = nullptr;
    const std::uint8_t* ellipsoids = nullptr;
};

struct MeasureRun {
    double gridSeconds = 0; ///< sorting the particles
    double passSeconds = 0; ///< finding the neighbors and making the measure of them
};

/// Keeps its buffers from run to run. The view must outlive it.
class MeasureMethod {
public:
    virtual ~MeasureMethod() = default;

    /// Sorts and measures anew, in the TBB arena of the caller, with the options that measures have by default.
    /// @param measure "density", "normal" or "pca"; methods of the engine also have "count"
    /// @throws as SearchEngine::measure()
    virtual MeasureRun run(const std::string& measure) = 0;

    /// Of the last run; there until the next one or discard().
    virtual MeasureValues values() const = 0;

    virtual void discard() = 0;
};

/// The engine, of all neighbors or of the nearest that the options ask for.
std::unique_ptr<MeasureMethod> makeEngineMeasures(const ParticleView& view, double radius,
                                                  const SearchOptions& options);

/// The engine on positions as a file with that codec holds them. Storing them is preparation and not timed.
std::unique_ptr<MeasureMethod> makeStoredMeasures(const ParticleView& view, double radius,
                                                  const SearchOptions& options, PositionCodec codec,
                                                  double voxelSize);

/// Which of the exact neighbors are summed up.
enum class NeighborShare {
    kAll,
    kHalf ///< every second one, by a hash of the unordered pair; each stands for two
};

/// What a plain program does with the engine's exact neighbors: world positions, differences, weights and sums in
/// float32, in the order in which neighbors are visited.
std::unique_ptr<MeasureMethod> makeFloatMeasures(const ParticleView& view, double radius,
                                                 const SearchOptions& options, NeighborShare share);

} // namespace vdb_nns::cli
