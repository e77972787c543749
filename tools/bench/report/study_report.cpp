#include "bench/report/study_report.h"

#include "report.h"

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

unsigned long long wide(std::uint64_t value)
{
    return value;
}

double ratio(double part, double whole)
{
    return whole > 0 ? part / whole : 0;
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
                 {"reserved_over_used", e.reservedOverUsed},
                 {"reserved_bytes", e.reservedBytes},
                 {"used_bytes", e.usedBytes}};
    const ParticleErrors particles = e.particles.value_or(ParticleErrors{});
    json["particle_bias"] = e.particles ? Json(particles.bias) : Json(nullptr);
    json["particle_rmse"] = e.particles ? Json(particles.rmse) : Json(nullptr);
    json["particle_correlation"] = particles.correlation ? Json(*particles.correlation) : Json(nullptr);
    return json;
}

std::string particlesText(const std::vector<EstimatorResult>& estimators)
{
    std::string text;
    for (const EstimatorResult& e : estimators) {
        if (!e.particles) continue;
        if (text.empty()) {
            text = "\nexpected against true neighbors of each particle\n" +
                   format("%-13s %8s %8s %12s\n", "estimator", "bias", "rmse", "correlation");
        }
        text += format("%-13s %+8.2f %8.2f", e.estimator.c_str(), e.particles->bias, e.particles->rmse);
        const std::optional<double>& correlation = e.particles->correlation;
        text += correlation ? format(" %12.4f\n", *correlation) : format(" %12s\n", "-");
    }
    return text;
}

std::string rowScene(const std::string& scene)
{
    return scene.size() > 16 ? scene.substr(0, 15) + "~" : scene;
}

} // namespace

Json estimatorsJson(const std::vector<EstimatorResult>& estimators)
{
    Json array = Json::array();
    for (const EstimatorResult& e : estimators) array.push_back(estimatorJson(e));
    return array;
}

Json budgetsJson(const std::vector<BudgetResult>& budgets)
{
    Json array = Json::array();
    for (const BudgetResult& b : budgets) {
        const bool isDone = b.message.empty();
        Json json = {{"scene", b.scene},         {"device", b.device},
                     {"model", b.isModel},       {"encoding", encodingName(b.encoding)},
                     {"share", b.share},         {"budget_bytes", b.budgetBytes},
                     {"points", b.points},       {"outcome", isDone ? "done" : "refused"},
                     {"message", b.message},     {"blocks", b.blocks},
                     {"overflows", b.overflows}, {"retries", b.retries},
                     {"splits", b.splits},       {"cpu_particles", b.cpuParticles}};
        json["seconds"] = isDone ? Json(b.seconds) : Json(nullptr);
        json["particles_per_second"] =
            isDone ? Json(ratio(static_cast<double>(b.points), b.seconds)) : Json(nullptr);
        array.push_back(json);
    }
    return array;
}

Json resolutionJson(const std::vector<ResolutionResult>& resolution)
{
    Json array = Json::array();
    for (const ResolutionResult& r : resolution) {
        array.push_back(
            {{"scene", r.scene},
             {"encoding", encodingName(r.encoding)},
             {"cell_size", r.cellSize},
             {"chosen", r.isAuto},
             {"reach", r.reach},
             {"particles_per_cell", ratio(static_cast<double>(r.particles), static_cast<double>(r.cells))},
             {"cells", r.cells},
             {"leaves", r.leaves},
             {"candidate_tests", r.candidateTests},
             {"structure_bytes", r.structureBytes},
             {"list_bytes", r.listBytes},
             {"seconds", {{"grid", r.gridSeconds}, {"search", r.searchSeconds}, {"total", r.totalSeconds}}}});
    }
    return array;
}

Json scalingJson(const std::vector<ScalingResult>& scaling)
{
    Json array = Json::array();
    for (const ScalingResult& s : scaling) {
        const BenchResult& r = s.result;
        const AccuracyReport& a = r.accuracy;
        array.push_back(
            {{"scene", r.scene},
             {"method", r.method},
             {"vary", s.vary},
             {"value", s.value},
             {"points", r.points},
             {"threads", r.threads},
             {"radius", r.radius},
             {"pairs", r.pairs},
             {"seconds",
              {{"grid", r.gridSeconds},
               {"search", r.searchSeconds},
               {"total", r.totalSeconds},
               {"min", r.minSeconds},
               {"max", r.maxSeconds}}},
             {"structure_bytes", r.structureBytes},
             {"wrong_per_million",
              a.checkedQueries ? Json(a.missingPerMillion() + a.extraPerMillion()) : Json(nullptr)},
             {"complete", a.complete}});
    }
    return array;
}

