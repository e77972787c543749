#include "report.h"

#include "machine.h"
#include "numbers.h"
#include "standard_streams.h"
#include "vdb_nns/version.h"

#include <Eigen/LU>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdarg>
#include <cstdio>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

template <typename T>
Json orNull(const std::optional<T>& value)
{
    return value ? Json(*value) : Json(nullptr);
}

// Paths need not be UTF-8; JSON must.
std::string dump(const Json& json)
{
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

Json inputJson(const SearchReport& report)
{
    Json input;
    input["path"] = report.path;
    const bool known = report.info.has_value();
    const bool isGrid = known && report.info->voxelSize.has_value();
    input["grid"] = isGrid ? Json(report.info->grid) : Json(nullptr);
    input["points"] = report.points;
    input["nonfinite"] = report.nonfinite;
    input["voxel_size"] = known ? orNull(report.info->voxelSize) : Json(nullptr);
    input["codec"] = known ? Json(report.info->codec) : Json(nullptr);
    input["transform"] = known ? Json(report.info->transform) : Json(nullptr);
    input["taken"] = known && !report.info->taken.empty() ? Json(report.info->taken) : Json(nullptr);
    input["notes"] = known ? Json(report.info->notes) : Json::array();
    return input;
}

Json queriesJson(const PointFileInfo& info)
{
    return {{"path", info.path},
            {"grid", info.voxelSize ? Json(info.grid) : Json(nullptr)},
            {"points", info.points},
            {"nonfinite", info.nonfinite}};
}

Json deviceJson(const std::string& kind, const std::string& name, const Json& budget)
{
    return {{"kind", kind},      {"name", name},         {"budget_bytes", budget}, {"peak_bytes", nullptr},
            {"blocks", nullptr}, {"particles", nullptr}, {"busy_seconds", nullptr}};
}

Json devicesJson(const SearchReport& report)
{
    Json cpu = deviceJson(report.device.kind, report.device.name, orNull(report.device.budgetBytes));
    cpu["particles"] = report.points - report.nonfinite;
    cpu["busy_seconds"] = orNull(report.seconds.search);
    if (!report.plan) return Json::array({cpu});
    const Schedule& schedule = report.plan->schedule;
    Json list = Json::array();
    std::uint64_t cpuBlocks = schedule.blocks.size();
    for (std::size_t d = 0; d < schedule.devices.size(); ++d) {
        const DeviceLimits& limits = report.plan->devices[d];
        // What was done, or else what is predicted.
        DeviceRun done;
        done.peakBytes = schedule.devices[d].peakBytes;
        done.blocks = schedule.devices[d].blocks;
        done.particles = schedule.devices[d].particles;
        done.busySeconds = schedule.devices[d].busySeconds;
        if (report.run) done = report.run->devices[d];
        Json device = deviceJson(deviceKindName(limits.kind), limits.name, limits.memoryBytes);
        device["peak_bytes"] = done.peakBytes;
        device["blocks"] = done.blocks;
        device["particles"] = done.particles;
        device["busy_seconds"] = done.busySeconds;
        if (done.bytesUp > 0) { // measured, by a device that is there
            device["upload_seconds"] = done.uploadSeconds;
            device["download_seconds"] = done.downloadSeconds;
            device["bytes_up"] = done.bytesUp;
            device["bytes_down"] = done.bytesDown;
        }
        if (!done.failure.empty()) device["failure"] = done.failure;
        list.push_back(device);
        cpuBlocks -= schedule.devices[d].blocks;
    }
    cpu["blocks"] = report.run ? report.run->cpuBlocks : cpuBlocks;
    cpu["particles"] = report.run ? report.run->cpuParticles : schedule.cpuParticles;
    cpu["busy_seconds"] = report.run ? report.run->cpuBusySeconds : schedule.cpuBusySeconds;
    list.push_back(cpu);
    return list;
}

// The device with the largest peak; the CPU, which stands last, where it is alone.
Json mainDevice(const Json& devices)
{
    std::size_t main = 0;
    for (std::size_t d = 0; d + 1 < devices.size(); ++d) {
        if (devices[d]["peak_bytes"] > devices[main]["peak_bytes"]) main = d;
    }
    return devices[main];
}

Json blocksJson(const Plan& plan)
{
    Json list = Json::array();
    for (const Block& block : plan.schedule.blocks) {
        const Vec3i& origin = block.log2Cells == WorkloadNode::kRoot ? plan.lowCell : block.origin;
        list.push_back({{"cells", edgeCells(block, plan)},
                        {"origin", origin},
                        {"leaves", block.endLeaf - block.firstLeaf},
                        {"particles", block.work.particles},
                        {"halo_particles", block.withHalo ? block.halo.particles : 0},
                        {"boundary_queries", block.halo.boundaryQueries},
                        {"expected_pairs", block.work.expectedPairs},
                        {"candidate_tests", block.work.candidateTests},
                        {"bytes", block.bytes.total()},
                        {"executor", executorName(plan.devices, block.preferred)},
                        {"start_seconds", block.startSeconds},
                        {"end_seconds", block.endSeconds}});
    }
    return list;
}

Json planJson(const SearchReport& report)
{
    Json plan;
    plan["in_core"] = true;
    plan["encoding"] = encodingName(report.encoding);
    plan["straight_to_file"] = report.straightToFile;
    plan["blocks"] = nullptr;
    plan["largest_block_cells"] = nullptr;
    plan["device_particles"] = 0;
    plan["cpu_particles"] = report.points - report.nonfinite;
    plan["boundary_leaves"] = nullptr;
    plan["estimated_pairs"] = nullptr;
    plan["estimated_bytes"] = nullptr;
    plan["candidate_tests"] = report.candidateTests;
    if (!report.plan) return plan;
    const Schedule& schedule = report.plan->schedule;
    std::int64_t largest = 0;
    for (const Block& block : schedule.blocks) largest = std::max(largest, edgeCells(block, *report.plan));
    plan["in_core"] = schedule.inCore;
    plan["blocks"] = schedule.blocks.size();
    plan["largest_block_cells"] = largest;
    plan["device_particles"] = schedule.deviceParticles;
    plan["cpu_particles"] = schedule.cpuParticles;
    plan["boundary_leaves"] = schedule.boundaryLeaves;
    plan["estimated_pairs"] = report.plan->total.expectedPairs;
    plan["estimated_bytes"] = report.plan->everything.total() + report.measureBytes.value_or(0);
    if (!report.run) plan["measure_bytes"] = orNull(report.measureBytes);
    plan["boundary"] = boundaryModeName(schedule.boundary);
    plan["estimator"] = estimatorName(report.plan->estimator);
    plan["correction"] = report.plan->correction;
    plan["counted_queries"] = report.plan->countedQueries;
    plan["margin"] = schedule.model.margin;
    plan["too_large_queries"] = schedule.tooLargeQueries;
    plan["tree_nodes"] = report.plan->treeNodes;
    plan["tree_levels"] = report.plan->treeLevels;
    plan["predicted_seconds"] = schedule.predictedSeconds;
    plan["lower_bound_seconds"] = schedule.lowerBoundSeconds;
    if (report.run) plan["model_seconds"] = report.run->seconds;
    if (!report.run) plan["blocks_list"] = blocksJson(*report.plan);
    return plan;
}

Json resultJson(const SearchReport& report)
{
    if (!report.result) return nullptr;
    Json result;
    result["pairs"] = report.result->pairs;
    result["min"] = report.result->min;
    result["mean"] = report.result->mean;
    result["max"] = report.result->max;
    result["isolated"] = report.result->isolated;
    result["shortened"] = report.result->shortened;
    result["bad_radii"] = report.badRadii;
    result["checksum"] = report.checksum ? Json(checksumText(*report.checksum)) : Json(nullptr);
    return result;
}

Json tilesJson(const std::vector<Tile>& tiles)
{
    Json list = Json::array();
    for (const Tile& tile : tiles) {
        list.push_back({{"tile", list.size() + 1},
                        {"first_leaf", tile.firstLeaf},
                        {"end_leaf", tile.endLeaf},
                        {"particles", tile.particles},
                        {"halo_particles", tile.haloParticles},
                        {"expected_pairs", tile.expectedPairs},
                        {"bytes", tile.bytes}});
    }
    return list;
}

Json measuresJson(const WrittenMeasures& measures)
{
    Json json;
    json["attributes"] = Json::array();
    for (const WrittenMeasures::Attribute& attribute : measures.attributes)
        json["attributes"].push_back({{"name", attribute.name}, {"type", attribute.type}});
    json["groups"] = measures.groups;
    json["skipped_values"] = Json::object();
    for (const Measured::Skipped& skipped : measures.skipped)
        json["skipped_values"][skipped.attribute] = skipped.values;
    json["kept"] = Json::array();
    for (const Conversion::Kept& kept : measures.kept)
        json["kept"].push_back({{"name", kept.name}, {"type", kept.type}});
    json["left_out"] = Json::array();
    for (const Conversion::LeftOut& left : measures.leftOut)
        json["left_out"].push_back({{"name", left.name}, {"why", left.why}});
    json["voxel_size"] = measures.voxelSize > 0 ? Json(measures.voxelSize) : Json(nullptr);
    json["largest_rounding"] = measures.voxelSize > 0 ? Json(measures.largestRounding) : Json(nullptr);
    return json;
}

Json estimateJson(const SearchReport& report)
{
    Json estimate;
    for (const char* key : {"actual_pairs", "relative_error", "block_error_p50", "block_error_p99",
                            "overflows", "retries", "splits", "halvings", "too_large_queries"}) {
        estimate[key] = nullptr;
    }
    if (!report.run) return estimate;
    const ScheduleRun& run = *report.run;
    estimate["actual_pairs"] = report.result->pairs;
    if (report.result->pairs > 0) {
        const double pairs = static_cast<double>(report.result->pairs);
        const BlockErrors errors = blockErrors(report.plan->schedule, run);
        estimate["relative_error"] = report.plan->total.expectedPairs / pairs - 1;
        estimate["block_error_p50"] = errors.p50;
        estimate["block_error_p99"] = errors.p99;
    }
    estimate["overflows"] = run.overflows;
    estimate["retries"] = run.retries;
    estimate["splits"] = run.splits;
    estimate["halvings"] = run.halvings;
    estimate["too_large_queries"] = run.tooLargeQueries;
    return estimate;
}

Json secondsJson(const SearchReport& report)
{
    const SecondsReport& seconds = report.seconds;
    Json json;
    json["read"] = seconds.read;
    json["grid"] = seconds.grid;
    json["estimate"] = orNull(seconds.estimate);
    json["plan"] = orNull(seconds.plan);
    json["search"] = orNull(seconds.search);
    json["measure"] = orNull(seconds.measure);
    json["collect"] = report.run ? Json(report.run->collectSeconds) : Json(nullptr); // of all threads
    json["checksum"] = orNull(seconds.checksum);
    json["write"] = orNull(seconds.write);
    json["total"] = seconds.total;
    json["first"] = {{"grid", seconds.firstGrid}, {"search", orNull(seconds.firstSearch)}};
    return json;
}

Json attributesJson(const std::vector<AttributeInfo>& attributes)
{
    Json list = Json::array();
    for (const AttributeInfo& a : attributes) {
        list.push_back({{"name", a.name}, {"type", a.type}, {"codec", a.codec}});
    }
    return list;
}

} // namespace

