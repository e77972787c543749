// The order of a row by distance, in real arithmetic: doubles where their bounds tell, exact arithmetic where they do not, and the
// smaller number first where two are as far.
#pragma once

#include "exact/exact_test.h"

#include <cstddef>
#include <cstdint>
#include <vector>

namespace vdb_nns {

// One for each thread.
class DistanceOrder {
public:
    // `exact` outlives it.
    explicit DistanceOrder(const ExactTest& exact) : mExact(&exact) {}

    void order(std::uint32_t query, std::uint32_t* numbers, std::size_t count);

    // Leaves the nearest `most`, at least 1, of a row of more, in the order that they have. Adds to exactPairs as ExactTest.
    void keepNearest(std::uint32_t query, std::vector<std::uint32_t>& numbers, std::size_t most,
                     std::uint64_t& exactPairs);

private:
    struct Neighbor {
        double square;
        std::uint32_t number;
    };
    const ExactTest* mExact;
    std::vector<Neighbor> mRow;
    std::vector<double> mSquares;
    std::vector<std::uint32_t> mDoubtful;
};

} // namespace vdb_nns
