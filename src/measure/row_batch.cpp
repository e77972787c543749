#include "measure/row_batch.h"

#include "exact/exact_test.h"
#include "measure/row_rules.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatchGroups = 64; // whose columns fit the first-level cache

std::size_t groupsOf(std::size_t pairs)
{
    return (pairs + kGroup - 1) / kGroup;
}

// Component c of the value of a particle.
double valueOf(const AveragedAttribute& attribute, std::size_t number, std::size_t c)
{
    const std::size_t at = attribute.isVector ? 4 * number + c : number; // vectors have a pad
    return attribute.isDouble ? static_cast<const double*>(attribute.values)[at]
                              : static_cast<double>(static_cast<const float*>(attribute.values)[at]);
}

void putReal(AttributeType type, void* out, std::size_t at, double value)
{
    if (type == AttributeType::kDouble || type == AttributeType::kVec3d) {
        static_cast<double*>(out)[at] = value;
    } else {
        static_cast<float*>(out)[at] = static_cast<float>(value);
    }
}

} // namespace

RowBatch::RowBatch(const RowMeasures& measures)
    : mMeasures(measures),
      mTargets(measures.targets),
      mWantsWeights(mTargets.density || mTargets.normal || mTargets.eigenvalues ||
                    !mTargets.averages.empty()),
      mWantsVectors(mTargets.normal || mTargets.eigenvalues || mTargets.stretch),
      mHasRadii(!measures.sets.radius.isOne()),
      mIsByPair(mHasRadii && measures.sets.radius.mode != RadiusMode::kGather),
      mInverseRadius(1 / measures.radius),
      mFirstGroup(kBatchGroups + 1)
{
    reserve(2 * kBatchGroups);
}

void RowBatch::reserve(std::size_t groups)
{
    if (groups <= mCapacity) return;
    mCapacity = groups + groups / 2;
    mPairs.resizeDiscarding(mCapacity * kGroup * kColumns);
    mGroupRow.resizeDiscarding(mCapacity);
    mGroupPairs.resizeDiscarding(mCapacity);
    mPlaces.resizeDiscarding(mCapacity * kGroup);
}

template <typename F>
void RowBatch::forEachBatch(const std::uint32_t* queries, const VisitedRows& rows, F&& f)
{
    const std::uint32_t* numbers = rows.numbers;
    for (std::size_t r = 0; r < rows.rows; r += mGroups.rows) {
        mCounts = rows.lengths + r;
        mGroups.rows = listGroups(mCounts, rows.rows - r);
        mGroups.groups = mFirstGroup[mGroups.rows];
        mGroups.numbers = numbers;
        mGroups.row = mGroupRow.data();
        mGroups.pairs = mGroupPairs.data();
        mGroups.firstGroup = mFirstGroup.data();
        mGroups.query = queries + r;
        f(r);
        numbers += mGroups.groups * kGroup;
    }
}

void RowBatch::take(const std::uint32_t* queries, const VisitedRows& rows)
{
    forEachBatch(queries, rows, [&](std::size_t) {
        setOwnWeights();
        if (mHasRadii) setRadii();
        writeValues();
    });
}

void RowBatch::takeOnce(const std::uint32_t* queries, const VisitedRows& rows, LeafSums& leaf)
{
    forEachBatch(queries, rows, [&](std::size_t r) {
        makePairs(leaf.places(mPlaces.data()));
        leaf.add(mGroups, mPlaces.data(), rows.firstSlot + static_cast<std::uint32_t>(r), column(kDistance));
    });
}

std::size_t RowBatch::listGroups(const std::uint32_t* counts, std::size_t rows)
{
    constexpr std::size_t kStep = 8; // groups that are written at once, for rows have a few
    const std::size_t most = std::min(rows, kBatchGroups);
    std::size_t count = 0, groups = 0, end = groupsOf(counts[0]);
    do {
        mFirstGroup[count++] = static_cast<std::uint32_t>(groups);
        groups = end;
        end += count < most ? groupsOf(counts[count]) : kBatchGroups;
    } while (end <= kBatchGroups && count < most);
    mFirstGroup[count] = static_cast<std::uint32_t>(groups);
    reserve(groups + kStep);
    std::fill_n(mGroupPairs.data(), groups, static_cast<std::uint32_t>(kGroup));
    for (std::size_t r = 0; r < count; ++r) {
        const std::size_t last = mFirstGroup[r + 1];
        for (std::size_t g = mFirstGroup[r]; g < last; g += kStep)
            std::fill_n(mGroupRow.data() + g, kStep, static_cast<std::uint32_t>(r));
        if (counts[r] % kGroup != 0) mGroupPairs[last - 1] = counts[r] % kGroup;
    }
    return count;
}