std::string format(const char* pattern, ...)
{
    std::va_list arguments, again;
    va_start(arguments, pattern);
    va_copy(again, arguments);
    const int length = std::vsnprintf(nullptr, 0, pattern, arguments);
    va_end(arguments);
    std::string text(length > 0 ? static_cast<std::size_t>(length) : 0, '\0');
    std::vsnprintf(text.data(), text.size() + 1, pattern, again);
    va_end(again);
    return text;
}

const char* encodingName(Encoding encoding)
{
    switch (encoding) {
    case Encoding::kIndex:
        return "index";
    case Encoding::kMask:
        return "mask";
    case Encoding::kNone:
        return "none";
    }
    return "none";
}

std::string shortest(double value)
{
    char text[32]; // 24 are enough for any double
    const std::to_chars_result end = std::to_chars(text, text + sizeof text, value);
    return std::string(text, end.ptr);
}

std::string checksumText(std::uint64_t checksum)
{
    return format("%016llx", static_cast<unsigned long long>(checksum));
}

std::string line(const char* label, const std::string& value)
{
    return format("%-11s ", label) + printable(value) + "\n";
}

std::string step(const char* label, double seconds, double total)
{
    return format("  %-9s %.3f s  %3.0f %%\n", label, seconds, total > 0 ? 100 * seconds / total : 0);
}

