// Measures of rows of neighbors: a few hundred pairs at a time, a thread has the kernels weigh and sum them. Knows weights, radii and
// results; not who is a neighbor.
#pragma once

#include "measure/leaf_sums.h"
#include "measure/row_measures.h"
#include "search/thread_state.h"
#include "util/memory.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

class RowBatch {
public:
    explicit RowBatch(const RowMeasures& measures);

    // Writes the values of queries, given by number, whose rows these are.
    void take(const std::uint32_t* queries, const VisitedRows& rows);

    // Adds up the pairs of rows that are half of those of a leaf.
    void takeOnce(const std::uint32_t* queries, const VisitedRows& rows, LeafSums& leaf);

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
    // f(first row) for the rows that each batch takes.
    template <typename F>
    void forEachBatch(const std::uint32_t* queries, const VisitedRows& rows, F&& f);
    void makePairs(const LeafPlaces& places);
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
    PageArray<std::uint32_t> mPlaces;                // of pairs, of LeafPlaces
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
