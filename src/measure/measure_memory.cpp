#include "measure/measure_memory.h"

#include "grid/search_sets_data.h"
#include "measure/pair_positions.h"
#include "vdb_nns/point_values.h"

namespace vdb_nns {

namespace {

std::uint64_t resultBytes(const Measure& measure, const MeasureOptions& options)
{
    switch (measure.kind) {
    case MeasureKind::kAverage:
        return attributeBytes(averageType(averagedAttribute(measure, options)));
    case MeasureKind::kPca:
        return attributeBytes(AttributeType::kVec3s) + attributeBytes(AttributeType::kMat3s) +
               attributeBytes(AttributeType::kVec3d) + 1;
    case MeasureKind::kNormal:
    case MeasureKind::kEigenvalues:
        return attributeBytes(AttributeType::kVec3s);
    case MeasureKind::kIsolated:
    case MeasureKind::kNonfinite:
        return 1;
    default:
        return sizeof(std::int64_t);
    }
}

// Doubles at most, and a fourth for a vector.
std::uint64_t averagedBytes(const PointAttribute& attribute)
{
    return (attributeWidth(attribute.type) == 3 ? 4 : 1) * sizeof(double);
}

} // namespace

MeasureMemory::MeasureMemory(const std::vector<Measure>& measures, const MeasureOptions& options)
    : mInputBytes(options.masses.size() * sizeof(double))
{
    for (const Measure& measure : measures) {
        mResultBytesEach += resultBytes(measure, options);
        if (measure.kind != MeasureKind::kAverage) continue;
        const PointAttribute& attribute = averagedAttribute(measure, options);
        mAveragedBytesEach += averagedBytes(attribute);
        mInputBytes += attribute.count * attributeBytes(attribute.type);
    }
}

std::uint64_t MeasureMemory::bytes(const SearchSets& sets) const
{
    if (mResultBytesEach == 0) return 0;
    return mResultBytesEach * sets.rowCount() + mAveragedBytesEach * sets.columnCount() +
           PairPositions::bytesFor(sets.queries(), sets.candidates(), sets.data().largestRadius);
}

} // namespace vdb_nns
