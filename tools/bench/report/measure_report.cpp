#include "bench/report/measure_report.h"

#include "bench/report/bench_report.h"
#include "report.h"

#include <optional>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

unsigned long long wide(std::uint64_t value)
{
    return value;
}

Json numberOrNull(bool isThere, double value)
{
    return isThere ? Json(value) : Json(nullptr);
}

Json errorJson(const ErrorSummary& error)
{
    const bool isThere = error.compared > 0;
    return {{"compared", error.compared},
            {"rms", numberOrNull(isThere, error.rms)},
            {"p99", numberOrNull(isThere, error.p99)},
            {"max", numberOrNull(isThere, error.max)}};
}

Json accuracyJson(const MeasureResult& r)
{
    Json json = {{"complete", r.isComplete}, {"checked_queries", r.checkedQueries}};
    json["unit"] = r.measure == "normal" ? "degrees" : "relative";
    json.update(errorJson(r.errors.value));
    json["one_sided"] = r.errors.oneSided;
    json["wrong"] = r.isOurs ? Json(r.errors.wrong) : Json(nullptr);
    json["axis"] = r.errors.axis ? errorJson(*r.errors.axis) : Json(nullptr);
    return json;
}

Json resultJson(const MeasureResult& r)
{
    const bool isDone = r.message.empty();
    Json json = {{"scene", r.scene},  {"measure", r.measure}, {"method", r.method},
                 {"exact", r.isOurs}, {"points", r.points},   {"runs", r.runs}};
    json["seconds"] = {{"grid", numberOrNull(isDone, r.gridSeconds)},
                       {"pass", numberOrNull(isDone, r.passSeconds)},
                       {"total", numberOrNull(isDone, r.totalSeconds)},
                       {"min", numberOrNull(isDone, r.minSeconds)},
                       {"max", numberOrNull(isDone, r.maxSeconds)},
                       {"counting", numberOrNull(isDone && r.countingSeconds > 0, r.countingSeconds)}};
    json["ratio"] = numberOrNull(isDone && r.ratio > 0, r.ratio);
    json["accuracy"] = isDone ? accuracyJson(r) : Json(nullptr);
    json["message"] = r.message;
    return json;
}

std::string errorText(const ErrorSummary& error)
{
    if (error.compared == 0) return format(" %9s %9s %9s", "-", "-", "-");
    return format(" %9.2g %9.2g %9.2g", error.rms, error.p99, error.max);
}

std::string rowText(const MeasureResult& r)
{
    std::string text = format("%-10s ", r.method.c_str());
    if (!r.message.empty()) return text + "refused: " + r.message + "\n";
    text += format("%9.4f %9.4f %9.4f %7.2f", r.gridSeconds, r.passSeconds, r.totalSeconds, r.ratio);
    text += errorText(r.errors.value);
    text += r.checkedQueries > 0 ? format(" %9llu", wide(r.errors.oneSided)) : format(" %9s", "-");
    return text + (r.errors.axis ? errorText(*r.errors.axis) : "") + "\n";
}

std::string headText(const std::string& measure)
{
    const std::string text =
        "\n" + measure +
        (measure == "density"  ? ": relative error"
         : measure == "normal" ? ": error in degrees"
                               : ": relative error of the stretch; longest axis, error in degrees") +
        "\n" +
        format("%-10s %9s %9s %9s %7s %9s %9s %9s %9s", "method", "grid s", "pass s", "total s", "x count",
               "rms", "99 %", "max", "one-sided");
    return text + (measure == "pca" ? format(" %9s %9s %9s", "axis rms", "99 %", "max") : "") + "\n";
}

std::string csvError(const std::optional<ErrorSummary>& error)
{
    if (!error || error->compared == 0) return format(",%llu,,,", wide(error ? error->compared : 0));
    return format(",%llu,%.6g,%.6g,%.6g", wide(error->compared), error->rms, error->p99, error->max);
}

} // namespace

Json measureResultsJson(const std::vector<MeasureResult>& results)
{
    Json array = Json::array();
    for (const MeasureResult& result : results) array.push_back(resultJson(result));
    return array;
}

std::string measureResultsCsv(const std::vector<MeasureResult>& results)
{
    std::string text = "scene,measure,method,exact,points,runs,grid_seconds,pass_seconds,total_seconds,min_"
                       "seconds,max_seconds,"
                       "counting_seconds,ratio,complete,checked_queries,compared,rms,p99,max,one_sided,"
                       "axis_compared,axis_rms,"
                       "axis_p99,axis_max\n";
    for (const MeasureResult& r : results) {
        if (!r.message.empty()) continue;
        text += csvField(r.scene) + "," + r.measure + "," + r.method;
        text += format(",%d,%llu,%llu", r.isOurs, wide(r.points), wide(r.runs));
        text += format(",%.6f,%.6f,%.6f,%.6f,%.6f,%.6f,%.4f", r.gridSeconds, r.passSeconds, r.totalSeconds,
                       r.minSeconds, r.maxSeconds, r.countingSeconds, r.ratio);
        text += format(",%d,%llu", r.isComplete, wide(r.checkedQueries)) + csvError(r.errors.value);
        text += format(",%llu", wide(r.errors.oneSided)) + csvError(r.errors.axis) + "\n";
    }
    return text;
}

std::string measuresText(const std::vector<MeasureResult>& results)
{
    if (results.empty()) return "";
    const MeasureResult& first = results.front();
    std::string text = format("\nmeasures of %llu particles; x count: the pass over that of counting alone\n",
                              wide(first.points));
    if (first.checkedQueries > 0)
        text += format("errors of %s %llu queries; one-sided: values that only one of method and truth has\n",
                       first.isComplete ? "all" : "a sample of", wide(first.checkedQueries));
    std::string last;
    for (const MeasureResult& r : results) {
        if (r.measure != last) text += headText(r.measure);
        last = r.measure;
        text += rowText(r);
    }
    return text;
}

} // namespace vdb_nns::cli