void RowBatch::setOwnWeights()
{
    const SearchSetsData& sets = mMeasures.sets;
    mReferences.assign(mGroups.rows, mMeasures.radius);
    mOwn.assign(mGroups.rows, sets.areSameParticles() ? 1 : 0);
    for (std::size_t r = 0; r < mGroups.rows && (mHasRadii || !sets.candidateChosen.empty()); ++r) {
        const std::uint32_t query = mGroups.query[r];
        // A radius that reaches nobody does not reach the query itself.
        const bool isOwn =
            sets.isCandidate(query) && (!mHasRadii || radiusOfPair(sets.radius, query, query) > 0);
        mOwn[r] = isOwn ? 1 : 0;
    }
    mOwnWeights = mOwn;
    mAllHaveOwn = std::find(mOwn.begin(), mOwn.end(), 0) == mOwn.end();
}

void RowBatch::setRadii()
{
    const Radius& radius = mMeasures.sets.radius;
    double* const inverse = column(kInverse);
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        const std::size_t begin = mFirstGroup[r] * kGroup, end = mFirstGroup[r + 1] * kGroup;
        if (begin == end && !(mOwn[r] > 0)) continue;
        const std::uint32_t query = mGroups.query[r];
        if (!mIsByPair) {
            mReferences[r] = radius.ofQueries[query];
            std::fill(inverse + begin, inverse + end, 1 / mReferences[r]);
            continue;
        }
        // The smallest: weights relative to its W(0) are at most 1, however large the others are.
        const double own =
            mOwn[r] > 0 ? radiusOfPair(radius, query, query) : std::numeric_limits<double>::infinity();
        mReferences[r] = own;
        for (std::size_t k = begin; k < end; ++k) {
            const double ofPair = radiusOfPair(radius, query, mGroups.numbers[k]);
            mReferences[r] = std::min(mReferences[r], ofPair);
            inverse[k] = 1 / ofPair;
        }
        if (mOwn[r] > 0) mOwnWeights[r] = cube(mReferences[r] / own);
    }
}

void RowBatch::makePairs(const LeafPlaces& places)
{
    const PairPositions& positions = mMeasures.positions;
    mMeasures.kernels.pairs[static_cast<std::size_t>(positions.record())](
        mGroups, positions.queries(), positions.candidates(), positions.map(), places,
        mWantsVectors ? column(kX) : nullptr, column(kY), column(kZ), column(kDistance));
    if (positions.hasUnknown()) lookUnknownUp();
}

void RowBatch::lookUnknownUp()
{
    double* const square = column(kDistance);
    for (std::size_t k = 0; k < mGroups.groups * kGroup; ++k) {
        if (!std::isnan(square[k])) continue;
        const Vec3d d = mMeasures.positions.lookUp(mGroups.query[mGroupRow[k / kGroup]], mGroups.numbers[k]);
        square[k] = (d[0] * d[0] + d[1] * d[1]) + d[2] * d[2];
        for (int c = 0; c < 3 && mWantsVectors; ++c) column(kX + c)[k] = d[static_cast<std::size_t>(c)];
    }
}

// W is a weight times W(0) of the row's reference: where radii differ from pair to pair, by the cube of its ratio to them.
void RowBatch::scaleByRadii()
{
    double* const weight = column(kWeight);
    const double* const inverse = column(kInverse);
    for (std::size_t k = 0; k < mGroups.groups * kGroup; ++k)
        weight[k] *= cube(mReferences[mGroupRow[k / kGroup]] * inverse[k]);
}

PairRadii RowBatch::radii()
{
    return mHasRadii ? PairRadii{column(kInverse), false} : PairRadii{&mInverseRadius, true};
}

// For `sums` sums at a time.
std::uint64_t* RowBatch::scratch(std::size_t sums)
{
    mScratch.resizeDiscarding((mGroups.groups + 1) * kGroup * sums);
    return mScratch.data();
}

// Of terms up to `greatest` in each row.
const RowScale* RowBatch::scalesOf(const std::vector<double>& greatest)
{
    mScales.resize(mGroups.rows);
    mMeasures.kernels.scales(mGroups, greatest.data(), nullptr, nullptr, 0, mScales.data());
    return mScales.data();
}

