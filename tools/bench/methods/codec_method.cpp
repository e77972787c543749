// Storing is preparation and not timed, as a file would hold the positions stored.
#include "bench/methods/codec_method.h"

#include "machine.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace vdb_nns::cli {
namespace {

// An offset in voxels through OpenVDB's fixed-point codec for positions, openvdb/points/AttributeArray.h: floats from -0.5
// to 0.5 become integers from 0 to kMost, cut off, not rounded. Bit for bit what a file gives back.
template <typename Integer>
float throughCodec(float offset)
{
    constexpr float kMost = static_cast<float>(static_cast<Integer>(~Integer(0)));
    const float unit = std::clamp(offset + 0.5f, 0.0f, 1.0f);
    const Integer stored = static_cast<Integer>(unit * kMost);
    return static_cast<float>(stored) / kMost - 0.5f;
}

double quantized(double x, PositionCodec codec, double voxelSize)
{
    const double index = x / voxelSize, voxel = std::floor(index + 0.5);
    const float offset = static_cast<float>(index - voxel);
    const float read = codec == PositionCodec::kFixed8 ? throughCodec<std::uint8_t>(offset)
                                                       : throughCodec<std::uint16_t>(offset);
    return (voxel + static_cast<double>(read)) * voxelSize;
}

class CodecMethod final : public Method {
public:
    CodecMethod(PositionCodec codec, double voxelSize, const SearchOptions& options)
        : mCodec(codec), mVoxelSize(voxelSize), mOptions(options)
    {
        if (!(voxelSize > 0 && std::isfinite(voxelSize))) {
            throw InvalidInput("bench: a codec needs the edge of its voxels, a positive number");
        }
        mOptions.encoding = Encoding::kIndex;
    }

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        mPositions = cli::quantized(view, mCodec, mVoxelSize);
        const ParticleView stored = ParticleView::fromArray(mPositions.data(), view.size());
        MethodRun result;
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(stored, radius, mOptions);
        result.gridSeconds = gridWatch.seconds();
        const Stopwatch searchWatch;
        const NeighborLists lists = mEngine.search(grid, mOptions);
        result.searchSeconds = searchWatch.seconds();
        result.pairs = lists.pairCount();
        result.structureBytes = grid.bytes();
        result.listBytes = lists.bytes();
        mFound = std::make_unique<EngineNeighbors>(lists);
        return result;
    }

    void discard() override { mFound.reset(); }

    const FoundNeighbors& found() const override
    {
        if (!mFound) throw std::logic_error("bench: a result was asked for that is not there");
        return *mFound;
    }

private:
    PositionCodec mCodec;
    double mVoxelSize;
    SearchOptions mOptions;
    std::vector<double> mPositions; // the lists refer to them
    SearchEngine mEngine;
    std::unique_ptr<EngineNeighbors> mFound;
};

} // namespace

std::vector<double> quantized(const ParticleView& view, PositionCodec codec, double voxelSize)
{
    std::vector<double> positions(3 * view.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, view.size(), 8192), [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i) {
            const Vec3d at = view.worldPosition(i);
            for (std::size_t k = 0; k < 3; ++k) {
                positions[3 * i + k] = std::isfinite(at[k]) ? quantized(at[k], codec, voxelSize) : at[k];
            }
        }
    });
    return positions;
}

std::unique_ptr<Method> makeCodecMethod(PositionCodec codec, double voxelSize, const SearchOptions& options)
{
    return std::make_unique<CodecMethod>(codec, voxelSize, options);
}

} // namespace vdb_nns::cli
