// Measures of rows of neighbors: a thread collects rows pair by pair and, a few hundred pairs at a time, has the kernels weigh and
// sum them. Knows weights, radii and results; not who is a neighbor.
#pragma once

#include "cpu/kernels.h"
#include "grid/search_sets_data.h"
#include "measure/pair_positions.h"
#include "measure/results.h"
#include "util/memory.h"
#include "vdb_nns/measure.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

// An attribute of the candidates, by number: floats or doubles, FloatPosition or DoublePosition if it is a vector.
struct AveragedAttribute {
    bool isDouble = false, isVector = false;
    const void* values = nullptr;  // finite: 0 where the attribute is not
    const double* valid = nullptr; // 1 or 0; null where all are
};

// What all threads share in a pass.
struct RowMeasures {
    const SearchSetsData& sets;
    const MeasureKernels& kernels;
    const PairPositions& positions;
    const MeasureOptions& options;
    const MeasureTargets& targets;
    const std::vector<AveragedAttribute>& averaged; // as MeasureOptions::attributes; those that are averaged
    double radius; // of all pairs; where particles have their own, the largest
};

class RowBatch {
public:
    explicit RowBatch(const RowMeasures& measures);

    // Takes the row of a query. The numbers are not kept.
    void add(std::uint32_t query, const std::uint32_t* neighbors, std::uint32_t count);
    // Writes the values of the rows that are there.
    void flush();

private:
    struct Row {
        std::uint32_t query;
        double ownWeight;           // of the query in the sums of W: 0 where it is no candidate
        double isOwn;               // 1 where it is one
        double reference;           // radius that W is a multiple of
        double weights, pcaWeights; // sums over the pairs
    };
    // Numbers of doubles a pair.
    enum Column {
        kX,
        kY,
        kZ,
        kDistance,
        kWeight,
        kPcaWeight,
        kInverse,
        kValidWeight,
        kFactorX, // values of an attribute, masses
        kFactorY,
        kFactorZ,
        kColumns
    };

    double* column(int c) { return mPairs.data() + static_cast<std::size_t>(c) * mCapacity; }
    // Keeps the pairs that are there.
    void reserve(std::size_t pairs);
    void setRadii(Row& row, const std::uint32_t* neighbors, std::uint32_t count, std::size_t begin);
    void weigh(Row& row, std::size_t begin, std::uint32_t count);
    void writeDistances(std::uint32_t query, std::size_t begin, std::uint32_t count);
    void scaleByRadii(Row& row, std::size_t begin, std::uint32_t count);
    void writeDensities(const PairRows& rows);
    void writeNormals();
    void writeAxes(const PairRows& rows, Column weight, bool isPca);
    void writePca(const double* eigen, std::size_t r);
    void writeEigenvalues(const double* eigen, std::size_t r);
    const double* sums(const PairRows& rows, Column weight, const double* factor);
    void sumVectors(const PairRows& rows, Column weight, Column x);
    void writeAverage(const MeasureTargets::Average& average, const PairRows& rows);

    const RowMeasures& mMeasures;
    const MeasureTargets& mTargets;
    const bool mWantsWeights, mWantsVectors, mWantsNumbers, mHasRadii, mIsByPair;
    std::size_t mCapacity = 0, mUsed = 0;
    PageArray<double> mPairs;
    PageArray<std::uint32_t> mNumbers; // of the candidate of each pair; pads repeat the last
    std::vector<Row> mRows;
    std::vector<std::uint32_t> mBegin, mCount;
    std::vector<double> mSums, mValidSums, mTotals, mVectors, mCenters, mMoments, mEigen;
};

} // namespace vdb_nns
