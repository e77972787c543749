// The rows of all points of a cell, by definition: double arithmetic with a certified bound, exact arithmetic inside it. Knows
// point_cells.h only.
#pragma once

#include "point_cells.h"

#include <algorithm>
#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

// Keeps its buffers from cell to cell; one a thread.
class CellRows {
public:
    CellRows(const PointCloud& cloud, const CellHash& cells, const PairJudge& judge)
        : mCloud(cloud), mCells(cells), mJudge(judge)
    {
    }

    // Calls onRow(query, neighbors), ascending, for every point of the cell.
    template <typename OnRow>
    void run(std::size_t cell, OnRow&& onRow)
    {
        gatherCandidates(cell);
        for (std::size_t at = mCells.begin(cell); at < mCells.end(cell); ++at) {
            const std::uint32_t query = mCells.numbers()[at];
            findNeighbors(query);
            std::sort(mFound.begin(), mFound.end());
            onRow(query, mFound);
        }
    }

    // Tests that needed exact arithmetic, so far.
    std::uint64_t exactPairs() const { return mExactPairs; }

private:
    // Copies the points of the 27 cells about `cell`, the cell itself included.
    void gatherCandidates(std::size_t cell)
    {
        mNumbers.clear();
        const CellKey& center = mCells.key(cell);
        for (int step = 0; step < 27; ++step) {
            const CellKey key{center[0] + step / 9 - 1, center[1] + step / 3 % 3 - 1,
                              center[2] + step % 3 - 1};
            const std::size_t other = mCells.find(key);
            if (other == CellHash::kNone) continue;
            const auto numbers = mCells.numbers().begin();
            mNumbers.insert(mNumbers.end(), numbers + static_cast<std::ptrdiff_t>(mCells.begin(other)),
                            numbers + static_cast<std::ptrdiff_t>(mCells.end(other)));
        }
        for (auto* values : {&mX, &mY, &mZ, &mSquares}) values->resize(mNumbers.size());
        for (std::size_t k = 0; k < mNumbers.size(); ++k) {
            mX[k] = mCloud.x[mNumbers[k]];
            mY[k] = mCloud.y[mNumbers[k]];
            mZ[k] = mCloud.z[mNumbers[k]];
        }
        mFound.reserve(mNumbers.size());
    }

    void findNeighbors(std::uint32_t query)
    {
        const std::size_t count = mNumbers.size();
        squaredDistances(mX.data(), mY.data(), mZ.data(), count, mCloud.x[query], mCloud.y[query],
                         mCloud.z[query], mSquares.data());
        // Every candidate is written, and kept by moving on: no branch to guess wrong.
        mFound.resize(count);
        std::size_t found = 0, unsure = 0;
        for (std::size_t k = 0; k < count; ++k) {
            mFound[found] = mNumbers[k];
            const unsigned near = mSquares[k] <= mCloud.sureBeyond, other = mNumbers[k] != query;
            const unsigned sure = mSquares[k] <= mCloud.sureWithin;
            found += near & other;
            unsure += near - sure;
        }
        mFound.resize(found);
        if (unsure) decide(query);
    }

    // Drops the unsure candidates that exact arithmetic puts outside.
    void decide(std::uint32_t query)
    {
        mFound.clear();
        for (std::size_t k = 0; k < mNumbers.size(); ++k) {
            if (mSquares[k] > mCloud.sureBeyond || mNumbers[k] == query) continue;
            if (mSquares[k] > mCloud.sureWithin) {
                ++mExactPairs;
                if (!mJudge.within(query, mNumbers[k])) continue;
            }
            mFound.push_back(mNumbers[k]);
        }
    }

    const PointCloud& mCloud;
    const CellHash& mCells;
    const PairJudge& mJudge;
    std::uint64_t mExactPairs = 0;
    std::vector<std::uint32_t> mNumbers, mFound; // candidates; neighbors of one query
    std::vector<double> mX, mY, mZ, mSquares;    // of the candidates
};

} // namespace vdb_nns::cli
