// What a benchmark says of devices, as parts of its JSON, CSV and text.
#pragma once

#include "bench/report/bench_report.h"

#include <nlohmann/json.hpp>

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Gives every method of CPU and devices its lower bound, where ours and blocks, which have one each, were measured with the
/// same encoding.
void setLowerBounds(std::vector<BenchResult>& results);

nlohmann::ordered_json deviceMeasuresJson(const std::optional<DeviceMeasures>& measures);
nlohmann::ordered_json linkJson(const std::optional<LinkRates>& link);

/// Columns, each with a comma before it: the numbers of the JSON under their names. Empty fields for a method of the CPU.
std::string deviceCsvHeader();
std::string deviceCsvFields(const std::optional<DeviceMeasures>& measures);

/// A table of the methods that ran on devices, and the link; nothing without them.
std::string devicesText(const std::vector<BenchResult>& results, const std::optional<LinkRates>& link);

} // namespace vdb_nns::cli