void RowBatch::weigh(PairWeight weight, bool areSquares, Column out, std::vector<double>& sums)
{
    sums.resize(mGroups.rows);
    mOnes.assign(mGroups.rows, 1.0);
    mMeasures.kernels.weights(weight, mGroups, column(kDistance), areSquares, radii(), scalesOf(mOnes),
                              scratch(1), column(out), sums.data());
    if (mIsByPair && out == kWeight) {
        scaleByRadii();
        sum(out, 0, kFactorX, false, sums);
    } else if (!mAllHaveOwn) {
        sum(out, 0, kFactorX, true, sums);
    }
}

// `isBounded`: by the weight of the query itself, which is the largest there is.
void RowBatch::sum(Column weight, int factorCount, Column firstFactor, bool isBounded,
                   std::vector<double>& out)
{
    const double* factors[3];
    for (int f = 0; f < factorCount; ++f) factors[f] = column(firstFactor + f);
    const std::size_t each = static_cast<std::size_t>(std::max(factorCount, 1));
    mScales.resize(mGroups.rows);
    out.resize(mGroups.rows * each);
    mMeasures.kernels.scales(mGroups, isBounded ? mOwn.data() : nullptr, column(weight), factors, factorCount,
                             mScales.data());
    mMeasures.kernels.sums(mGroups, mScales.data(), column(weight), factors, factorCount, scratch(each),
                           out.data());
}

void RowBatch::writeDistances()
{
    if (!mTargets.meanDistance && !mTargets.nearestDistance) return;
    const bool areSquares = !mWantsWeights && !mTargets.stretch;
    if (mTargets.nearestDistance) {
        mSums.resize(mGroups.rows);
        mMeasures.kernels.least(mGroups, column(kDistance), mSums.data());
        for (std::size_t r = 0; r < mGroups.rows; ++r) {
            if (mCounts[r] > 0)
                mTargets.nearestDistance[mGroups.query[r]] =
                    static_cast<float>(areSquares ? std::sqrt(mSums[r]) : mSums[r]);
        }
    }
    if (mTargets.meanDistance) writeMeanDistances(areSquares);
}

void RowBatch::writeMeanDistances(bool areSquares)
{
    mSums.resize(mGroups.rows);
    mMeasures.kernels.distanceSums(mGroups, column(kDistance), areSquares, scalesOf(mReferences), scratch(1),
                                   mSums.data());
    const bool areBounded = !mIsByPair && mMeasures.positions.areStored();
    const auto isPrecise = [&](std::size_t r) {
        return areBounded && isMeanPrecise(mSums[r], mReferences[r], mCounts[r]);
    };
    bool areAllPrecise = true;
    for (std::size_t r = 0; r < mGroups.rows; ++r) areAllPrecise = areAllPrecise && isPrecise(r);
    if (!areAllPrecise) sum(kDistance, 0, kFactorX, false, mPreciseSums);
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        if (mCounts[r] > 0)
            mTargets.meanDistance[mGroups.query[r]] =
                static_cast<float>((isPrecise(r) ? mSums[r] : mPreciseSums[r]) / mCounts[r]);
    }
}

void RowBatch::writeDensities()
{
    const MeasureOptions& options = mMeasures.options;
    const bool hasMasses = !options.masses.empty();
    if (hasMasses) {
        mMeasures.kernels.scalars[1](mGroups, options.masses.data(), column(kFactorX));
        sum(kWeight, 1, kFactorX, false, mSums);
    }
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        const std::uint32_t query = mGroups.query[r];
        const double ownWeight = mOwnWeights[r];
        const double own = ownWeight > 0 && hasMasses ? ownWeight * options.masses[query] : 0;
        const double total = hasMasses ? mSums[r] + own : options.mass * (mWeightSums[r] + ownWeight);
        if (!(total > 0)) continue; // W(0) of a tiny radius is infinite
        mTargets.density[query] = static_cast<float>(total * weightAtZero(options.kernel, mReferences[r]));
    }
}

