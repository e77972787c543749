// The part of `verify` about attributes: what a result claims, and what was found, for people and as JSON.
#pragma once

#include "measure_options.h"
#include "progress_printer.h"
#include "query_options.h"
#include "verify/independent_search.h"
#include "verify/measure_check.h"
#include "verify/search_judge.h"

#include <nlohmann/json.hpp>

#include <string>

namespace vdb_nns::cli {

struct MeasureTask {
    std::string result; ///< path
    std::string grid;   ///< of the queries, where they are a .vdb: the result then has it, too
    const MeasureFlags& flags;
    const QueryInput& input;
    const SearchTerms& terms;
    const VerifyOptions& options;
};

/// Reads and checks the measures that the flags name, or those that the result has.
/// @throws InvalidInput where there are none, and for flags about others; InputError where its points are not the queries;
///         and as readMeasureInput() and verifyMeasures()
/// @param progress the part of the run from `begin` to `end` is this
MeasureReport checkResult(const MeasureTask& task, const ProgressSpan& progress);

nlohmann::ordered_json faultsJson(const MeasureReport& report);
std::string faultsText(const MeasureReport& report);

} // namespace vdb_nns::cli
