#include "bench/report/bench_report.h"

#include "bench/report/device_report.h"
#include "bench/report/measure_report.h"
#include "bench/report/set_report.h"
#include "bench/report/study_report.h"
#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/version.h"

#include <nlohmann/json.hpp>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

// What follows `key` on its line of buildInfo(), up to a comma or the end.
std::string buildFact(const std::string& key)
{
    const std::string info = buildInfo();
    const std::size_t at = info.find(key);
    if (at == std::string::npos) return "unknown";
    const std::size_t begin = at + key.size();
    return info.substr(begin, info.find_first_of(",\n", begin) - begin);
}

Json machineJson(const BenchReport& report)
{
    Json json;
    json["version"] = VDB_NNS_VERSION;
    json["hash"] = buildFact("commit ");
    json["compiler"] = buildFact("compiler: ");
    json["cpu"] = cpuName();
    json["threads"] = report.threads;
    json["cores"] = tbb::info::default_concurrency();
    json["memory_bytes"] = machineMemoryBytes();
    return json;
}

const char* kindName(MethodKind kind)
{
    switch (kind) {
    case MethodKind::kEngine:
        return "engine";
    case MethodKind::kDevice:
        return "device";
    case MethodKind::kAblation:
        return "part";
    case MethodKind::kApproximate:
        return "approximate";
    case MethodKind::kPeer:
        break;
    }
    return "peer";
}

template <typename T>
Json orNull(const std::optional<T>& value)
{
    return value ? Json(*value) : Json(nullptr);
}

Json accuracyJson(const AccuracyReport& accuracy)
{
    const bool isChecked = accuracy.checkedQueries > 0;
    return {{"complete", accuracy.complete},
            {"checked_queries", accuracy.checkedQueries},
            {"true_pairs", accuracy.truePairs},
            {"missing", accuracy.missing},
            {"extra", accuracy.extra},
            {"duplicates", accuracy.duplicates},
            {"missing_per_million", isChecked ? Json(accuracy.missingPerMillion()) : Json(nullptr)},
            {"extra_per_million", isChecked ? Json(accuracy.extraPerMillion()) : Json(nullptr)},
            {"asymmetric", orNull(accuracy.asymmetric)},
            {"max_ulp", accuracy.maxUlp},
            {"count_rmse", accuracy.countRmse},
            {"count_max", accuracy.countMax},
            {"density_rmse", orNull(accuracy.densityRmse)},
            {"density_max", orNull(accuracy.densityMax)}};
}

// In the order of design: numbers are null where the method refused.
Json refusedJson(Json json)
{
    for (const char* key : {"grid", "search", "total", "min", "max", "first"}) json["seconds"][key] = nullptr;
    for (const char* key : {"peak_rss_bytes", "added_bytes", "structure_bytes", "list_bytes"})
        json["memory"][key] = nullptr;
    json["pairs"] = json["accuracy"] = nullptr;
    return json;
}

Json resultJson(const BenchResult& result)
{
    Json json;
    json["scene"] = result.scene;
    json["method"] = result.method;
    json["kind"] = kindName(result.kind);
    json["threads"] = result.threads;
    json["points"] = result.points;
    json["pairs"] = result.pairs;
    json["radius"] = result.radius;
    json["runs"] = result.runs;
    json["turn"] = result.turn;
    json["seconds"] = {{"grid", result.gridSeconds},   {"search", result.searchSeconds},
                       {"total", result.totalSeconds}, {"min", result.minSeconds},
                       {"max", result.maxSeconds},     {"first", result.firstSeconds}};
    json["memory"] = {{"peak_rss_bytes", result.peakBytes},
                      {"added_bytes", result.addedBytes},
                      {"structure_bytes", result.structureBytes},
                      {"list_bytes", result.listBytes}};
    json["accuracy"] = accuracyJson(result.accuracy);
    json["checksum"] = result.checksum ? Json(checksumText(*result.checksum)) : Json(nullptr);
    json["device"] = deviceMeasuresJson(result.device);
    json["message"] = result.message;
    return result.message.empty() ? json : refusedJson(json);
}

