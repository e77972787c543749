// When a benchmark fails: what the exit status says once the figures are out.
#pragma once

#include "bench/report/bench_report.h"

namespace vdb_nns::cli {

/// @throws CheckFailed where what promises to be exact is not; else, where all methods of a study refused, what the first of them
///         threw
void requireRight(const BenchReport& report);

} // namespace vdb_nns::cli