std::string vectorText(const Vec3d& v)
{
    return format("%g x %g x %g", v[0], v[1], v[2]);
}

std::string bytesText(std::uint64_t bytes)
{
    const double mebibytes = static_cast<double>(bytes) / (1024.0 * 1024.0);
    if (mebibytes < 0.1) return format("%.1f KiB", mebibytes * 1024);
    return mebibytes < 1024 ? format("%.1f MiB", mebibytes) : format("%.2f GiB", mebibytes / 1024);
}

std::string countText(std::uint64_t count)
{
    return std::to_string(count);
}

std::string timeLines(const SecondsReport& seconds)
{
    std::string text = line("time", format("%.3f s", seconds.total));
    text += step("read", seconds.read, seconds.total);
    text += step("grid", seconds.grid, seconds.total);
    if (seconds.estimate) text += step("estimate", *seconds.estimate, seconds.total);
    if (seconds.plan) text += step("plan", *seconds.plan, seconds.total);
    if (seconds.search) text += step("search", *seconds.search, seconds.total);
    if (seconds.measure) text += step("measure", *seconds.measure, seconds.total);
    if (seconds.checksum) text += step("checksum", *seconds.checksum, seconds.total);
    if (seconds.write) text += step("write", *seconds.write, seconds.total);
    return text;
}