unsigned long long wide(std::uint64_t value)
{
    return value;
}

double per(double sum, std::uint64_t count)
{
    return count > 0 ? sum / static_cast<double>(count) : 0;
}

std::string headText(const std::vector<BenchResult>& results)
{
    const BenchResult& first = results.front();
    std::string text = format("scene %s, %llu particles, radius %.9g, %d threads, medians of %llu runs\n",
                              printable(first.scene).c_str(), wide(first.points), first.radius, first.threads,
                              wide(first.runs));
    return text + "vdb_nns " VDB_NNS_VERSION ", commit " + buildFact("commit ") + ", " +
           buildFact("compiler: ") + ", " + cpuName() + "\n";
}

std::string timesText(const std::vector<BenchResult>& results)
{
    std::string text = format("\n%-17s %13s %9s %9s %9s %9s %9s %8s %7s %9s %10s %9s\n", "method", "pairs",
                              "grid s", "search s", "total s", "min s", "max s", "ns/part", "ns/nbr",
                              "grid B/p", "lists B/nbr", "added MB");
    for (const BenchResult& r : results) {
        text += format("%-17s %13llu %9.4f %9.4f %9.4f %9.4f %9.4f", r.method.c_str(), wide(r.pairs),
                       r.gridSeconds, r.searchSeconds, r.totalSeconds, r.minSeconds, r.maxSeconds);
        text +=
            format(" %8.1f %7.2f %9.1f %10.2f %9.1f\n", per(1e9 * r.totalSeconds, r.points),
                   per(1e9 * r.totalSeconds, r.pairs), per(static_cast<double>(r.structureBytes), r.points),
                   per(static_cast<double>(r.listBytes), r.pairs), static_cast<double>(r.addedBytes) / 1e6);
    }
    if (results.back().turn > 0) {
        text += "memory does not hold all methods at once: they ran in " +
                countText(results.back().turn + 1) + " turns, interleaved within each\n";
    }
    return text;
}

std::string optionalText(const std::optional<double>& value)
{
    return value ? format(" %10.2g", *value) : format(" %10s", "-");
}

std::string accuracyText(const std::vector<BenchResult>& results)
{
    const AccuracyReport& first = results.front().accuracy;
    if (first.checkedQueries == 0) return "\nnothing was compared with the truth: --sample 0\n";
    std::string text = first.complete ? format("\nagainst the truth of all %llu particles, %llu pairs\n",
                                               wide(first.checkedQueries), wide(first.truePairs))
                                      : format("\nagainst the truth of a sample: %llu queries, %llu pairs\n",
                                               wide(first.checkedQueries), wide(first.truePairs));
    text +=
        format("%-17s %10s %10s %10s %10s %10s %9s %10s %10s %10s  %s\n", "method", "missing", "extra",
               "twice", "wrong/M", "asymmetric", "max ulp", "count rms", "density", "dens. max", "checksum");
    for (const BenchResult& r : results) {
        const AccuracyReport& a = r.accuracy;
        text += format("%-17s %10llu %10llu %10llu %10.4g", r.method.c_str(), wide(a.missing), wide(a.extra),
                       wide(a.duplicates), a.missingPerMillion() + a.extraPerMillion());
        text += a.asymmetric ? format(" %10llu", wide(*a.asymmetric)) : format(" %10s", "-");
        text += format(" %9.3g %10.3g", a.maxUlp, a.countRmse) + optionalText(a.densityRmse) +
                optionalText(a.densityMax);
        text += "  " + (r.checksum ? checksumText(*r.checksum) : "-") + "\n";
    }
    return text;
}

std::string refusalsText(const std::vector<BenchResult>& results)
{
    std::string text;
    for (const BenchResult& result : results) {
        if (!result.message.empty()) text += result.method + " refused: " + result.message + "\n";
    }
    return text;
}

std::string agreementText(const std::vector<BenchResult>& results)
{
    std::uint64_t exact = 0;
    for (const BenchResult& result : results) exact += result.isPromisedExact() && result.message.empty();
    if (exact < 2) return "";
    return firstThatDiffers(results) ? "the exact methods do NOT find the same pairs\n"
                                     : "the " + countText(exact) + " exact methods find the same pairs\n";
}

} // namespace

