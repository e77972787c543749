// Measures of rows of neighbors: a few hundred pairs at a time, a thread has the kernels weigh and sum them. Knows weights, radii and
// results; not who is a neighbor.
#pragma once

#include "cpu/kernels.h"
#include "grid/search_sets_data.h"
#include "measure/pair_positions.h"
#include "measure/results.h"
#include "search/thread_state.h"
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
    double unit = 1;               // that the values have, a power of two
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

    // Writes the values of queries, given by number, whose rows these are.
    void take(const std::uint32_t* queries, const VisitedRows& rows);

private:
    // Numbers of doubles a pair.
    enum Column {
        kX,
        kY,
        kZ,
        kDistance,
        kWeight,
        kPcaWeight,
        kInverse, // of the pair's radius
        kValidWeight,
        kFactorX, // values of an attribute, masses
        kFactorY,
        kFactorZ,
        kColumns
    };

    // Moments of points::pca in units of the radius, from those about the query, which one loop has summed up. Where the query is one
    // of the points itself, little cancels.
    struct PcaRow {
        double center[3], moments[6]; // moments as MomentsFunction has them
        bool isPrecise;

        PcaRow(const double* sums, double own, std::uint32_t count);
    };

    double* column(int c) { return mPairs.data() + static_cast<std::size_t>(c) * mCapacity * kGroup; }
    void reserve(std::size_t groups);
    // Lists the groups of the next rows, as many as a batch takes, and returns how many rows they are.
    std::size_t listGroups(const std::uint32_t* counts, std::size_t rows);
    void setOwnWeights();
    void setRadii();
    void writeValues();
    void makePairs();
    void lookUnknownUp();
    PairRadii radii();
    std::uint64_t* scratch(std::size_t sums);
    const RowScale* scalesOf(const std::vector<double>& greatest);
    void weigh(PairWeight weight, bool areSquares, Column out, std::vector<double>& sums);
    void scaleByRadii();
    void sum(Column weight, int factorCount, Column firstFactor, bool isBounded, std::vector<double>& out);
    void writeDensities();
    void writeAverage(const MeasureTargets::Average& average);
    void writeNormals();
    std::size_t paddedRows() const { return (mGroups.rows + kAxesPad - 1) / kAxesPad * kAxesPad; }
    void makeMoments(Column weight, const std::vector<double>& weightSums, const std::vector<double>& own);
    void makePcaMoments();
    void makeAxes();
    void writeEigenvalues();
    void writeAllPca();
    void writePca(std::size_t r);
    void writeDistances();
    void writeMeanDistances(bool areSquares);

    const RowMeasures& mMeasures;
    const MeasureTargets& mTargets;
    const bool mWantsWeights, mWantsVectors, mHasRadii, mIsByPair;
    const double mInverseRadius; // of all pairs
    std::size_t mCapacity = 0;   // groups
    PairGroups mGroups{};
    PageArray<double> mPairs;
    PageArray<std::uint32_t> mGroupRow, mGroupPairs; // PairGroups::row, pairs
    std::vector<std::uint32_t> mFirstGroup;
    PageArray<std::uint64_t> mScratch;
    // By row.
    const std::uint32_t* mCounts = nullptr; // of pairs
    std::vector<double> mOwn;               // 1 where the query is a candidate, else 0
    bool mAllHaveOwn = false;               // they are all 1
    std::vector<double> mOwnWeights;        // of the query in the sums of W: 0 where it is no candidate
    std::vector<double> mReferences;        // radius that W is a multiple of
    std::vector<RowScale> mScales;
    std::vector<double> mOnes, mWeightSums, mPcaSums, mSums, mPreciseSums, mValidSums, mTotals, mVectors,
        mCenters, mMoments, mAxes, mStretches;
    std::vector<PcaRow> mPcaRows;
};

} // namespace vdb_nns
