#include "bench/bench_verdict.h"

#include "exit_codes.h"

#include <algorithm>
#include <cstdint>
#include <exception>
#include <string>
#include <vector>

namespace vdb_nns::cli {
namespace {

void requireExact(const std::vector<BenchResult>& results)
{
    for (const BenchResult& result : results) {
        if (result.isPromisedExact() && !result.isExact()) {
            throw CheckFailed(
                result.method + " is wrong: " + std::to_string(result.accuracy.missing) + " missing, " +
                std::to_string(result.accuracy.extra + result.accuracy.duplicates) + " extra, " +
                std::to_string(result.accuracy.asymmetric.value_or(0)) + " asymmetric pairs in " +
                std::to_string(result.accuracy.checkedQueries) + " queries; please report it");
        }
    }
    if (const BenchResult* const other = firstThatDiffers(results)) {
        throw CheckFailed(other->method +
                          " and another exact method do not find the same pairs; please report it");
    }
}

// Where all methods refused, the first says why.
void requireOne(const std::vector<BenchResult>& results)
{
    for (const BenchResult& result : results) {
        if (!result.refusal) return;
    }
    if (!results.empty()) std::rethrow_exception(results.front().refusal);
}

void requireExactSets(const std::vector<SetResult>& results)
{
    for (const SetResult& result : results) {
        if (!result.isOurs || result.wrong.wrong() == 0) continue;
        throw CheckFailed("ours is wrong with " + result.radii + " radii, " + result.mode +
                          (result.nearest > 0 ? ", nearest " + std::to_string(result.nearest) : "") + ": " +
                          std::to_string(result.wrong.missing) + " missing, " +
                          std::to_string(result.wrong.extra + result.wrong.duplicates) + " extra pairs in " +
                          std::to_string(result.wrong.checkedQueries) + " queries; please report it");
    }
}

// As requireOne(), of the results of a study.
template <typename Result>
void requireOneOf(const std::vector<Result>& results)
{
    const auto isDone = [](const Result& result) { return !result.refusal; };
    if (results.empty() || std::any_of(results.begin(), results.end(), isDone)) return;
    std::rethrow_exception(results.front().refusal);
}

// Values of ours that rounding does not explain, or that are there where there should be none.
void requireRightMeasures(const std::vector<MeasureResult>& results)
{
    for (const MeasureResult& result : results) {
        const std::uint64_t wrong = result.errors.wrong + result.errors.oneSided;
        if (!result.isOurs || wrong == 0) continue;
        throw CheckFailed("ours is wrong in " + result.measure + ": " + std::to_string(wrong) +
                          " values of " + std::to_string(result.checkedQueries) +
                          " queries; please report it");
    }
}

void requireStable(const std::vector<StabilityTrial>& trials)
{
    for (const StabilityTrial& trial : trials) {
        if (!oursHolds(trial)) {
            throw CheckFailed(trial.method + " fails the case " + trial.caseName + ": " + trial.message +
                              "; please report it");
        }
    }
}

} // namespace

void requireRight(const BenchReport& report)
{
    requireExact(report.results);
    for (const ScalingResult& scaling : report.scaling) requireExact({scaling.result});
    requireExactSets(report.radii);
    requireExactSets(report.nearest);
    requireRightMeasures(report.measures);
    requireStable(report.stability);
    requireOne(report.results);
    requireOneOf(report.radii);
    requireOneOf(report.nearest);
    requireOneOf(report.measures);
}

} // namespace vdb_nns::cli
