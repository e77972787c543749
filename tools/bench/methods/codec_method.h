// What a lossy codec of positions costs in pairs: positions as a file with that codec holds them, then the exact engine.
#pragma once

#include "bench/method.h"

#include <memory>
#include <vector>

namespace vdb_nns::cli {

enum class PositionCodec { kFixed8, kFixed16 }; ///< OpenVDB's fxpt8 and fxpt16

/// World positions as x y z triples, stored and read back: in voxels of that edge with voxel 0 about the origin. Non-finite
/// ones as they are.
std::vector<double> quantized(const ParticleView& view, PositionCodec codec, double voxelSize);

std::unique_ptr<Method> makeCodecMethod(PositionCodec codec, double voxelSize, const SearchOptions& options);

} // namespace vdb_nns::cli
