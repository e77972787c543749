// The studies around the methods, as parts of the benchmark's JSON and text. Texts are empty where nothing ran.
#pragma once

#include "bench/report/bench_report.h"

#include <nlohmann/json.hpp>

#include <string>
#include <vector>

namespace vdb_nns::cli {

nlohmann::ordered_json estimatorsJson(const std::vector<EstimatorResult>& estimators);
nlohmann::ordered_json budgetsJson(const std::vector<BudgetResult>& budgets);
nlohmann::ordered_json resolutionJson(const std::vector<ResolutionResult>& resolution);
nlohmann::ordered_json scalingJson(const std::vector<ScalingResult>& scaling);
nlohmann::ordered_json modelSharesJson(const std::vector<ModelShare>& shares);
nlohmann::ordered_json savingsJson(const std::vector<Saving>& savings);
nlohmann::ordered_json filesJson(const std::vector<FileResult>& files);

std::string estimatorsText(const std::vector<EstimatorResult>& estimators);
std::string budgetsText(const std::vector<BudgetResult>& budgets);
std::string resolutionText(const std::vector<ResolutionResult>& resolution);
std::string scalingText(const std::vector<ScalingResult>& scaling);
std::string modelText(const ModelStudy& model);
std::string filesText(const std::vector<FileResult>& files);

} // namespace vdb_nns::cli
