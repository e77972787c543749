#include "measure/leaf_sums.h"

#include "measure/row_rules.h"

#include <cmath>
#include <limits>

namespace vdb_nns {

namespace {

// Of terms up to `greatest`, of which a particle has no more than kMostAtOnce.
RowScale scaleOf(const MeasureKernels& kernels, double greatest)
{
    const std::uint32_t firstGroup[] = {0, 0};
    PairGroups row{};
    row.rows = 1;
    row.firstGroup = firstGroup;
    RowScale scale;
    kernels.scales(row, &greatest, nullptr, nullptr, 0, &scale);
    return scale;
}

double valueOf(std::uint64_t sum, std::uint32_t shifted, const RowScale& scale)
{
    return static_cast<double>(static_cast<std::int64_t>(sum - shifted * kShiftBits)) * scale.inverse;
}

} // namespace

LeafSums::LeafSums(const RowMeasures& measures)
    : mMeasures(measures),
      mWeightScale(scaleOf(measures.kernels, 1)),
      mDistanceScale(scaleOf(measures.kernels, measures.radius)),
      mAtZero(weightAtZero(measures.options.kernel, measures.radius))
{
    const MeasureTargets& targets = measures.targets;
    mPairs = {weightOf(measures.options.kernel),
              targets.density != nullptr,
              targets.meanDistance || targets.nearestDistance,
              1 / measures.radius,
              mWeightScale.scale,
              mDistanceScale.scale};
}

bool LeafSums::suffice(const RowMeasures& measures)
{
    MeasureTargets others = measures.targets;
    others.density = others.meanDistance = others.nearestDistance = nullptr;
    const SearchSetsData& sets = measures.sets;
    return !others.wantsRows() && measures.options.masses.empty() && sets.areSameParticles() &&
           sets.candidateChosen.empty() && sets.queryChosen.empty() && sets.radius.isOne() &&
           measures.positions.canHaveSlots();
}

void LeafSums::begin(std::uint32_t firstSlot, std::uint32_t particles)
{
    mFirstSlot = firstSlot;
    mParticles = particles;
    mSums.assign(particles + kGroup, {0, 0, std::numeric_limits<double>::infinity(), 0});
}

void LeafSums::add(const PairGroups& groups, const std::uint32_t* places, std::uint32_t firstSlot,
                   const double* squares)
{
    mMeasures.kernels.addOncePairs(mPairs, groups, places, firstSlot - mFirstSlot, squares, mSums.data());
}

bool LeafSums::finish(const std::uint32_t* numbers, std::uint32_t* counts)
{
    const MeasureTargets& targets = mMeasures.targets;
    const MeasureOptions& options = mMeasures.options;
    for (std::uint32_t i = 0; i < mParticles; ++i) {
        const ParticleSums& sums = mSums[i];
        counts[i] += sums.pairs;
        if (counts[i] > kMostAtOnce) return false;
        if (targets.density) {
            const double total = options.mass * (valueOf(sums.weight, sums.pairs, mWeightScale) + 1);
            if (total > 0) targets.density[numbers[i]] = static_cast<float>(total * mAtZero);
        }
        if (counts[i] == 0) continue;
        if (targets.nearestDistance)
            targets.nearestDistance[numbers[i]] = static_cast<float>(std::sqrt(sums.leastSquare));
        if (!targets.meanDistance) continue;
        const double distances = valueOf(sums.distance, sums.pairs, mDistanceScale);
        if (!isMeanPrecise(distances, mMeasures.radius, counts[i])) return false;
        targets.meanDistance[numbers[i]] = static_cast<float>(distances / counts[i]);
    }
    return true;
}

} // namespace vdb_nns
