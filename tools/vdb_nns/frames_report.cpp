#include "frames_report.h"

#include "vdb_nns/version.h"

#include <nlohmann/json.hpp>

#include <algorithm>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Numbers {
    std::uint64_t made = 0, failed = 0, skipped = 0;
};

Numbers numbersOf(const FramesReport& report)
{
    Numbers numbers;
    for (const FrameReport& frame : report.frames) {
        numbers.made += frame.report.has_value();
        numbers.failed += frame.failure.has_value();
        numbers.skipped += frame.isSkipped;
    }
    return numbers;
}

Json frameJson(const FrameReport& frame)
{
    Json json;
    json["frame"] = frame.number;
    if (frame.report) {
        json.update(Json::parse(searchReportJson(*frame.report)));
        return json;
    }
    json["input"] = {{"path", frame.path}};
    json["result"] = nullptr;
    json["skipped"] = frame.isSkipped;
    json["exit"] = frame.failure ? Json(frame.failure->code) : Json(nullptr);
    json["error"] = frame.failure ? Json(frame.failure->message) : Json(nullptr);
    return json;
}

} // namespace

std::string framesReportJson(const FramesReport& report)
{
    const Numbers numbers = numbersOf(report);
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "search";
    json["made"] = numbers.made;
    json["failed"] = numbers.failed;
    json["skipped"] = numbers.skipped;
    json["memory"] = {{"peak_rss_bytes", report.peakBytes}};
    json["seconds"] = {{"total", report.seconds}};
    json["frames"] = Json::array();
    for (const FrameReport& frame : report.frames) json["frames"].push_back(frameJson(frame));
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string frameText(const FrameReport& frame)
{
    const SearchReport& report = *frame.report;
    const ListStatistics result = report.result.value_or(ListStatistics{});
    return line(format("frame %d", frame.number).c_str(),
                countText(report.points) + " particles, radius " + shortest(report.radius) + ", " +
                    countText(result.pairs) + " pairs, " +
                    format("mean %.2f, %.3f s", result.mean, report.seconds.total));
}

std::string framesReportText(const FramesReport& report)
{
    const Numbers numbers = numbersOf(report);
    std::string made = countText(numbers.made) + " made";
    if (numbers.skipped > 0) made += ", " + countText(numbers.skipped) + " were there";
    if (numbers.failed > 0) made += ", " + countText(numbers.failed) + " failed";
    std::string text = line("frames", made);
    text += line("memory", "peak " + bytesText(report.peakBytes));
    const double each = report.seconds / static_cast<double>(std::max<std::uint64_t>(numbers.made, 1));
    return text + line("time", format("%.3f s", report.seconds) +
                                   (numbers.made > 0 ? format(", %.3f s a frame", each) : ""));
}

} // namespace vdb_nns::cli
