// Charts of a benchmark: runs chart.py, which needs Python with matplotlib.
#pragma once

#include "vdb_nns/output.h"

#include <string>

namespace vdb_nns::cli {

/// Empty where charts can be made; else a sentence that says what is missing and what to install.
std::string missingForCharts();

/// Makes the page from a report in JSON.
/// @throws OutputExists, OutputError, also where chart.py fails, which says why, or with missingForCharts()
void writeChart(const std::string& path, const std::string& json, const OutputOptions& options);

} // namespace vdb_nns::cli