Json modelSharesJson(const std::vector<ModelShare>& shares)
{
    Json array = Json::array();
    for (const ModelShare& s : shares) {
        array.push_back({{"scene", s.scene},
                         {"encoding", encodingName(s.encoding)},
                         {"in_core", s.inCore},
                         {"points", s.points},
                         {"blocks", s.blocks},
                         {"seconds",
                          {{"grid", s.gridSeconds},
                           {"estimate", s.estimateSeconds},
                           {"tree", s.treeSeconds},
                           {"schedule", s.scheduleSeconds},
                           {"search", s.searchSeconds},
                           {"total", s.gridSeconds + s.modelSeconds() + s.searchSeconds}}},
                         {"bytes",
                          {{"structure", s.structureBytes},
                           {"estimate", s.estimateBytes},
                           {"tree", s.treeBytes},
                           {"schedule", s.scheduleBytes},
                           {"lists", s.listBytes}}}});
    }
    return array;
}

Json savingsJson(const std::vector<Saving>& savings)
{
    Json array = Json::array();
    for (const Saving& s : savings) {
        array.push_back({{"scene", s.scene},
                         {"part", s.part},
                         {"unit", s.unit},
                         {"with", s.with},
                         {"without", s.without}});
    }
    return array;
}

Json filesJson(const std::vector<FileResult>& files)
{
    Json array = Json::array();
    for (const FileResult& f : files) {
        Json seconds = {
            {"read", f.readSeconds},     {"grid", f.gridSeconds}, {"grid_of_array", f.arrayGridSeconds},
            {"search", f.searchSeconds}, {"copy", f.copySeconds}, {"whole", f.wholeSeconds}};
        seconds["openvdb_read"] = f.openVdbReadSeconds ? Json(*f.openVdbReadSeconds) : Json(nullptr);
        array.push_back({{"scene", f.scene},
                         {"points", f.points},
                         {"pairs", f.pairs},
                         {"input_bytes", f.inputBytes},
                         {"output_bytes", f.outputBytes},
                         {"seconds", seconds},
                         {"whole_over_floor", ratio(f.wholeSeconds, f.floorSeconds())}});
    }
    return array;
}

std::string estimatorsText(const std::vector<EstimatorResult>& estimators)
{
    if (estimators.empty()) return "";
    std::string text =
        format("\nestimators on blocks of 64^3 cells (%llu of them); a count of everything takes %.4f s\n",
               wide(estimators.front().blocks), estimators.front().searchSeconds);
    text += format("%-13s %9s %8s %8s %8s %8s %8s %9s %13s %9s\n", "estimator", "seconds", "bias %", "rmse %",
                   "p50 %", "p99 %", "max %", "overflow%", "reserved/used", "counted");
    for (const EstimatorResult& e : estimators) {
        text += format("%-13s %9.4f %+8.2f %8.2f %8.2f %8.2f %8.1f %9.1f %13.3f %9llu\n", e.estimator.c_str(),
                       e.seconds, 100 * e.bias, 100 * e.rmse, 100 * e.p50, 100 * e.p99, 100 * e.most,
                       100 * e.overflowRate, e.reservedOverUsed, wide(e.countedQueries));
    }
    return text + particlesText(estimators);
}

std::string budgetsText(const std::vector<BudgetResult>& budgets)
{
    if (budgets.empty()) return "";
    std::string text = format("\nmemory budgets of %s%s\n", budgets.front().device.c_str(),
                              budgets.front().isModel ? " (seconds are a model)" : "");
    text += format("%-8s %7s %11s %8s %9s %8s %8s %8s %12s\n", "lists", "share %", "budget MB", "blocks",
                   "overflows", "retries", "splits", "Mpart/s", "on the CPU");
    for (const BudgetResult& b : budgets) {
        text += format("%-8s %7.0f %11.1f", encodingName(b.encoding), 100 * b.share,
                       static_cast<double>(b.budgetBytes) / 1e6);
        if (!b.message.empty()) {
            text += " refused: " + b.message + "\n";
            continue;
        }
        text += format(" %8llu %9llu %8llu %8llu %8.2f %12llu\n", wide(b.blocks), wide(b.overflows),
                       wide(b.retries), wide(b.splits), ratio(static_cast<double>(b.points), 1e6 * b.seconds),
                       wide(b.cpuParticles));
    }
    return text;
}

