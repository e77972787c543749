// The study of measures as JSON, CSV and text. The text is empty where nothing ran.
#pragma once

#include "bench/studies/measure_study.h"

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace vdb_nns::cli {

nlohmann::ordered_json measureResultsJson(const std::vector<MeasureResult>& results);
/// With a head.
std::string measureResultsCsv(const std::vector<MeasureResult>& results);
std::string measuresText(const std::vector<MeasureResult>& results);

} // namespace vdb_nns::cli
