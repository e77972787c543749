#include "measure/row_batch.h"

#include "exact/exact_test.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatchPairs = 512; // whose columns fit the first-level cache
constexpr double kPi = 3.14159265358979323846;

std::size_t padded(std::size_t pairs)
{
    return (pairs + kPairPad - 1) / kPairPad * kPairPad;
}

PairWeight weightOf(SmoothingKernel kernel)
{
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return PairWeight::kCubic;
    case SmoothingKernel::kWendland2:
        return PairWeight::kWendland2;
    case SmoothingKernel::kPoly6:
        return PairWeight::kPoly6;
    case SmoothingKernel::kTophat:
        break;
    }
    return PairWeight::kTophat;
}

// W(0) of a support of 1.
double weightAtZero(SmoothingKernel kernel)
{
    switch (kernel) {
    case SmoothingKernel::kCubic:
        return 8 / kPi;
    case SmoothingKernel::kWendland2:
        return 21 / (2 * kPi);
    case SmoothingKernel::kPoly6:
        return 315 / (64 * kPi);
    case SmoothingKernel::kTophat:
        break;
    }
    return 3 / (4 * kPi);
}

double cube(double x)
{
    return x * x * x;
}

// Of x in (0, 1], by Newton's steps from 2^-k / 2, k >= 0: the C library's differs from version to version.
double cubeRoot(double x)
{
    double scale = 1;
    for (; x < 0.125; x *= 8) scale *= 0.5;
    double y = 0.5 + 0.5 * x; // above the root
    for (int step = 0; step < 6; ++step) y = (2 * y + x / (y * y)) / 3;
    return y * scale;
}

// Eigenvalues in descending order and their vectors as a rotation: see measure.h.
struct Axes {
    double value[3];
    double vector[3][3];

    explicit Axes(const double* eigen)
    {
        int order[3] = {0, 1, 2};
        const auto sortTwo = [&](int a, int b) {
            if (eigen[order[a]] < eigen[order[b]]) std::swap(order[a], order[b]);
        };
        sortTwo(0, 1);
        sortTwo(1, 2);
        sortTwo(0, 1);
        for (int k = 0; k < 3; ++k) {
            value[k] = std::max(eigen[order[k]], 0.0); // a rounding below
            for (int c = 0; c < 3; ++c) vector[k][c] = eigen[3 + 3 * c + order[k]];
        }
        makePositive(vector[0]);
        makePositive(vector[1]);
        for (int c = 0; c < 3; ++c) {
            const int d = (c + 1) % 3, e = (c + 2) % 3;
            vector[2][c] = vector[0][d] * vector[1][e] - vector[0][e] * vector[1][d];
        }
    }

private:
    static void makePositive(double (&v)[3])
    {
        int largest = 0;
        for (int c = 1; c < 3; ++c) {
            if (std::fabs(v[c]) > std::fabs(v[largest])) largest = c;
        }
        if (v[largest] >= 0) return;
        for (double& x : v) x = -x;
    }
};

} // namespace

RowBatch::RowBatch(const RowMeasures& measures)
    : mMeasures(measures),
      mTargets(measures.targets),
      mWantsWeights(mTargets.density || mTargets.normal || mTargets.eigenvalues ||
                    !mTargets.averages.empty()),
      mWantsVectors(mTargets.normal || mTargets.eigenvalues || mTargets.stretch),
      mWantsNumbers(!mTargets.averages.empty() || (mTargets.density && !measures.options.masses.empty())),
      mHasRadii(!measures.sets.radius.isOne()),
      mIsByPair(mHasRadii && measures.sets.radius.mode != RadiusMode::kGather)
{
    reserve(2 * kBatchPairs);
}

void RowBatch::reserve(std::size_t pairs)
{
    if (pairs <= mCapacity) return;
    const std::size_t capacity = padded(pairs + pairs / 2);
    PageArray<double> grown;
    grown.resizeDiscarding(capacity * kColumns);
    for (std::size_t c = 0; c < kColumns && mUsed > 0; ++c)
        std::memcpy(grown.data() + c * capacity, column(static_cast<Column>(c)), mUsed * sizeof(double));
    PageArray<std::uint32_t> numbers;
    numbers.resizeDiscarding(capacity);
    if (mUsed > 0) std::memcpy(numbers.data(), mNumbers.data(), mUsed * sizeof(std::uint32_t));
    mPairs = std::move(grown);
    mNumbers = std::move(numbers);
    mCapacity = capacity;
}