void RowBatch::writeAverage(const MeasureTargets::Average& average)
{
    const AveragedAttribute& attribute = mMeasures.averaged[average.attribute];
    const MeasureKernels& kernels = mMeasures.kernels;
    Column weight = kWeight;
    if (attribute.valid) {
        weight = kValidWeight;
        for (std::size_t k = 0; k < mGroups.groups * kGroup; ++k)
            column(kValidWeight)[k] = column(kWeight)[k] * attribute.valid[mGroups.numbers[k]];
        sum(kValidWeight, 0, kFactorX, false, mValidSums);
    }
    const std::size_t width = attribute.isVector ? 3 : 1;
    if (attribute.isVector) {
        kernels.vectors[attribute.isDouble](mGroups, attribute.values, column(kFactorX), column(kFactorY),
                                            column(kFactorZ));
    } else {
        kernels.scalars[attribute.isDouble](mGroups, attribute.values, column(kFactorX));
    }
    sum(weight, static_cast<int>(width), kFactorX, false, mSums);
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        const std::size_t query = mGroups.query[r];
        const bool hasOwn = mOwn[r] > 0 && (!attribute.valid || attribute.valid[query] != 0);
        const double own = hasOwn ? mOwnWeights[r] : 0;
        const double total = (attribute.valid ? mValidSums[r] : mWeightSums[r]) + own;
        if (!(total > 0)) continue;
        for (std::size_t c = 0; c < width; ++c) {
            const double ownTerm = hasOwn ? own * valueOf(attribute, query, c) : 0;
            const double mean = (mSums[width * r + c] + ownTerm) / total * attribute.unit;
            // That of the largest number there is may be rounded past it.
            constexpr double kLargest = std::numeric_limits<double>::max();
            putReal(average.type, average.out, width * query + c, std::clamp(mean, -kLargest, kLargest));
        }
    }
}

// Of the sums of W (x_j - x_i).
void RowBatch::writeNormals()
{
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        const double* const v = mVectors.data() + 3 * r;
        // In units of the largest component, so that nothing passes the range.
        const double largest = std::max({std::fabs(v[0]), std::fabs(v[1]), std::fabs(v[2])});
        if (!(largest > 0) || !std::isfinite(largest)) continue;
        const double u[3] = {v[0] / largest, v[1] / largest, v[2] / largest};
        const double length = std::sqrt((u[0] * u[0] + u[1] * u[1]) + u[2] * u[2]);
        for (std::size_t c = 0; c < 3; ++c)
            mTargets.normal[3 * mGroups.query[r] + c] = static_cast<float>(-u[c] / length);
    }
}

void RowBatch::writePca(std::size_t r)
{
    const PcaOptions& pca = mMeasures.options.pca;
    const std::size_t query = mGroups.query[r], padded = paddedRows();
    if (pca.average > 0) {
        for (std::size_t c = 0; c < 3; ++c) mTargets.pws[3 * query + c] = pca.average * mCenters[3 * r + c];
    }
    const std::uint64_t points = std::uint64_t(mCounts[r]) + (mOwn[r] > 0 ? 1 : 0);
    if (pca.threshold == 0 || points < pca.threshold) return;
    mTargets.ellipsoids[query] = 1;
    for (std::size_t k = 0; k < 3; ++k)
        mTargets.stretch[3 * query + k] = static_cast<float>(mStretches[k * padded + r]);
    for (std::size_t k = 0; k < 9; ++k)
        mTargets.xform[9 * query + k] = static_cast<float>(mAxes[(3 + k) * padded + r]);
}

// Weighted means and moments about them; mVectors has the sums of the weight times x_j - x_i.
void RowBatch::makeMoments(Column weight, const std::vector<double>& weightSums,
                           const std::vector<double>& own)
{
    const std::size_t rows = mGroups.rows;
    mCenters.assign(3 * rows, 0.0);
    mTotals.resize(rows);
    for (std::size_t r = 0; r < rows; ++r) {
        mTotals[r] = weightSums[r] + own[r];
        if (!(mTotals[r] > 0)) continue;
        for (std::size_t c = 0; c < 3; ++c) mCenters[3 * r + c] = mVectors[3 * r + c] / mTotals[r];
    }
    const std::size_t padded = paddedRows();
    mMoments.assign(6 * padded, 0.0);
    mScales.resize(rows);
    mSums.resize(6 * rows);
    mMeasures.kernels.moments(mGroups, column(weight), column(kX), column(kY), column(kZ), mCenters.data(),
                              mScales.data(), scratch(6), mSums.data());
    for (std::size_t r = 0; r < rows; ++r) {
        const double* const c = mCenters.data() + 3 * r;
        const double ofOwn[6] = {c[0] * c[0], c[1] * c[1], c[2] * c[2],
                                 c[0] * c[1], c[0] * c[2], c[1] * c[2]};
        for (std::size_t p = 0; p < 6 && mTotals[r] > 0; ++p)
            mMoments[p * padded + r] = (mSums[6 * r + p] + own[r] * ofOwn[p]) / mTotals[r];
    }
}

