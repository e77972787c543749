// The studies of radii and of the nearest as JSON, CSV and text. Texts are empty where nothing ran.
#pragma once

#include "bench/studies/set_study.h"

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace vdb_nns::cli {

nlohmann::ordered_json setResultsJson(const std::vector<SetResult>& results);
/// With a head.
std::string setResultsCsv(const std::vector<SetResult>& results);
std::string radiiText(const std::vector<SetResult>& results);
std::string nearestText(const std::vector<SetResult>& results);

} // namespace vdb_nns::cli
