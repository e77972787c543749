// `vdb_nns verify` on attributes: what a file says of measures against the same measures made anew. Neighbors are found as those
// of lists are (row_pass.h), sums are made in long double by number (expected_values.h), clusters one pair after the other
// (cluster_labels.h). Shares nothing with the engine but the names.
#pragma once

#include "independent_search.h"
#include "search_judge.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

// What a file says.
struct MeasureClaims {
    std::string path;               // begins messages
    std::vector<std::string> names; // of the measures that are checked
    MeasureOptions options;         // `search` is not read
    PointValues values;             // by number of the query, with the names that they have in the file
    // By number of the query: 0 for those that are not in the file. Empty: all are.
    std::vector<std::uint8_t> isThere;
};

struct ValueExample {
    std::uint64_t query;
    std::size_t component; // of a vector or matrix, else 0
    double value;          // what the file has
    double expected, bound;
    std::string what; // if it is not that number that is wrong: the end of a sentence about the value
};

// What was found of one attribute or group.
struct ValueFinding {
    std::string name; // without the prefix
    std::uint64_t checked = 0;
    std::uint64_t undetermined = 0; // of these: some properties alone, as doubles do not determine the value
    std::uint64_t count = 0;        // wrong
    std::vector<ValueExample> examples; // the first by query
};

struct MeasureReport {
    std::uint64_t queries = 0, expectedPairs = 0, exactPairs = 0;
    // In the order of the names; those of pca are stretch, xform, pws and ellipsoids.
    std::vector<ValueFinding> findings;

    std::uint64_t faultCount() const;
    bool passed() const { return faultCount() == 0; }
};

// Checks the values of every query (or a sample; clusters always of all). Integers, groups and the number of the nearest
// have to be those of the definition, numbers what rounding makes of the right one or of one within its bound
// (expected_values.h). A normal or an axis is compared where the sums determine its direction; all axes have to be a
// rotation, and where one component of either of the first two is the largest by far, it has to be positive. The report is
// the same for any number of threads.
// @param terms of the search, whose includeSelf and byDistance do not count; both translations are read, also of one set
// @throws InvalidInput for a measure that is not known and for values that are not there, InputError for values of another
//         type or number; and as verifyLists()
MeasureReport verifyMeasures(const SearchTerms& terms, const MeasureClaims& claims,
                             const VerifyOptions& options = {}, Progress* progress = nullptr);

} // namespace vdb_nns::cli