std::int64_t edgeCells(const Block& block, const Plan& plan)
{
    if (block.log2Cells != WorkloadNode::kRoot) return std::int64_t(1) << block.log2Cells;
    std::int64_t edge = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        edge = std::max(edge, std::int64_t(plan.endCell[k]) - plan.lowCell[k]);
    }
    return edge;
}

std::string executorName(const std::vector<DeviceLimits>& devices, int executor)
{
    if (executor == Block::kOnCpu) return deviceKindName(DeviceKind::kCpu);
    const std::string kind = deviceKindName(devices[static_cast<std::size_t>(executor)].kind);
    return kind + ":" + std::to_string(executor);
}

BlockErrors blockErrors(const Schedule& schedule, const ScheduleRun& run)
{
    constexpr double kFewestPairs = 1e4;
    std::vector<std::pair<double, double>> errors; // and pairs
    double expected = 0, found = 0, all = 0;
    for (std::size_t b = 0; b < schedule.blocks.size(); ++b) {
        expected += schedule.blocks[b].work.expectedPairs;
        found += static_cast<double>(run.blockPairs[b]);
        if (found <= 0 || (found < kFewestPairs && b + 1 < schedule.blocks.size())) continue;
        errors.emplace_back(std::fabs(expected - found) / found, found);
        all += found;
        expected = found = 0;
    }
    std::sort(errors.begin(), errors.end());
    return {weightedQuantile(errors, 0.5 * all), weightedQuantile(errors, 0.99 * all)};
}

Vec3d radiusInVoxels(const Matrix3& linear, double radius)
{
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> matrix(linear[0].data());
    const Eigen::Matrix3d inverse = matrix.inverse();
    return {radius * inverse.row(0).norm(), radius * inverse.row(1).norm(), radius * inverse.row(2).norm()};
}