std::string csvField(const std::string& text)
{
    std::string quoted = "\"";
    for (const char c : printable(text)) {
        if (c == '"') quoted += '"';
        quoted += c;
    }
    return quoted + "\"";
}

std::string benchJson(const BenchReport& report)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "bench";
    json["machine"] = machineJson(report);
    json["link"] = linkJson(report.link);
    json["all_agree"] = firstThatDiffers(report.results) == nullptr;
    json["results"] = Json::array();
    for (const BenchResult& result : report.results) json["results"].push_back(resultJson(result));
    json["estimators"] = estimatorsJson(report.estimators);
    json["budgets"] = budgetsJson(report.budgets);
    json["resolution"] = resolutionJson(report.resolution);
    json["scaling"] = scalingJson(report.scaling);
    json["model_share"] = modelSharesJson(report.model.shares);
    json["savings"] = savingsJson(report.model.savings);
    json["files"] = filesJson(report.files);
    json["radii"] = setResultsJson(report.radii);
    json["nearest"] = setResultsJson(report.nearest);
    json["measures"] = measureResultsJson(report.measures);
    json["stability"] = stabilityJson(report.stability);
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string benchCsv(const std::vector<BenchResult>& results)
{
    std::string text =
        "scene,method,kind,threads,points,pairs,radius,runs,grid_seconds,search_seconds,total_seconds,"
        "min_seconds,max_seconds,first_seconds,peak_rss_bytes,added_bytes,structure_bytes,list_bytes,"
        "complete,checked_queries,true_pairs,missing,extra,duplicates,asymmetric,max_ulp,count_rmse,count_"
        "max,"
        "density_rmse,density_max,checksum";
    text += deviceCsvHeader() + "\n";
    const auto optional = [](const std::optional<double>& value) {
        return value ? format("%.9g", *value) : "";
    };
    for (const BenchResult& r : results) {
        const AccuracyReport& a = r.accuracy;
        text += csvField(r.scene) + "," + r.method + "," + kindName(r.kind);
        text += format(",%d,%llu,%llu,%.17g,%llu", r.threads, wide(r.points), wide(r.pairs), r.radius,
                       wide(r.runs));
        text += format(",%.6f,%.6f,%.6f,%.6f,%.6f,%.6f", r.gridSeconds, r.searchSeconds, r.totalSeconds,
                       r.minSeconds, r.maxSeconds, r.firstSeconds);
        text += format(",%llu,%llu,%llu,%llu,%d", wide(r.peakBytes), wide(r.addedBytes),
                       wide(r.structureBytes), wide(r.listBytes), a.complete);
        text += format(",%llu,%llu,%llu,%llu,%llu,", wide(a.checkedQueries), wide(a.truePairs),
                       wide(a.missing), wide(a.extra), wide(a.duplicates));
        if (a.asymmetric) text += std::to_string(*a.asymmetric);
        text += format(",%g,%.9g,%.9g,", a.maxUlp, a.countRmse, a.countMax);
        text += optional(a.densityRmse) + "," + optional(a.densityMax) + ",";
        text += (r.checksum ? checksumText(*r.checksum) : "") + deviceCsvFields(r.device) + "\n";
    }
    return text;
}

std::string benchText(const BenchReport& report)
{
    std::string text;
    std::vector<BenchResult> results;
    for (const BenchResult& result : report.results) {
        if (result.message.empty()) results.push_back(result);
    }
    if (!results.empty()) {
        text = headText(results) + timesText(results) + accuracyText(results) + agreementText(results) +
               devicesText(results, report.link);
    }
    if (!results.empty()) text += refusalsText(report.results); // else the first one is the error
    return text + estimatorsText(report.estimators) + budgetsText(report.budgets) +
           resolutionText(report.resolution) + scalingText(report.scaling) + modelText(report.model) +
           filesText(report.files) + radiiText(report.radii) + nearestText(report.nearest) +
           measuresText(report.measures) + (report.stability.empty() ? "" : stabilityText(report.stability));
}

} // namespace vdb_nns::cli