void RowBatch::add(std::uint32_t query, const std::uint32_t* neighbors, std::uint32_t count)
{
    const std::size_t begin = mUsed, end = begin + padded(count);
    reserve(end);
    // A radius that reaches nobody does not reach the query itself.
    const bool isOwn = mMeasures.sets.isCandidate(query) &&
                       (!mHasRadii || radiusOfPair(mMeasures.sets.radius, query, query) > 0);
    Row row{query, isOwn ? 1.0 : 0.0, isOwn ? 1.0 : 0.0, mMeasures.radius, 0, 0};
    if (count > 0) {
        const PairPositions& positions = mMeasures.positions;
        mMeasures.kernels.pairs[static_cast<std::size_t>(positions.record())](
            positions.query(query), positions.candidates(), positions.map(), neighbors, count,
            mWantsVectors ? column(kX) + begin : nullptr, column(kY) + begin, column(kZ) + begin,
            column(kDistance) + begin);
        if (mWantsNumbers) {
            std::memcpy(mNumbers.data() + begin, neighbors, count * sizeof(std::uint32_t));
            std::fill(mNumbers.data() + begin + count, mNumbers.data() + end, neighbors[count - 1]);
        }
    }
    if (mHasRadii && (count > 0 || isOwn)) setRadii(row, neighbors, count, begin);
    if (count > 0) {
        weigh(row, begin, count);
        writeDistances(query, begin, count);
    }
    mRows.push_back(row);
    mBegin.push_back(static_cast<std::uint32_t>(begin));
    mCount.push_back(count);
    mUsed = end;
    if (mUsed >= kBatchPairs || mRows.size() >= kBatchPairs) flush();
}

void RowBatch::setRadii(Row& row, const std::uint32_t* neighbors, std::uint32_t count, std::size_t begin)
{
    const Radius& radius = mMeasures.sets.radius;
    double* const inverse = column(kInverse) + begin;
    if (!mIsByPair) {
        row.reference = radius.ofQueries[row.query];
        std::fill(inverse, inverse + padded(count), 1 / row.reference);
        return;
    }
    for (std::size_t k = 0; k < padded(count); ++k) {
        const std::uint32_t j = neighbors[std::min<std::size_t>(k, count - 1)];
        inverse[k] = 1 / radiusOfPair(radius, row.query, j);
    }
    if (row.isOwn == 0) return;
    const double own = radiusOfPair(radius, row.query, row.query);
    row.ownWeight = own > 0 ? cube(row.reference / own) : 0;
}

// W is a weight times W(0) of the row's reference: where radii differ from pair to pair, by the cube of its ratio to them.
void RowBatch::scaleByRadii(Row& row, std::size_t begin, std::uint32_t count)
{
    double* const weight = column(kWeight) + begin;
    const double* const inverse = column(kInverse) + begin;
    for (std::size_t k = 0; k < count; ++k) weight[k] *= cube(row.reference * inverse[k]);
    const std::uint32_t first = 0;
    mMeasures.kernels.sums({&first, &count, 1}, weight, nullptr, &row.weights);
}

void RowBatch::weigh(Row& row, std::size_t begin, std::uint32_t count)
{
    const double one = 1 / mMeasures.radius;
    const double* const inverse = mHasRadii ? column(kInverse) + begin : &one;
    const std::size_t step = mHasRadii ? 1 : 0;
    const double* const distance = column(kDistance) + begin;
    // The query's own weight is 1, the largest.
    if (mWantsWeights) {
        row.weights = mMeasures.kernels.weights(weightOf(mMeasures.options.kernel), count, distance, inverse,
                                                step, row.isOwn, column(kWeight) + begin);
        if (mIsByPair) scaleByRadii(row, begin, count);
    }
    if (mTargets.stretch) {
        row.pcaWeights = mMeasures.kernels.weights(PairWeight::kPca, count, distance, inverse, step,
                                                   row.isOwn, column(kPcaWeight) + begin);
    }
}

void RowBatch::writeDistances(std::uint32_t query, std::size_t begin, std::uint32_t count)
{
    if (!mTargets.meanDistance && !mTargets.nearestDistance) return;
    const RowDistances row = mMeasures.kernels.rowDistances(count, column(kDistance) + begin);
    if (mTargets.meanDistance) mTargets.meanDistance[query] = static_cast<float>(row.sum / count);
    if (mTargets.nearestDistance) mTargets.nearestDistance[query] = static_cast<float>(row.least);
}