void fillGridReport(const SearchSets& sets, const SearchOptions& options, SearchReport& report)
{
    report.points = sets.columnCount();
    report.nonfinite = sets.nonfiniteCandidates();
    report.rows = sets.rowCount();
    report.lattices = sets.latticeCount();
    report.cellSize = sets.cellSize();
    report.reach = sets.reach();
    report.leaves = sets.leafCount();
    report.cells = sets.cellCount();
    report.gridBytes = sets.bytes();
    report.device.name = cpuName();
    if (options.hostMemoryBytes > 0) report.device.budgetBytes = options.hostMemoryBytes;
}

std::string searchReportJson(const SearchReport& report)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = report.command;
    json["input"] = inputJson(report);
    if (report.queries) json["queries"] = queriesJson(*report.queries);
    json["radius"] = {{"world", report.radius}, {"voxels", orNull(report.radiusVoxels)}};
    json["grid"] = {{"cell_size", report.cellSize}, {"reach", report.reach}, {"lattices", report.lattices},
                    {"leaves", report.leaves},      {"cells", report.cells}, {"bytes", report.gridBytes}};
    const Json devices = devicesJson(report);
    const Json main = mainDevice(devices);
    json["device"] = {{"kind", main["kind"]},
                      {"name", main["name"]},
                      {"budget_bytes", main["budget_bytes"]},
                      {"threads", report.device.threads},
                      {"simd", report.simd}};
    json["devices"] = devices;
    json["plan"] = planJson(report);
    if (report.tile)
        json["tile"] = {
            {"tile", report.tile->tile}, {"tiles", report.tile->tiles}, {"rows", report.tile->rows}};
    if (!report.tiles.empty()) json["tiles"] = tilesJson(report.tiles);
    json["result"] = resultJson(report);
    json["measures"] = report.measures ? measuresJson(*report.measures) : Json(nullptr);
    json["estimate"] = estimateJson(report);
    json["memory"] = {{"peak_rss_bytes", report.peakBytes},
                      {"grid_bytes", report.gridBytes},
                      {"list_bytes", report.listBytes},
                      {"device_peak_bytes", main["peak_bytes"]}};
    json["seconds"] = secondsJson(report);
    return dump(json);
}

namespace {

std::string measuresText(const WrittenMeasures& measures)
{
    std::string text;
    for (const WrittenMeasures::Attribute& attribute : measures.attributes)
        text += line(text.empty() ? "attributes" : "", attribute.name + " (" + attribute.type + ")");
    for (const std::string& group : measures.groups)
        text += line(text.empty() ? "attributes" : "", group + " (group)");
    for (const Measured::Skipped& skipped : measures.skipped)
        text += line("skipped",
                     countText(skipped.values) + " values of " + skipped.attribute + " that are not finite");
    text += keptText(measures.kept, measures.leftOut);
    if (measures.voxelSize > 0) text += line("voxel size", format("%.9g", measures.voxelSize));
    return text;
}

} // namespace

std::string searchReportText(const SearchReport& report)
{
    const SecondsReport& seconds = report.seconds;
    std::string text = line("particles", countText(report.points));
    if (report.queries) text += line("queries", countText(report.rows) + " of " + report.queries->path);
    if (report.tile) {
        text += line("tile", format("%u of %u, ", report.tile->tile, report.tile->tiles) +
                                 countText(report.tile->rows) + " rows");
    }
    const std::string voxels =
        report.radiusVoxels ? " (" + vectorText(*report.radiusVoxels) + " voxels)" : "";
    text += line("radius", shortest(report.radius) + voxels);
    const ListStatistics result = report.result.value_or(ListStatistics{});
    text += line("pairs", countText(result.pairs));
    text += line("neighbors", format("min %u  mean %.2f  max %u", result.min, result.mean, result.max));
    text += line("isolated", countText(result.isolated));
    text += line("skipped", countText(report.nonfinite) + " not finite");
    if (result.shortened > 0) text += line("shortened", countText(result.shortened) + " lists had more");
    if (report.badRadii > 0) text += line("bad radii", countText(report.badRadii) + " reach nobody");
    text += line("cells", countText(report.cells) + " in " + countText(report.leaves) + " leaves, edge " +
                              format("%.6g", report.cellSize));
    const std::string lists = std::string(encodingName(report.encoding)) + ", " + bytesText(report.listBytes);
    text +=
        line("lists",
             report.straightToFile ? "straight to the file, counts " + bytesText(report.listBytes) : lists);
    text += line("memory", "grid " + bytesText(report.gridBytes) + ", peak " + bytesText(report.peakBytes));
    if (report.checksum) text += line("checksum", checksumText(*report.checksum));
    if (report.measures) text += measuresText(*report.measures);
    if (report.run) text += runText(report);
    const double nanoseconds = report.points > 0 ? 1e9 * (seconds.grid + seconds.search.value_or(0)) /
                                                       static_cast<double>(report.points)
                                                 : 0;
    text += line("speed", format("%.1f ns a particle (grid and search)", nanoseconds));
    text += timeLines(seconds);
    for (const std::string& path : report.written) text += line("written", path);
    return text;
}

