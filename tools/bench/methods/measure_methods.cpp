#include "bench/methods/measure_methods.h"

#include "machine.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/search.h"

#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

MeasureValues viewOf(const PointValues& values)
{
    MeasureValues view;
    for (const PointAttribute& attribute : values.attributes) {
        if (attribute.type != AttributeType::kFloat && attribute.type != AttributeType::kVec3s &&
            attribute.type != AttributeType::kMat3s)
            continue; // counts, and the positions of ellipsoids
        const auto* numbers = static_cast<const float*>(attribute.values.get());
        if (attribute.name == "density") view.density = numbers;
        if (attribute.name == "normal") view.normal = numbers;
        if (attribute.name == "stretch") view.stretch = numbers;
        if (attribute.name == "xform") view.xform = numbers;
    }
    if (!values.groups.empty()) view.ellipsoids = values.groups.front().members.get();
    return view;
}

class EngineMeasures : public MeasureMethod {
public:
    EngineMeasures(ParticleView view, double radius, const SearchOptions& options)
        : mView(std::move(view)), mRadius(radius)
    {
        mOptions.search = options;
    }

    MeasureRun run(const std::string& measure) override
    {
        discard();
        MeasureRun result;
        const ParticleSet all(mView);
        const Stopwatch gridWatch;
        const SearchSets sets = mEngine.sort(all, all, mRadius, mOptions.search);
        result.gridSeconds = gridWatch.seconds();
        const Stopwatch passWatch;
        mValues = mEngine.measure(sets, {measure}, mOptions).values;
        result.passSeconds = passWatch.seconds();
        return result;
    }

    MeasureValues values() const override { return viewOf(mValues); }
    void discard() override { mValues = {}; }

private:
    ParticleView mView;
    double mRadius;
    MeasureOptions mOptions;
    SearchEngine mEngine;
    PointValues mValues;
};

class StoredMeasures final : public MeasureMethod {
public:
    StoredMeasures(std::vector<double> positions, double radius, const SearchOptions& options)
        : mPositions(std::move(positions)),
          mMeasures(ParticleView::fromArray(mPositions.data(), mPositions.size() / 3), radius, options)
    {
    }

    MeasureRun run(const std::string& measure) override { return mMeasures.run(measure); }
    MeasureValues values() const override { return mMeasures.values(); }
    void discard() override { mMeasures.discard(); }

private:
    const std::vector<double> mPositions; // before what views it
    EngineMeasures mMeasures;
};

} // namespace

std::unique_ptr<MeasureMethod> makeEngineMeasures(const ParticleView& view, double radius,
                                                  const SearchOptions& options)
{
    return std::make_unique<EngineMeasures>(view, radius, options);
}

std::unique_ptr<MeasureMethod> makeStoredMeasures(const ParticleView& view, double radius,
                                                  const SearchOptions& options, PositionCodec codec,
                                                  double voxelSize)
{
    return std::make_unique<StoredMeasures>(quantized(view, codec, voxelSize), radius, options);
}

} // namespace vdb_nns::cli
