// The neighbors of queries by definition: double arithmetic with a certified bound, exact arithmetic inside it.
#pragma once

#include "radius_classes.h"
#include "search_clouds.h"

#include <cstdint>
#include <vector>

namespace vdb_nns::cli {

// Bounds of every candidate's own radius; empty where those do not count.
std::vector<Bounds> candidateBounds(const SearchJudge& judge, const SearchClouds& clouds);

// Keeps its buffers from query to query; one a thread.
class RowFinder {
public:
    // `bounds`: see above.
    RowFinder(const SearchJudge& judge, const SearchClouds& clouds, const std::vector<Bounds>& bounds);

    // Numbers of the candidates within the radius of a query that has its role, itself left out; ascending. Cheapest for
    // queries of one cell in turn.
    const std::vector<std::uint32_t>& findByCells(std::uint32_t query, const HashList& hashes);

    // Adds those among the candidates [begin, end), whatever their cells, to `found`.
    void findAmong(std::uint32_t query, std::size_t begin, std::size_t end,
                   std::vector<std::uint32_t>& found);

    // Tests that needed exact arithmetic, so far.
    std::uint64_t exactPairs() const { return mExactPairs; }

private:
    // Copies of the candidates of the 27 cells about one.
    struct Gathered {
        const CellHash* hash = nullptr;
        CellKey cell{};
        std::vector<std::uint32_t> numbers;
        std::vector<double> x, y, z;
        std::vector<Bounds> bounds;
    };

    const Bounds& boundsOf(std::uint32_t query);
    void gather(const CellHash& hash, const CellKey& cell, Gathered& gathered) const;
    void test(std::uint32_t query, const double* x, const double* y, const double* z, const Bounds* bounds,
              const std::uint32_t* numbers, std::uint32_t firstNumber, std::size_t count,
              std::vector<std::uint32_t>& found);

    const SearchJudge& mJudge;
    const SearchClouds& mClouds;
    const std::vector<Bounds>& mBounds;
    std::uint64_t mExactPairs = 0;
    double mRadius = 0; // of the query that was last, and what follows from it
    Bounds mOwn;
    std::vector<Gathered> mGathered; // of each hash of a list
    std::vector<double> mSquares;
    std::vector<std::uint32_t> mFound;
};

} // namespace vdb_nns::cli
