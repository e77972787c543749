#include "report.h"

#include "text_file.h"
#include "vdb_nns/version.h"

#include <Eigen/LU>
#include <nlohmann/json.hpp>

#include <charconv>
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
    return input;
}

Json devicesJson(const SearchReport& report)
{
    Json device;
    device["kind"] = report.device.kind;
    device["name"] = report.device.name;
    device["budget_bytes"] = orNull(report.device.budgetBytes);
    device["peak_bytes"] = nullptr;
    device["blocks"] = nullptr;
    device["particles"] = report.points - report.nonfinite;
    device["busy_seconds"] = report.seconds.search;
    return Json::array({device});
}

Json planJson(const SearchReport& report)
{
    Json plan;
    plan["in_core"] = true;
    plan["encoding"] = encodingName(report.encoding);
    plan["blocks"] = nullptr;
    plan["largest_block_cells"] = nullptr;
    plan["device_particles"] = 0;
    plan["cpu_particles"] = report.points - report.nonfinite;
    plan["boundary_leaves"] = nullptr;
    plan["estimated_pairs"] = nullptr;
    plan["estimated_bytes"] = nullptr;
    plan["candidate_tests"] = report.candidateTests;
    return plan;
}

Json resultJson(const SearchReport& report)
{
    Json result;
    result["pairs"] = report.result.pairs;
    result["min"] = report.result.min;
    result["mean"] = report.result.mean;
    result["max"] = report.result.max;
    result["isolated"] = report.result.isolated;
    result["checksum"] = report.checksum ? Json(checksumText(*report.checksum)) : Json(nullptr);
    return result;
}

Json estimateJson()
{
    Json estimate;
    for (const char* key :
         {"actual_pairs", "relative_error", "block_error_p50", "block_error_p99", "overflows", "retries"}) {
        estimate[key] = nullptr;
    }
    return estimate;
}

Json secondsJson(const SecondsReport& seconds)
{
    Json json;
    json["read"] = seconds.read;
    json["grid"] = seconds.grid;
    json["estimate"] = nullptr;
    json["plan"] = nullptr;
    json["search"] = seconds.search;
    json["collect"] = nullptr;
    json["checksum"] = orNull(seconds.checksum);
    json["write"] = orNull(seconds.write);
    json["total"] = seconds.total;
    json["first"] = {{"grid", seconds.firstGrid}, {"search", seconds.firstSearch}};
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

std::string line(const char* label, const std::string& value)
{
    return format("%-11s ", label) + value + "\n";
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
    return mebibytes < 1024 ? format("%.1f MiB", mebibytes) : format("%.2f GiB", mebibytes / 1024);
}

std::string countText(std::uint64_t count)
{
    return std::to_string(count);
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

Vec3d radiusInVoxels(const Matrix3& linear, double radius)
{
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> matrix(linear[0].data());
    const Eigen::Matrix3d inverse = matrix.inverse();
    return {radius * inverse.row(0).norm(), radius * inverse.row(1).norm(), radius * inverse.row(2).norm()};
}

std::string searchReportJson(const SearchReport& report)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "search";
    json["input"] = inputJson(report);
    json["radius"] = {{"world", report.radius}, {"voxels", orNull(report.radiusVoxels)}};
    json["grid"] = {{"cell_size", report.cellSize},
                    {"reach", report.reach},
                    {"leaves", report.leaves},
                    {"cells", report.cells},
                    {"bytes", report.gridBytes}};
    json["device"] = {{"kind", report.device.kind},
                      {"name", report.device.name},
                      {"budget_bytes", orNull(report.device.budgetBytes)},
                      {"threads", report.device.threads},
                      {"simd", report.simd}};
    json["devices"] = devicesJson(report);
    json["plan"] = planJson(report);
    json["result"] = resultJson(report);
    json["estimate"] = estimateJson();
    json["memory"] = {{"peak_rss_bytes", report.peakBytes},
                      {"grid_bytes", report.gridBytes},
                      {"list_bytes", report.listBytes},
                      {"device_peak_bytes", nullptr}};
    json["seconds"] = secondsJson(report.seconds);
    return dump(json);
}

std::string searchReportText(const SearchReport& report)
{
    const SecondsReport& seconds = report.seconds;
    std::string text = line("particles", countText(report.points));
    const std::string voxels =
        report.radiusVoxels ? " (" + vectorText(*report.radiusVoxels) + " voxels)" : "";
    text += line("radius", shortest(report.radius) + voxels);
    text += line("pairs", countText(report.result.pairs));
    text += line("neighbors", format("min %u  mean %.2f  max %u", report.result.min, report.result.mean,
                                     report.result.max));
    text += line("isolated", countText(report.result.isolated));
    text += line("skipped", countText(report.nonfinite) + " not finite");
    text += line("cells", countText(report.cells) + " in " + countText(report.leaves) + " leaves, edge " +
                              format("%.6g", report.cellSize));
    text += line("lists", std::string(encodingName(report.encoding)) + ", " + bytesText(report.listBytes));
    text += line("memory", "grid " + bytesText(report.gridBytes) + ", peak " + bytesText(report.peakBytes));
    if (report.checksum) text += line("checksum", checksumText(*report.checksum));
    const double nanoseconds =
        report.points > 0 ? 1e9 * (seconds.grid + seconds.search) / static_cast<double>(report.points) : 0;
    text += line("speed", format("%.1f ns a particle (grid and search)", nanoseconds));
    text += line("time", format("%.3f s", seconds.total));
    text += step("read", seconds.read, seconds.total);
    text += step("grid", seconds.grid, seconds.total);
    text += step("search", seconds.search, seconds.total);
    if (seconds.checksum) text += step("checksum", *seconds.checksum, seconds.total);
    if (seconds.write) text += step("write", *seconds.write, seconds.total);
    for (const std::string& path : report.written) text += line("written", path);
    return text;
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
    json["suggested_radius"] = orNull(info.suggestedRadius);
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
    if (info.bbox) {
        const Vec3d &low = (*info.bbox)[0], &high = (*info.bbox)[1];
        text +=
            line("bounds", format("%g %g %g to %g %g %g", low[0], low[1], low[2], high[0], high[1], high[2]));
    }
    for (const AttributeInfo& a : info.attributes) {
        text += line("attribute", a.name + " (" + a.type + ", " + a.codec + ")");
    }
    text += line("radius",
                 info.suggestedRadius ? shortest(*info.suggestedRadius) + " suggested" : "none suggested");
    return text;
}

void deliverJson(const std::string& target, const std::string& json, bool overwrite)
{
    if (target == "-") {
        writeStdout(json);
    } else if (!target.empty()) {
        writeWholeFile(target, json.data(), json.size(), overwrite);
    }
}

} // namespace vdb_nns::cli
