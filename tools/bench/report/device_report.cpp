#include "bench/report/device_report.h"

#include "report.h"

#include <algorithm>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

Json orNull(const std::optional<double>& value)
{
    return value ? Json(*value) : Json(nullptr);
}

// The numbers of a method on devices, under the names that JSON and CSV share.
Json numbersOf(const DeviceMeasures& m)
{
    return {{"in_core", m.inCore},
            {"boundary", boundaryModeName(m.boundary)},
            {"virtual", m.isVirtual},
            {"budget_bytes", m.budgetBytes},
            {"peak_bytes", m.peakBytes},
            {"blocks", m.blocks},
            {"device_particles", m.particles},
            {"cpu_particles", m.cpuParticles},
            {"overflows", m.overflows},
            {"retries", m.retries},
            {"splits", m.splits},
            {"halvings", m.halvings},
            {"estimate_seconds", m.estimateSeconds},
            {"plan_seconds", m.planSeconds},
            {"upload_seconds", m.uploadSeconds},
            {"search_seconds", m.searchSeconds},
            {"download_seconds", m.downloadSeconds},
            {"collect_seconds", m.collectSeconds},
            {"makespan_seconds", m.makespanSeconds},
            {"bytes_up", m.bytesUp},
            {"bytes_down", m.bytesDown},
            {"candidate_tests", m.candidateTests},
            {"up_gbs", orNull(m.upGbs())},
            {"down_gbs", orNull(m.downGbs())},
            {"kernel_gbs", orNull(m.kernelGbs())},
            {"neighbors_per_second", orNull(m.neighborsPerSecond())},
            {"tests_per_second", orNull(m.testsPerSecond())},
            {"model_tests_per_second", m.modelTestsPerSecond},
            {"particles_per_gib", orNull(m.particlesPerGib())},
            {"lower_bound_seconds", orNull(m.lowerBound)},
            {"over_lower_bound", orNull(m.overLowerBound())}};
}

const BenchResult* find(const std::vector<BenchResult>& results, const std::string& method)
{
    const auto found = std::find_if(results.begin(), results.end(),
                                    [&](const BenchResult& result) { return result.method == method; });
    return found == results.end() ? nullptr : &*found;
}

std::string cell(const std::optional<double>& value, double unit, const char* pattern = " %8.2f")
{
    return value ? format(pattern, *value / unit) : format(" %8s", "-");
}

// A figure that is 0 where nothing measures it.
std::optional<double> measured(double value)
{
    if (!(value > 0)) return std::nullopt;
    return value;
}

std::string deviceLine(const BenchResult& result)
{
    constexpr double kMebi = 1024.0 * 1024.0;
    const DeviceMeasures& m = *result.device;
    const double all = static_cast<double>(m.particles + m.cpuParticles);
    const std::string redone =
        countText(m.overflows) + "/" + countText(m.retries) + "/" + countText(m.splits);
    std::string text =
        format("%-15s %9.1f %9.1f %7s %7s %-8s %9s %7.1f", result.method.c_str(),
               static_cast<double>(m.budgetBytes) / kMebi, static_cast<double>(m.peakBytes) / kMebi,
               countText(m.blocks).c_str(), m.inCore ? "yes" : "no", boundaryModeName(m.boundary),
               redone.c_str(), all > 0 ? 100 * static_cast<double>(m.cpuParticles) / all : 0);
    text += format(" %8.4f", m.estimateSeconds + m.planSeconds);
    text += cell(measured(m.uploadSeconds), 1, " %8.4f") + cell(measured(m.searchSeconds), 1, " %8.4f") +
            cell(measured(m.downloadSeconds), 1, " %8.4f") + cell(measured(m.makespanSeconds), 1, " %8.4f");
    text += cell(m.upGbs(), 1) + cell(m.downGbs(), 1) + cell(m.kernelGbs(), 1);
    text += cell(m.neighborsPerSecond(), 1e9) + cell(m.testsPerSecond(), 1e9);
    return text + cell(m.particlesPerGib(), 1e6) + cell(m.overLowerBound(), 1) + "\n";
}

} // namespace

void setLowerBounds(std::vector<BenchResult>& results)
{
    for (BenchResult& result : results) {
        if (!result.device || result.method.compare(0, 5, "both-") != 0) continue;
        const std::string encoding = result.method.substr(result.method.rfind('-'));
        const BenchResult *const cpu = find(results, "ours" + encoding), *const device = find(
                                                                             results, "blocks" + encoding);
        if (!cpu || !device) continue;
        const double cpuSeconds =
            result.device->isVirtual ? result.device->modelCpuSeconds : cpu->searchSeconds;
        const double deviceSeconds = device->device->makespanSeconds;
        if (cpuSeconds > 0 && deviceSeconds > 0)
            result.device->lowerBound = togetherSeconds(cpuSeconds, deviceSeconds);
    }
}

Json deviceMeasuresJson(const std::optional<DeviceMeasures>& measures)
{
    if (!measures) return nullptr;
    Json json = {{"kind", measures->kind}, {"name", measures->name}};
    json.update(numbersOf(*measures));
    return json;
}

Json linkJson(const std::optional<LinkRates>& link)
{
    if (!link) return nullptr;
    return {{"device", link->name},           {"bytes", link->bytes},
            {"up_gbs", link->upGbs},          {"down_gbs", link->downGbs},
            {"both_up_gbs", link->bothUpGbs}, {"both_down_gbs", link->bothDownGbs}};
}

std::string deviceCsvHeader()
{
    std::string text;
    const Json numbers = numbersOf({});
    for (const auto& item : numbers.items()) text += ",device_" + item.key();
    return text;
}

std::string deviceCsvFields(const std::optional<DeviceMeasures>& measures)
{
    std::string text;
    const Json numbers = numbersOf(measures.value_or(DeviceMeasures{}));
    for (const Json& value : numbers) {
        text += ",";
        if (!measures || value.is_null()) continue;
        text += value.is_string() ? value.get<std::string>() : value.dump();
    }
    return text;
}

std::string devicesText(const std::vector<BenchResult>& results, const std::optional<LinkRates>& link)
{
    std::string text;
    for (const BenchResult& result : results) {
        if (!result.device) continue;
        if (text.empty()) {
            text = "\non " + result.device->name + (result.device->isVirtual ? ", in virtual time\n" : "\n") +
                   format("%-15s %9s %9s %7s %7s %-8s %9s %7s %8s %8s %8s %8s %8s", "method", "limit MiB",
                          "peak MiB", "blocks", "in core", "boundary", "redone", "CPU %", "plan s", "up s",
                          "kernel s", "down s", "span s") +
                   format(" %8s %8s %8s %8s %8s %8s %8s\n", "up GB/s", "dn GB/s", "kn GB/s", "G neigh",
                          "G tests", "M/GiB", "span/low");
        }
        text += deviceLine(result);
    }
    if (!text.empty()) {
        text += "redone: overflows/retries/splits; seconds of up, kernel and down are summed over blocks and "
                "overlap; G neigh, "
                "G tests: 10^9 a second of the kernels; kn GB/s: bytes both ways over the kernels' time; "
                "span/low: over "
                "what CPU and device need at least together\n";
    }
    if (link) {
        text += format("link: up %.2f GB/s, down %.2f GB/s; both at once: up %.2f, down %.2f\n", link->upGbs,
                       link->downGbs, link->bothUpGbs, link->bothDownGbs);
    }
    return text;
}

} // namespace vdb_nns::cli
