#include "bench/methods/ablation_search-inl.h"
#include "bench/methods/codec_method.h"
#include "bench/methods/other_methods.h"
#include "bench/methods/row_method.h"
#include "machine.h"
#include "shared/membership.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace vdb_nns::cli {
namespace {

template <AblationFrame kFrame, AblationTest kTest>
class AblationMethod final : public RowMethod {
public:
    AblationMethod(const SearchOptions& options, const AblationSettings& settings, double countScale)
        : mOptions(options), mSettings(settings)
    {
        mSettings.simd = options.simd;
        mRows.scale = countScale;
    }

private:
    using Real = FrameReal<kFrame>;
    using Scratch = AblationScratch<kFrame>;

    void search(const SetSearch& all, MethodRun& result) override
    {
        if (!all.isPlain())
            throw std::logic_error("bench: the engine's parts search all particles of one view");
        const ParticleView& view = all.queries.view;
        const double radius = all.radius.value;
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(view, radius, mOptions);
        mStructure.build(grid);
        result.gridSeconds = gridWatch.seconds();

        const Stopwatch searchWatch;
        if (grid.nonfiniteCount() > 0) {
            std::fill(mRows.places.begin(), mRows.places.end(), RowBuffers::Place{});
        }
        for (Scratch& scratch : mScratch) scratch.rows.restart();
        const PairJudge judge(view, radius);
        const AblationSearch<kFrame, kTest> search(mStructure, limits(grid, radius), mSettings, judge);
        tbb::parallel_for(tbb::blocked_range<std::uint32_t>(0, static_cast<std::uint32_t>(grid.leafCount())),
                          [&](const tbb::blocked_range<std::uint32_t>& range) {
                              throwIfStopped();
                              Scratch& scratch = mScratch.local();
                              for (std::uint32_t l = range.begin(); l < range.end(); ++l) {
                                  search.searchLeaf(l, scratch);
                              }
                          });
        for (const Scratch& scratch : mScratch) result.pairs += scratch.rows.pairs();
        result.searchSeconds = searchWatch.seconds();
        result.structureBytes = grid.bytes() + mStructure.bytes();
    }

    PairLimits<Real> limits(const SparseGrid& grid, double radius) const
    {
        if constexpr (kFrame != AblationFrame::kLeafFloat) {
            const Real rounded = static_cast<Real>(radius);
            return {rounded * rounded, 0};
        } else {
            const double radiusCells = radius / grid.cellSize();
            if (kTest != AblationTest::kCertified) return {static_cast<float>(radiusCells * radiusCells), 0};
            const FilterBounds bounds =
                makeFilterBounds(radiusCells, grid.reach(), mStructure.coordinateError);
            float band; // -2 beta
            std::memcpy(&band, &bounds.bandTop, sizeof band);
            return {bounds.far, std::nextafter(bounds.far + band, -1e30f)};
        }
    }

    SearchOptions mOptions;
    AblationSettings mSettings;
    SearchEngine mEngine;
    AblationStructure<kFrame> mStructure;
    tbb::enumerable_thread_specific<Scratch> mScratch{[this] { return Scratch(mStructure, mPool); }};
};

template <AblationFrame kFrame, AblationTest kTest>
std::unique_ptr<Method> makeAblation(const SearchOptions& options, const AblationSettings& settings = {},
                                     double countScale = 1)
{
    return std::make_unique<AblationMethod<kFrame, kTest>>(options, settings, countScale);
}

AblationSettings sampledSettings(double percent)
{
    if (!(percent > 0 && percent <= 100)) {
        throw InvalidInput("bench: sampled needs a percentage above 0 and up to 100");
    }
    AblationSettings settings;
    settings.sampleMost = static_cast<std::uint32_t>(std::ceil(percent / 100 * 4294967296.0) - 1);
    return settings;
}

AblationSettings nearestSettings(double count)
{
    if (!(count >= 1 && count < 4294967296.0)) {
        throw InvalidInput("bench: nearest needs a number of neighbors, 1 or more");
    }
    AblationSettings settings;
    settings.nearest = static_cast<std::uint32_t>(count);
    return settings;
}

} // namespace

std::unique_ptr<Method> makeAblationMethod(const MethodSpec& spec, const SearchOptions& options,
                                           double voxelSize)
{
    const std::string& family = spec.family;
    if (family == "certified")
        return makeAblation<AblationFrame::kLeafFloat, AblationTest::kCertified>(options);
    if (family == "filter-only")
        return makeAblation<AblationFrame::kLeafFloat, AblationTest::kFilter>(options);
    if (family == "world-float")
        return makeAblation<AblationFrame::kWorldFloat, AblationTest::kFilter>(options);
    if (family == "world-double")
        return makeAblation<AblationFrame::kWorldDouble, AblationTest::kFilter>(options);
    if (family == "codec8") return makeCodecMethod(PositionCodec::kFixed8, voxelSize, options);
    if (family == "codec16") return makeCodecMethod(PositionCodec::kFixed16, voxelSize, options);
    if (family == "sampled") {
        return makeAblation<AblationFrame::kLeafFloat, AblationTest::kSampled>(
            options, sampledSettings(spec.number), 100 / spec.number);
    }
    if (family == "nearest") {
        return makeAblation<AblationFrame::kLeafFloat, AblationTest::kNearest>(options,
                                                                               nearestSettings(spec.number));
    }
    throw std::logic_error("bench: no part or approximate method " + family);
}

} // namespace vdb_nns::cli
