#include "measure/results.h"

#include "util/sole_owner.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>

namespace vdb_nns {

namespace {

template <typename T>
void fillWith(T* values, std::uint64_t count, T value)
{
    tbb::parallel_for(tbb::blocked_range<std::uint64_t>(0, count, 65536), [&](const auto& range) {
        std::fill(values + range.begin(), values + range.end(), value);
    });
}

} // namespace

MeasureResults::MeasureResults(const std::vector<Measure>& measures, const MeasureOptions& options,
                               std::uint64_t queries, std::uint64_t candidates, Memory& memory)
    : mQueries(queries), mMemory(memory)
{
    for (std::shared_ptr<PageBlock>& block : memory) {
        if (isSoleOwner(block)) mFree.push_back(std::move(block));
    }
    memory.clear();
    mTargets.areWide = candidates > std::uint64_t(std::numeric_limits<std::int32_t>::max());
    for (const Measure& measure : measures) addOne(measure, options);
    mFree.clear();
}

std::shared_ptr<void> MeasureResults::block(std::uint64_t bytes, Fill fill)
{
    // The smallest that is large enough, but not much larger.
    auto best = mFree.end();
    for (auto i = mFree.begin(); i != mFree.end(); ++i) {
        const bool fits = (*i)->bytes() >= bytes && (*i)->bytes() / 2 <= bytes;
        if (fits && (best == mFree.end() || (*i)->bytes() < (*best)->bytes())) best = i;
    }
    std::shared_ptr<PageBlock> block;
    if (best != mFree.end()) {
        block = std::move(*best);
        mFree.erase(best);
        if (fill == Fill::kZeros) fillWith(static_cast<char*>(block->data()), bytes, '\0');
    } else {
        block = std::make_shared<PageBlock>(static_cast<std::size_t>(std::max<std::uint64_t>(bytes, 1)));
    }
    mMemory.push_back(block);
    return {block, block->data()};
}

void* MeasureResults::add(const std::string& name, AttributeType type, Fill fill)
{
    const std::shared_ptr<void> values = block(mQueries * attributeBytes(type), fill);
    mValues.attributes.push_back({name, type, mQueries, values});
    return values.get();
}

std::uint8_t* MeasureResults::addGroup(const std::string& name)
{
    const std::shared_ptr<void> bytes = block(mQueries, Fill::kZeros);
    const std::shared_ptr<std::uint8_t> members(bytes, static_cast<std::uint8_t*>(bytes.get()));
    mValues.groups.push_back({name, mQueries, members});
    return members.get();
}

void MeasureResults::addOne(const Measure& measure, const MeasureOptions& options)
{
    const std::string name = resultName(measure, options.prefix);
    const auto addFloats = [&](AttributeType type = AttributeType::kFloat, Fill fill = Fill::kZeros) {
        return static_cast<float*>(add(name, type, fill));
    };
    const auto addIntegers = [&] {
        return add(name, mTargets.areWide ? AttributeType::kInt64 : AttributeType::kInt32);
    };
    const auto fillIntegers = [&](void* out, std::int64_t value) {
        if (mTargets.areWide) {
            fillWith(static_cast<std::int64_t*>(out), mQueries, value);
        } else {
            fillWith(static_cast<std::int32_t*>(out), mQueries, static_cast<std::int32_t>(value));
        }
    };
    switch (measure.kind) {
    case MeasureKind::kCount:
        mTargets.count = static_cast<std::int32_t*>(add(name, AttributeType::kInt32));
        break;
    case MeasureKind::kDensity:
        mTargets.density = addFloats();
        break;
    case MeasureKind::kMeanDistance:
        fillWith(mTargets.meanDistance = addFloats(AttributeType::kFloat, Fill::kNone), mQueries, -1.0f);
        break;
    case MeasureKind::kNearestDistance:
        fillWith(mTargets.nearestDistance = addFloats(AttributeType::kFloat, Fill::kNone), mQueries, -1.0f);
        break;
    case MeasureKind::kNearest:
        fillIntegers(mTargets.nearest = addIntegers(), -1);
        break;
    case MeasureKind::kAverage: {
        const PointAttribute& attribute = averagedAttribute(measure, options);
        const AttributeType type = averageType(attribute);
        const auto number = static_cast<std::size_t>(&attribute - options.attributes.data());
        mTargets.averages.push_back({number, type, add(name, type)});
        break;
    }
    case MeasureKind::kNormal:
        mTargets.normal = addFloats(AttributeType::kVec3s);
        break;
    case MeasureKind::kEigenvalues:
        mTargets.eigenvalues = addFloats(AttributeType::kVec3s);
        break;
    case MeasureKind::kPca:
        // All of them are written: finishPca() of a MeasureJob.
        mTargets.stretch = addFloats(AttributeType::kVec3s, Fill::kNone);
        mTargets.xform = static_cast<float*>(add("xform", AttributeType::kMat3s, Fill::kNone));
        mTargets.pws = static_cast<double*>(
            add("pws", AttributeType::kVec3d, options.pca.average > 0 ? Fill::kZeros : Fill::kNone));
        mTargets.ellipsoids = addGroup("ellipsoids");
        break;
    case MeasureKind::kCluster:
        fillIntegers(mTargets.cluster = addIntegers(), -1);
        break;
    case MeasureKind::kClusterSize:
        mTargets.clusterSize = addIntegers();
        break;
    case MeasureKind::kIsolated:
        mTargets.isolated = addGroup(name);
        break;
    case MeasureKind::kNonfinite:
        mTargets.nonfinite = addGroup(name);
        break;
    }
}

} // namespace vdb_nns
