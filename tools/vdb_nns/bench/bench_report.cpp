#include "bench/bench_report.h"

#include "bench/device_report.h"
#include "machine.h"
#include "report.h"
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

Json machineJson(const std::vector<BenchResult>& results)
{
    Json json;
    json["version"] = VDB_NNS_VERSION;
    json["hash"] = buildFact("commit ");
    json["compiler"] = buildFact("compiler: ");
    json["cpu"] = cpuName();
    json["threads"] = results.empty() ? 0 : results.front().threads;
    json["cores"] = tbb::info::default_concurrency();
    json["memory_bytes"] = machineMemoryBytes();
    return json;
}

Json resultJson(const BenchResult& result)
{
    Json json;
    json["scene"] = result.scene;
    json["method"] = result.method;
    json["threads"] = result.threads;
    json["points"] = result.points;
    json["pairs"] = result.pairs;
    json["radius"] = result.radius;
    json["runs"] = result.runs;
    json["seconds"] = {{"grid", result.gridSeconds},   {"search", result.searchSeconds},
                       {"total", result.totalSeconds}, {"min", result.minSeconds},
                       {"max", result.maxSeconds},     {"first", result.firstSeconds}};
    json["memory"] = {{"peak_rss_bytes", result.peakBytes},
                      {"structure_bytes", result.structureBytes},
                      {"list_bytes", result.listBytes}};
    const AccuracyReport& accuracy = result.accuracy;
    json["accuracy"] = {{"checked_queries", accuracy.checkedQueries},
                        {"missing", accuracy.missing},
                        {"extra", accuracy.extra},
                        {"asymmetric", accuracy.asymmetric ? Json(*accuracy.asymmetric) : Json(nullptr)},
                        {"max_ulp", accuracy.maxUlp}};
    json["checksum"] = result.checksum ? Json(checksumText(*result.checksum)) : Json(nullptr);
    json["device"] = deviceMeasuresJson(result.device);
    return json;
}

Json estimatorJson(const EstimatorResult& e)
{
    Json json = {{"scene", e.scene},
                 {"estimator", e.estimator},
                 {"seconds", e.seconds},
                 {"count_seconds", e.searchSeconds},
                 {"blocks", e.blocks},
                 {"counted_queries", e.countedQueries},
                 {"bias", e.bias},
                 {"rmse", e.rmse},
                 {"p50", e.p50},
                 {"p99", e.p99},
                 {"max", e.most},
                 {"overflow_rate", e.overflowRate},
                 {"reserved_over_used", e.reservedOverUsed}};
    const ParticleErrors particles = e.particles.value_or(ParticleErrors{});
    json["particle_bias"] = e.particles ? Json(particles.bias) : Json(nullptr);
    json["particle_rmse"] = e.particles ? Json(particles.rmse) : Json(nullptr);
    json["particle_correlation"] = particles.correlation ? Json(*particles.correlation) : Json(nullptr);
    return json;
}

// A name may hold a comma or a quote.
std::string csvField(const std::string& text)
{
    std::string quoted = "\"";
    for (const char c : text) {
        if (c == '"') quoted += '"';
        quoted += c;
    }
    return quoted + "\"";
}

unsigned long long wide(std::uint64_t value)
{
    return value;
}

std::string particlesText(const std::vector<EstimatorResult>& estimators)
{
    std::string text;
    for (const EstimatorResult& e : estimators) {
        if (!e.particles) continue;
        if (text.empty()) {
            text = "\nexpected against true neighbors of each particle\n" +
                   format("%-12s %8s %8s %12s\n", "estimator", "bias", "rmse", "correlation");
        }
        text += format("%-12s %+8.2f %8.2f", e.estimator.c_str(), e.particles->bias, e.particles->rmse);
        const std::optional<double>& correlation = e.particles->correlation;
        text += correlation ? format(" %12.4f\n", *correlation) : format(" %12s\n", "-");
    }
    return text;
}

} // namespace

const BenchResult* firstThatDiffers(const std::vector<BenchResult>& results)
{
    std::optional<std::uint64_t> checksum;
    for (const BenchResult& result : results) {
        if (result.pairs != results.front().pairs) return &result;
        if (!result.checksum) continue;
        if (checksum && *checksum != *result.checksum) return &result;
        checksum = result.checksum;
    }
    return nullptr;
}