std::string resolutionText(const std::vector<ResolutionResult>& resolution)
{
    if (resolution.empty()) return "";
    std::string text =
        format("\ncell sizes\n%-8s %12s %6s %10s %10s %9s %9s %9s %9s\n", "lists", "size/radius", "reach",
               "part/cell", "tests/part", "grid s", "total s", "grid B/p", "lists B/p");
    for (const ResolutionResult& r : resolution) {
        const auto particles = static_cast<double>(r.particles);
        text +=
            format("%-8s %7.3f %4s %6d %10.2f %10.1f %9.4f %9.4f", encodingName(r.encoding), r.cellSize,
                   r.isAuto ? "auto" : "", r.reach, ratio(particles, static_cast<double>(r.cells)),
                   ratio(static_cast<double>(r.candidateTests), particles), r.gridSeconds, r.totalSeconds);
        text += format(" %9.1f %9.1f\n", ratio(static_cast<double>(r.structureBytes), particles),
                       ratio(static_cast<double>(r.listBytes), particles));
    }
    return text;
}

std::string scalingText(const std::vector<ScalingResult>& scaling)
{
    if (scaling.empty()) return "";
    std::string text = format("\ngrowth\n%-11s %12s %-17s %12s %14s %9s %8s %8s %11s\n", "vary", "value",
                              "method", "particles", "pairs", "total s", "ns/part", "ns/nbr", "wrong/M");
    for (const ScalingResult& s : scaling) {
        const BenchResult& r = s.result;
        text += format("%-11s %12.6g %-17s %12llu %14llu %9.4f %8.1f %8.2f %11.4g\n", s.vary.c_str(), s.value,
                       r.method.c_str(), wide(r.points), wide(r.pairs), r.totalSeconds,
                       ratio(1e9 * r.totalSeconds, static_cast<double>(r.points)),
                       ratio(1e9 * r.totalSeconds, static_cast<double>(r.pairs)),
                       r.accuracy.missingPerMillion() + r.accuracy.extraPerMillion());
    }
    return text;
}

std::string filesText(const std::vector<FileResult>& files)
{
    if (files.empty()) return "";
    std::string text =
        format("\nfiles: search IN -o OUT.npz, against copying both, grid and search\n%-16s %9s %9s %9s "
               "%9s %9s %9s %9s %9s %9s %7s\n",
               "scene", "in MB", "out MB", "read s", "OpenVDB", "grid s", "of array", "search s", "copy s",
               "whole s", "ratio");
    for (const FileResult& f : files) {
        text += format("%-16s %9.1f %9.1f %9.4f ", rowScene(f.scene).c_str(),
                       static_cast<double>(f.inputBytes) / 1e6, static_cast<double>(f.outputBytes) / 1e6,
                       f.readSeconds);
        text += f.openVdbReadSeconds ? format("%9.4f", *f.openVdbReadSeconds) : format("%9s", "-");
        text +=
            format(" %9.4f %9.4f %9.4f %9.4f %9.4f %7.2f\n", f.gridSeconds, f.arrayGridSeconds,
                   f.searchSeconds, f.copySeconds, f.wholeSeconds, ratio(f.wholeSeconds, f.floorSeconds()));
    }
    return text;
}

std::string modelText(const ModelStudy& model)
{
    if (model.shares.empty()) return "";
    std::string text = format("\nwhat the model takes\n%-16s %-8s %-11s %7s %9s %9s %9s %9s %9s %8s %10s\n",
                              "scene", "lists", "where", "blocks", "grid s", "estimate", "tree", "schedule",
                              "search s", "model %", "model B/p");
    for (const ModelShare& s : model.shares) {
        const double total = s.gridSeconds + s.modelSeconds() + s.searchSeconds;
        const auto bytes = static_cast<double>(s.estimateBytes + s.treeBytes + s.scheduleBytes);
        text += format("%-16s %-8s %-11s %7llu %9.4f %9.4f %9.4f %9.4f %9.4f %8.1f %10.2f\n",
                       rowScene(s.scene).c_str(), encodingName(s.encoding),
                       s.inCore ? "in core" : "out of core", wide(s.blocks), s.gridSeconds, s.estimateSeconds,
                       s.treeSeconds, s.scheduleSeconds, s.searchSeconds,
                       100 * ratio(s.modelSeconds(), total), ratio(bytes, static_cast<double>(s.points)));
    }
    text += format("\nwhat is left out, and what that saves\n%-52s %-8s %12s %12s %8s\n", "part", "unit",
                   "with", "without", "saved %");
    for (const Saving& s : model.savings) {
        text += format("%-52s %-8s %12.6g %12.6g %8.1f\n", s.part.c_str(), s.unit.c_str(), s.with, s.without,
                       100 * ratio(s.with - s.without, s.with));
    }
    return text;
}

} // namespace vdb_nns::cli
