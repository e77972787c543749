#include "bench/report/set_report.h"

#include "bench/report/bench_report.h"
#include "report.h"

#include <algorithm>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

unsigned long long wide(std::uint64_t value)
{
    return value;
}

double wrongPerMillion(const SetResult& r)
{
    const double wrong = static_cast<double>(r.wrong.wrong());
    return r.truePairs > 0 ? 1e6 * wrong / static_cast<double>(r.truePairs) : wrong > 0 ? 1e6 : 0;
}

Json numberOrNull(bool isThere, double value)
{
    return isThere ? Json(value) : Json(nullptr);
}

Json resultJson(const SetResult& r)
{
    const bool isDone = r.message.empty(), isChecked = isDone && r.wrong.checkedQueries > 0;
    Json json = {
        {"scene", r.scene},     {"radii", r.radii},  {"mode", r.mode.empty() ? Json(nullptr) : Json(r.mode)},
        {"method", r.method},   {"exact", r.isOurs}, {"points", r.points},
        {"queries", r.queries}, {"runs", r.runs}};
    json["nearest"] = r.nearest > 0 ? Json(r.nearest) : Json(nullptr);
    json["pairs"] = isDone ? Json(r.pairs) : Json(nullptr);
    json["seconds"] = {{"grid", numberOrNull(isDone, r.gridSeconds)},
                       {"search", numberOrNull(isDone, r.searchSeconds)},
                       {"total", numberOrNull(isDone, r.totalSeconds)},
                       {"min", numberOrNull(isDone, r.minSeconds)},
                       {"max", numberOrNull(isDone, r.maxSeconds)}};
    json["ratio"] = numberOrNull(isDone && r.ratio > 0, r.ratio);
    json["accuracy"] = {{"complete", r.isComplete},
                        {"checked_queries", r.wrong.checkedQueries},
                        {"true_pairs", r.truePairs},
                        {"missing", r.wrong.missing},
                        {"extra", r.wrong.extra},
                        {"duplicates", r.wrong.duplicates},
                        {"wrong_per_million", numberOrNull(isChecked, wrongPerMillion(r))}};
    json["message"] = r.message;
    return json;
}

std::string rowText(const SetResult& r)
{
    std::string text = format("%-17s ", r.method.c_str());
    if (!r.message.empty()) return text + "refused: " + r.message + "\n";
    text += format("%10llu %13llu %9.4f %9.4f %9.4f %7.2f", wide(r.queries), wide(r.pairs), r.gridSeconds,
                   r.searchSeconds, r.totalSeconds, r.ratio);
    if (r.wrong.checkedQueries == 0) return text + format(" %12s %12s %11s\n", "-", "-", "-");
    return text + format(" %12llu %12llu %11.4g\n", wide(r.wrong.missing),
                         wide(r.wrong.extra + r.wrong.duplicates), wrongPerMillion(r));
}

std::string headText(const std::string& first)
{
    return format("%-17s %10s %13s %9s %9s %9s %7s %12s %12s %11s\n", first.c_str(), "queries", "pairs",
                  "grid s", "search s", "total s", "ratio", "missing", "extra", "wrong/M");
}

std::string footText(const std::vector<SetResult>& results)
{
    const auto isPart = [](const SetResult& r) { return r.queries < r.points; };
    const auto isSampled = [](const SetResult& r) { return !r.isComplete && r.wrong.checkedQueries > 0; };
    std::string text;
    if (std::any_of(results.begin(), results.end(), isPart))
        text +=
            "where fewer queries than particles were timed, the seconds of the search are scaled up to all\n";
    if (std::any_of(results.begin(), results.end(), isSampled))
        text += "missing and extra are those of a sample of the queries\n";
    return text;
}

} // namespace

Json setResultsJson(const std::vector<SetResult>& results)
{
    Json array = Json::array();
    for (const SetResult& result : results) array.push_back(resultJson(result));
    return array;
}

std::string setResultsCsv(const std::vector<SetResult>& results)
{
    std::string text =
        "scene,radii,mode,nearest,method,exact,points,queries,runs,pairs,grid_seconds,search_seconds,"
        "total_seconds,min_seconds,max_seconds,ratio,complete,checked_queries,true_pairs,missing,extra,"
        "duplicates\n";
    for (const SetResult& r : results) {
        if (!r.message.empty()) continue;
        text += csvField(r.scene) + "," + r.radii + "," + r.mode + "," +
                (r.nearest ? std::to_string(r.nearest) : "") + "," + r.method;
        text += format(",%d,%llu,%llu,%llu,%llu", r.isOurs, wide(r.points), wide(r.queries), wide(r.runs),
                       wide(r.pairs));
        text += format(",%.6f,%.6f,%.6f,%.6f,%.6f,%.4f", r.gridSeconds, r.searchSeconds, r.totalSeconds,
                       r.minSeconds, r.maxSeconds, r.ratio);
        text +=
            format(",%d,%llu,%llu,%llu,%llu,%llu\n", r.isComplete, wide(r.wrong.checkedQueries),
                   wide(r.truePairs), wide(r.wrong.missing), wide(r.wrong.extra), wide(r.wrong.duplicates));
    }
    return text;
}

std::string radiiText(const std::vector<SetResult>& results)
{
    std::string text, last;
    for (const SetResult& r : results) {
        const std::string part = r.radii + ", " + r.mode;
        if (part != last) {
            text += format("\nradii %s, %llu particles\n", part.c_str(), wide(r.points)) + headText("method");
        }
        last = part;
        text += rowText(r);
    }
    return text + footText(results);
}

std::string nearestText(const std::vector<SetResult>& results)
{
    std::string text;
    std::uint32_t last = 0;
    for (const SetResult& r : results) {
        if (r.nearest != last) {
            text += format("\nnearest %u within the radius, %llu particles\n", r.nearest, wide(r.points)) +
                    headText("method");
        }
        last = r.nearest;
        text += rowText(r);
    }
    return text + footText(results);
}

} // namespace vdb_nns::cli
