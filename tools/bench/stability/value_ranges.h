// What can be said of measures without their neighbors: they are finite or the documented value of none, and agree with each
// other.
#pragma once

#include "bench/set_search.h"
#include "vdb_nns/measure.h"

#include <cstdint>
#include <string>

namespace vdb_nns::cli {

struct RangeFaults {
    std::uint64_t count = 0;
    std::string first; ///< a sentence
};

/// @param made has the values of every measure that it names, one a query, with the types of measure.h
/// @param mayPassRange density, distances and eigenvalues may be infinite
RangeFaults findRangeFaults(const SetSearch& search, const MeasureOptions& options, const Measured& made,
                            bool mayPassRange);

} // namespace vdb_nns::cli