const double* RowBatch::sums(const PairRows& rows, Column weight, const double* factor)
{
    mSums.resize(rows.rows);
    mMeasures.kernels.sums(rows, column(weight), factor, mSums.data());
    return mSums.data();
}

void RowBatch::sumVectors(const PairRows& rows, Column weight, Column x)
{
    mVectors.resize(3 * rows.rows);
    mMeasures.kernels.vectorSums(rows, column(weight), column(x), column(x + 1), column(x + 2),
                                 mVectors.data());
}

namespace {

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

void RowBatch::writeAverage(const MeasureTargets::Average& average, const PairRows& rows)
{
    const AveragedAttribute& attribute = mMeasures.averaged[average.attribute];
    const MeasureKernels& kernels = mMeasures.kernels;
    Column weight = kWeight;
    if (attribute.valid) {
        weight = kValidWeight;
        for (std::size_t k = 0; k < mUsed; ++k)
            column(kValidWeight)[k] = column(kWeight)[k] * attribute.valid[mNumbers[k]];
        mValidSums.resize(rows.rows);
        kernels.sums(rows, column(kValidWeight), nullptr, mValidSums.data());
    }
    const std::size_t width = attribute.isVector ? 3 : 1;
    const double* sum = nullptr;
    if (attribute.isVector) {
        kernels.vectors[attribute.isDouble](attribute.values, mNumbers.data(), mUsed, column(kFactorX),
                                            column(kFactorY), column(kFactorZ));
        sumVectors(rows, weight, kFactorX);
        sum = mVectors.data();
    } else {
        kernels.scalars[attribute.isDouble](attribute.values, mNumbers.data(), mUsed, column(kFactorX));
        sum = sums(rows, weight, column(kFactorX));
    }
    for (std::size_t r = 0; r < rows.rows; ++r) {
        const std::size_t query = mRows[r].query;
        const bool hasOwn = mRows[r].isOwn != 0 && (!attribute.valid || attribute.valid[query] != 0);
        const double own = hasOwn ? mRows[r].ownWeight : 0;
        const double total = (attribute.valid ? mValidSums[r] : mRows[r].weights) + own;
        if (!(total > 0)) continue;
        for (std::size_t c = 0; c < width; ++c) {
            const double ownTerm = hasOwn ? own * valueOf(attribute, query, c) : 0;
            putReal(average.type, average.out, width * query + c, (sum[width * r + c] + ownTerm) / total);
        }
    }
}

void RowBatch::writePca(const double* eigen, std::size_t r)
{
    const PcaOptions& pca = mMeasures.options.pca;
    const std::size_t query = mRows[r].query;
    if (pca.average > 0) {
        for (std::size_t c = 0; c < 3; ++c) mTargets.pws[3 * query + c] += pca.average * mCenters[3 * r + c];
    }
    const std::uint64_t points = mCount[r] + (mRows[r].isOwn != 0 ? 1u : 0u);
    if (pca.threshold == 0 || points < pca.threshold) return;
    mTargets.ellipsoids[query] = 1;
    const Axes axes(eigen);
    double length[3] = {1, 1, 1};
    if (axes.value[0] > 0) {
        for (int k = 1; k < 3; ++k) length[k] = std::max(axes.value[k] / axes.value[0], pca.anisotropy);
        const double root = cubeRoot(length[1]) * cubeRoot(length[2]);
        for (double& l : length) l /= root;
    }
    for (std::size_t k = 0; k < 3; ++k) {
        mTargets.stretch[3 * query + k] = static_cast<float>(length[k]);
        for (std::size_t c = 0; c < 3; ++c)
            mTargets.xform[9 * query + 3 * c + k] = static_cast<float>(axes.vector[k][c]);
    }
}

void RowBatch::writeEigenvalues(const double* eigen, std::size_t r)
{
    const Axes axes(eigen);
    for (std::size_t k = 0; k < 3; ++k)
        mTargets.eigenvalues[3 * mRows[r].query + k] = static_cast<float>(axes.value[k]);
}

// Weighted means and moments about them; mVectors has the sums of W (x_j - x_i).
void RowBatch::writeAxes(const PairRows& rows, Column weight, bool isPca)
{
    const std::size_t count = rows.rows;
    mCenters.assign(3 * count, 0.0);
    std::vector<double>& totals = mTotals;
    totals.resize(count);
    for (std::size_t r = 0; r < count; ++r) {
        const Row& row = mRows[r];
        totals[r] = isPca ? row.pcaWeights + row.isOwn : row.weights + row.ownWeight;
        if (!(totals[r] > 0)) continue;
        for (std::size_t c = 0; c < 3; ++c) mCenters[3 * r + c] = mVectors[3 * r + c] / totals[r];
    }
    mMoments.assign(6 * padded(count), 0.0);
    mMeasures.kernels.momentSums(rows, column(weight), column(kX), column(kY), column(kZ), mCenters.data(),
                                 mMoments.data());
    for (std::size_t r = 0; r < count; ++r) {
        const double own = isPca ? mRows[r].isOwn : mRows[r].ownWeight;
        const double* const c = mCenters.data() + 3 * r;
        const double ofOwn[6] = {c[0] * c[0], c[1] * c[1], c[2] * c[2],
                                 c[0] * c[1], c[0] * c[2], c[1] * c[2]};
        for (std::size_t p = 0; p < 6; ++p) {
            double& moment = mMoments[6 * r + p];
            moment = totals[r] > 0 ? (moment + own * ofOwn[p]) / totals[r] : 0;
        }
    }
    mEigen.resize(kEigenNumbers * padded(count));
    mMeasures.kernels.eigen(mMoments.data(), padded(count), mEigen.data());
    for (std::size_t r = 0; r < count; ++r) {
        if (!(totals[r] > 0)) continue;
        const double* const eigen = mEigen.data() + kEigenNumbers * r;
        if (isPca) {
            writePca(eigen, r);
        } else {
            writeEigenvalues(eigen, r);
        }
    }
}

void RowBatch::flush()
{
    if (mRows.empty()) return;
    const PairRows rows{mBegin.data(), mCount.data(), mRows.size()};
    if (mTargets.density) writeDensities(rows);
    for (const MeasureTargets::Average& average : mTargets.averages) writeAverage(average, rows);
    if (mTargets.normal || mTargets.eigenvalues) sumVectors(rows, kWeight, kX);
    if (mTargets.normal) writeNormals();
    if (mTargets.eigenvalues) writeAxes(rows, kWeight, false);
    if (mTargets.stretch) {
        sumVectors(rows, kPcaWeight, kX);
        writeAxes(rows, kPcaWeight, true);
    }
    mRows.clear();
    mBegin.clear();
    mCount.clear();
    mUsed = 0;
}

void RowBatch::writeDensities(const PairRows& rows)
{
    const MeasureOptions& options = mMeasures.options;
    const double* sum = nullptr;
    const bool hasMasses = !options.masses.empty();
    if (hasMasses) {
        mMeasures.kernels.scalars[1](options.masses.data(), mNumbers.data(), mUsed, column(kFactorX));
        sum = sums(rows, kWeight, column(kFactorX));
    }
    const double atZero = weightAtZero(options.kernel);
    for (std::size_t r = 0; r < rows.rows; ++r) {
        const Row& row = mRows[r];
        const double total = hasMasses
                                 ? sum[r] + (row.isOwn != 0 ? row.ownWeight * options.masses[row.query] : 0)
                                 : options.mass * (row.weights + row.ownWeight);
        mTargets.density[row.query] = static_cast<float>(total * (atZero / cube(row.reference)));
    }
}

void RowBatch::writeNormals()
{
    for (std::size_t r = 0; r < mRows.size(); ++r) {
        const double* const v = mVectors.data() + 3 * r;
        // In units of the largest component, so that nothing passes the range.
        const double largest = std::max({std::fabs(v[0]), std::fabs(v[1]), std::fabs(v[2])});
        if (!(largest > 0) || !std::isfinite(largest)) continue;
        const double u[3] = {v[0] / largest, v[1] / largest, v[2] / largest};
        const double length = std::sqrt((u[0] * u[0] + u[1] * u[1]) + u[2] * u[2]);
        for (std::size_t c = 0; c < 3; ++c)
            mTargets.normal[3 * mRows[r].query + c] = static_cast<float>(-u[c] / length);
    }
}

} // namespace vdb_nns
