// What a benchmark found, as JSON, CSV and lines for people.
#pragma once

#include "bench/methods/link.h"
#include "bench/stability/matrix.h"
#include "bench/studies/budget_study.h"
#include "bench/studies/estimators.h"
#include "bench/studies/file_study.h"
#include "bench/studies/measure_study.h"
#include "bench/studies/method_study.h"
#include "bench/studies/model_study.h"
#include "bench/studies/resolution_study.h"
#include "bench/studies/scaling_study.h"
#include "bench/studies/set_study.h"

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Of every study that ran; the others are empty.
struct BenchReport {
    int threads = 0;
    std::optional<LinkRates> link;
    std::vector<BenchResult> results;
    std::vector<EstimatorResult> estimators;
    std::vector<BudgetResult> budgets;
    std::vector<ResolutionResult> resolution;
    std::vector<ScalingResult> scaling;
    ModelStudy model;
    std::vector<FileResult> files;
    std::vector<SetResult> radii, nearest;
    std::vector<MeasureResult> measures;
    std::vector<StabilityTrial> stability;
};

std::string benchJson(const BenchReport& report);
/// The results of methods alone.
std::string benchCsv(const std::vector<BenchResult>& results);
std::string benchText(const BenchReport& report);

/// A name that may hold a comma or a quote, for a CSV.
std::string csvField(const std::string& text);

} // namespace vdb_nns::cli