void RowBatch::makeAxes()
{
    mAxes.resize(kAxesNumbers * paddedRows());
    mMeasures.kernels.axes(mMoments.data(), paddedRows(), mAxes.data());
}

void RowBatch::writeEigenvalues()
{
    makeMoments(kWeight, mWeightSums, mOwnWeights);
    makeAxes();
    for (std::size_t r = 0; r < mGroups.rows; ++r) {
        for (std::size_t k = 0; k < 3 && mTotals[r] > 0; ++k)
            mTargets.eigenvalues[3 * mGroups.query[r] + k] = static_cast<float>(mAxes[k * paddedRows() + r]);
    }
}

RowBatch::PcaRow::PcaRow(const double* sums, double own, std::uint32_t count)
{
    const double total = sums[0] + own;
    for (int c = 0; c < 3; ++c) center[c] = sums[1 + c] / total;
    const double ofCenter[6] = {center[0] * center[0], center[1] * center[1], center[2] * center[2],
                                center[0] * center[1], center[0] * center[2], center[1] * center[2]};
    for (int p = 0; p < 6; ++p) moments[p] = sums[4 + p] / total - ofCenter[p];
    const double spread = (moments[0] + moments[1] + moments[2]) * total;
    isPrecise = own > 0 && (count == 0 || (count <= kMostAtOnce && spread >= kLeastMoment * count));
}

void RowBatch::makePcaMoments()
{
    const std::size_t rows = mGroups.rows;
    const bool areAtOnce = mMeasures.sets.areSameParticles() && !mIsByPair;
    bool areAllPrecise = areAtOnce;
    mPcaRows.clear();
    if (areAtOnce) {
        mSums.resize(rows * kPcaNumbers);
        mOnes.assign(rows, 1.0);
        mMeasures.kernels.pcaSums(mGroups, column(kDistance), !mWantsWeights, column(kX), column(kY),
                                  column(kZ), radii(), scalesOf(mOnes), scratch(kPcaNumbers), mSums.data());
        for (std::size_t r = 0; r < rows; ++r) {
            mPcaRows.emplace_back(mSums.data() + kPcaNumbers * r, mOwn[r], mCounts[r]);
            areAllPrecise = areAllPrecise && mPcaRows[r].isPrecise;
        }
    }
    if (areAllPrecise) {
        mCenters.resize(3 * rows);
        mMoments.assign(6 * paddedRows(), 0.0);
    } else {
        weigh(PairWeight::kPca, !mWantsWeights && !areAtOnce, kPcaWeight, mPcaSums);
        sum(kPcaWeight, 3, kX, false, mVectors);
        makeMoments(kPcaWeight, mPcaSums, mOwn);
    }
    for (std::size_t r = 0; r < mPcaRows.size(); ++r) {
        const PcaRow& row = mPcaRows[r];
        if (!row.isPrecise) continue;
        for (std::size_t c = 0; c < 3; ++c) mCenters[3 * r + c] = row.center[c] * mReferences[r];
        for (std::size_t p = 0; p < 6; ++p) mMoments[p * paddedRows() + r] = row.moments[p];
    }
}

void RowBatch::writeAllPca()
{
    makePcaMoments();
    makeAxes();
    mStretches.resize(3 * paddedRows());
    mMeasures.kernels.stretches(mAxes.data(), paddedRows(), mMeasures.options.pca.anisotropy,
                                mStretches.data());
    for (std::size_t r = 0; r < mGroups.rows; ++r) writePca(r);
}

void RowBatch::writeValues()
{
    makePairs({});
    if (mWantsWeights) weigh(weightOf(mMeasures.options.kernel), true, kWeight, mWeightSums);
    if (mTargets.density) writeDensities();
    for (const MeasureTargets::Average& average : mTargets.averages) writeAverage(average);
    if (mTargets.normal || mTargets.eigenvalues) sum(kWeight, 3, kX, false, mVectors);
    if (mTargets.normal) writeNormals();
    if (mTargets.eigenvalues) writeEigenvalues();
    if (mTargets.stretch) writeAllPca();
    writeDistances();
}

} // namespace vdb_nns