std::string keptText(const std::vector<Conversion::Kept>& kept,
                     const std::vector<Conversion::LeftOut>& leftOut)
{
    std::string text;
    for (const Conversion::Kept& each : kept) text += line("kept", each.name + " (" + each.type + ")");
    for (const Conversion::LeftOut& each : leftOut) text += line("left out", each.name + " " + each.why);
    return text;
}

void warnOfLeftOut(const std::vector<Conversion::LeftOut>& leftOut)
{
    for (const Conversion::LeftOut& each : leftOut) say("warning: left out: " + each.name + " " + each.why);
}

std::string infoJson(const PointFileInfo& info)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "info";
    json["path"] = info.path;
    json["format"] = info.format;
    json["grid"] = info.voxelSize ? Json(info.grid) : Json(nullptr);
    json["points"] = info.points;
    json["nonfinite"] = info.nonfinite;
    json["voxel_size"] = orNull(info.voxelSize);
    json["codec"] = info.codec;
    json["transform"] = info.transform;
    json["bbox"] = orNull(info.bbox);
    json["attributes"] = attributesJson(info.attributes);
    json["groups"] = info.groups;
    json["suggested_radius"] = orNull(info.suggestedRadius);
    json["taken"] = info.taken.empty() ? Json(nullptr) : Json(info.taken);
    json["notes"] = info.notes;
    return dump(json);
}

std::string infoText(const PointFileInfo& info)
{
    std::string text = line("file", info.path + " (" + info.format + ")");
    if (info.voxelSize) text += line("grid", info.grid);
    text += line("points", countText(info.points) + ", " + countText(info.nonfinite) + " not finite");
    if (info.voxelSize) {
        text += line("voxel size", vectorText(*info.voxelSize));
        for (int k = 0; k < 3; ++k) {
            const std::array<double, 4>& row = info.transform[static_cast<std::size_t>(k)];
            text += line(k == 0 ? "transform" : "",
                         format("%12.6g %12.6g %12.6g %12.6g", row[0], row[1], row[2], row[3]));
        }
    }
    text += line("codec", info.codec);
    if (!info.taken.empty()) text += line("taken", info.taken);
    for (const std::string& note : info.notes) text += line("note", note);
    if (info.bbox) {
        const Vec3d &low = (*info.bbox)[0], &high = (*info.bbox)[1];
        text +=
            line("bounds", format("%g %g %g to %g %g %g", low[0], low[1], low[2], high[0], high[1], high[2]));
    }
    for (const AttributeInfo& a : info.attributes) {
        text += line("attribute", a.name + " (" + a.type + (a.codec.empty() ? "" : ", " + a.codec) + ")");
    }
    for (const std::string& group : info.groups) text += line("group", group);
    text += line("radius",
                 info.suggestedRadius ? shortest(*info.suggestedRadius) + " suggested" : "none suggested");
    return text;
}

void deliverJson(const std::string& target, const std::string& json, const OutputOptions& options)
{
    if (target == "-") {
        writeStdout(json);
    } else if (!target.empty()) {
        writeFile(target, json.data(), json.size(), options);
    }
}

} // namespace vdb_nns::cli