std::string benchJson(const std::vector<BenchResult>& results, const std::optional<LinkRates>& link,
                      const std::vector<EstimatorResult>& estimators)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "bench";
    json["machine"] = machineJson(results);
    json["link"] = linkJson(link);
    json["all_agree"] = firstThatDiffers(results) == nullptr;
    json["results"] = Json::array();
    for (const BenchResult& result : results) json["results"].push_back(resultJson(result));
    json["estimators"] = Json::array();
    for (const EstimatorResult& e : estimators) json["estimators"].push_back(estimatorJson(e));
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string benchCsv(const std::vector<BenchResult>& results)
{
    std::string text =
        "scene,method,threads,points,pairs,radius,runs,grid_seconds,search_seconds,total_seconds,"
        "min_seconds,max_seconds,first_seconds,peak_rss_bytes,structure_bytes,list_bytes,"
        "checked_queries,missing,extra,asymmetric,max_ulp,checksum";
    text += deviceCsvHeader() + "\n";
    for (const BenchResult& r : results) {
        text += csvField(r.scene) + "," + r.method;
        text += format(",%d,%llu,%llu,%.17g,%llu", r.threads, wide(r.points), wide(r.pairs), r.radius,
                       wide(r.runs));
        text += format(",%.6f,%.6f,%.6f,%.6f,%.6f,%.6f", r.gridSeconds, r.searchSeconds, r.totalSeconds,
                       r.minSeconds, r.maxSeconds, r.firstSeconds);
        text += format(",%llu,%llu,%llu", wide(r.peakBytes), wide(r.structureBytes), wide(r.listBytes));
        text += format(",%llu,%llu,%llu,", wide(r.accuracy.checkedQueries), wide(r.accuracy.missing),
                       wide(r.accuracy.extra));
        if (r.accuracy.asymmetric) text += std::to_string(*r.accuracy.asymmetric);
        text += format(",%g,", r.accuracy.maxUlp) + (r.checksum ? checksumText(*r.checksum) : "");
        text += deviceCsvFields(r.device) + "\n";
    }
    return text;
}

std::string benchText(const std::vector<BenchResult>& results)
{
    std::string text;
    if (!results.empty()) {
        const BenchResult& first = results.front();
        text +=
            format("scene %s, %llu particles, radius %.9g, %d threads, medians of %llu runs\n",
                   first.scene.c_str(), wide(first.points), first.radius, first.threads, wide(first.runs));
        text += "vdb_nns " VDB_NNS_VERSION ", commit " + buildFact("commit ") + ", " +
                buildFact("compiler: ") + ", " + cpuName() + "\n";
    }
    text += format("%-15s %13s %9s %9s %9s %9s %9s %7s %9s %9s %-13s %s\n", "method", "pairs", "grid s",
                   "search s", "total s", "min s", "max s", "ns/part", "grid MB", "lists MB", "wrong/checked",
                   "checksum");
    for (const BenchResult& r : results) {
        const double nanoseconds = r.points > 0 ? 1e9 * r.totalSeconds / static_cast<double>(r.points) : 0;
        text +=
            format("%-15s %13llu %9.4f %9.4f %9.4f %9.4f %9.4f %7.1f", r.method.c_str(), wide(r.pairs),
                   r.gridSeconds, r.searchSeconds, r.totalSeconds, r.minSeconds, r.maxSeconds, nanoseconds);
        const std::string checked =
            countText(r.accuracy.missing + r.accuracy.extra + r.accuracy.asymmetric.value_or(0)) + "/" +
            countText(r.accuracy.checkedQueries);
        text += format(" %9.1f %9.1f %-13s %s\n", static_cast<double>(r.structureBytes) / 1e6,
                       static_cast<double>(r.listBytes) / 1e6, checked.c_str(),
                       r.checksum ? checksumText(*r.checksum).c_str() : "-");
    }
    if (results.size() > 1) {
        text += firstThatDiffers(results) ? "the methods do NOT find the same pairs\n"
                                          : "all methods find the same pairs\n";
    }
    return text;
}

std::string estimatorsText(const std::vector<EstimatorResult>& estimators)
{
    if (estimators.empty()) return "";
    std::string text =
        format("\nestimators on blocks of 64^3 cells (%llu of them); a count of everything takes %.4f s\n",
               wide(estimators.front().blocks), estimators.front().searchSeconds);
    text += format("%-12s %9s %8s %8s %8s %8s %8s %9s %13s %9s\n", "estimator", "seconds", "bias %", "rmse %",
                   "p50 %", "p99 %", "max %", "overflow%", "reserved/used", "counted");
    for (const EstimatorResult& e : estimators) {
        text += format("%-12s %9.4f %+8.2f %8.2f %8.2f %8.2f %8.1f %9.1f %13.3f %9llu\n", e.estimator.c_str(),
                       e.seconds, 100 * e.bias, 100 * e.rmse, 100 * e.p50, 100 * e.p99, 100 * e.most,
                       100 * e.overflowRate, e.reservedOverUsed, wide(e.countedQueries));
    }
    return text + particlesText(estimators);
}

} // namespace vdb_nns::cli
