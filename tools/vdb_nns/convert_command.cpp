// vdb_nns convert: the points of one file into another one.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/memory.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/version.h"
#include "vdb_nns/write_points.h"

#include <memory>
#include <nlohmann/json.hpp>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

struct ConvertFlags {
    CommonFlags common;
    InputFlags input;
    std::string output, voxelSize, keep = "all", nonfinite = "skip";
};

struct ConvertReport {
    PointFileInfo input;
    Conversion done;
    int threads = 0;
    double readSeconds = 0, writeSeconds = 0, totalSeconds = 0;
};

ConvertOptions convertOptions(const ConvertFlags& flags)
{
    ConvertOptions options;
    options.keep = flags.keep;
    if (!flags.voxelSize.empty()) options.voxelSize = parsePositive(flags.voxelSize, "--voxel-size");
    return options;
}

Json inputJson(const PointFileInfo& info)
{
    Json input;
    input["path"] = info.path;
    input["format"] = info.format;
    input["grid"] = info.voxelSize ? Json(info.grid) : Json(nullptr);
    input["points"] = info.points;
    input["nonfinite"] = info.nonfinite;
    input["voxel_size"] = info.voxelSize ? Json(*info.voxelSize) : Json(nullptr);
    input["codec"] = info.codec;
    input["transform"] = info.transform;
    input["taken"] = info.taken.empty() ? Json(nullptr) : Json(info.taken);
    input["notes"] = info.notes;
    return input;
}

Json outputJson(const ConvertFlags& flags, const Conversion& done)
{
    const bool isGrid = done.format == "vdb";
    Json output;
    output["path"] = flags.output;
    output["format"] = done.format;
    output["grid"] = isGrid ? Json("points") : Json(nullptr);
    output["points"] = done.written.points;
    output["skipped"] = done.written.skipped;
    output["positions"] = done.written.isDouble ? "float64" : "float32";
    output["voxel_size"] = isGrid ? Json(done.written.voxelSize) : Json(nullptr);
    output["largest_rounding"] = done.written.largestRounding;
    output["id"] = done.hasId ? Json("id") : Json(nullptr);
    output["attributes"] = Json::array();
    output["groups"] = Json::array();
    output["left_out"] = Json::array();
    for (const Conversion::Kept& kept : done.kept) {
        if (kept.type == "group") {
            output["groups"].push_back(kept.name);
        } else {
            output["attributes"].push_back({{"name", kept.name}, {"type", kept.type}});
        }
    }
    for (const Conversion::LeftOut& left : done.leftOut)
        output["left_out"].push_back({{"name", left.name}, {"why", left.why}});
    return output;
}

std::string convertJson(const ConvertFlags& flags, const ConvertReport& report)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "convert";
    json["input"] = inputJson(report.input);
    json["output"] = outputJson(flags, report.done);
    json["device"] = {{"kind", "cpu"}, {"name", cpuName()}, {"threads", report.threads}};
    json["memory"] = {{"peak_rss_bytes", peakMemoryBytes()}};
    json["seconds"] = {
        {"read", report.readSeconds}, {"write", report.writeSeconds}, {"total", report.totalSeconds}};
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string convertText(const ConvertFlags& flags, const ConvertReport& report)
{
    const Conversion& done = report.done;
    std::string text = line("file", report.input.path + " (" + report.input.format + ")");
    if (!report.input.taken.empty()) text += line("taken", report.input.taken);
    text += line("points", countText(done.written.points));
    if (report.input.nonfinite > 0)
        text += line("not finite", countText(report.input.nonfinite) +
                                       (done.written.skipped > 0 ? ", left out" : ", kept"));
    if (done.format == "vdb") {
        text += line("voxel size", format("%.9g", done.written.voxelSize) +
                                       (flags.voxelSize.empty() ? ", chosen for 8 points a voxel" : ""));
    } else {
        text += line("positions", done.written.isDouble ? "float64" : "float32");
    }
    text += line("rounding", done.written.largestRounding > 0
                                 ? format("at most %.3g", done.written.largestRounding)
                                 : "none");
    if (done.hasId) text += line("added", "id (the number in the input)");
    text += keptText(done.kept, done.leftOut);
    text += line("time", format("%.3f s", report.totalSeconds));
    text += step("read", report.readSeconds, report.totalSeconds);
    text += step("write", report.writeSeconds, report.totalSeconds);
    return text + line("written", flags.output);
}

// What a person has to know who does not read the report.
void warn(const ConvertFlags& flags, const ConvertReport& report)
{
    if (flags.common.quiet) return;
    const Conversion& done = report.done;
    warnOfLeftOut(done.leftOut);
    if (done.written.skipped > 0)
        say("warning: " + countText(done.written.skipped) +
            " points with a NaN or infinite coordinate are left out; the attribute id tells which are there");
    if (done.written.largestRounding == 0) return;
    const bool mayBeExact = done.format == "vdb" && report.input.codec == "float32";
    say("warning: positions were rounded by up to " + format("%.3g", done.written.largestRounding) +
        " (world units), so that pairs whose distance is within " +
        format("%.3g", 2 * done.written.largestRounding) +
        " of a radius may be neighbors in one file and not in the other" +
        (mayBeExact ? "; with a power of two as --voxel-size none of these would be rounded" : ""));
}

void checkNonfinite(const ConvertFlags& flags, const PointFileInfo& info)
{
    if (flags.nonfinite != "fail" || info.nonfinite == 0) return;
    throw CheckFailed(countText(info.nonfinite) + " of " + countText(info.points) +
                      " points have a NaN or infinite coordinate; --nonfinite skip leaves them out of a .vdb "
                      "and keeps them in other files");
}

int convertFile(const ConvertFlags& flags, const ConvertOptions& options, int threads, Session& session)
{
    const Stopwatch total;
    ProgressPrinter progress(progressMode(flags.common));
    ConvertReport report;
    report.threads = threads;
    progress.begin("read", 0, 0.3);
    const Stopwatch reading;
    const PointFile file = PointFile::read(flags.input.path, pointFileOptions(flags.input, 0, &progress));
    session.path = flags.input.path;
    if (!flags.common.quiet) {
        for (const std::string& note : file.notes()) say(flags.input.path + ": " + note);
    }
    report.input = file.info();
    session.grid = report.input.grid;
    checkNonfinite(flags, report.input);
    report.readSeconds = reading.seconds();

    progress.begin("write", 0.3, 1);
    const Stopwatch writing;
    report.done = convertPoints(file, flags.output, options, outputOptions(flags.common), &progress);
    report.writeSeconds = writing.seconds();
    throwIfStopped();
    progress.finish();
    report.totalSeconds = total.seconds();
    warn(flags, report);
    if (!flags.common.json.empty())
        deliverJson(flags.common.json, convertJson(flags, report), outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(convertText(flags, report));
    return kDone;
}

int runConvertCommand(const ConvertFlags& flags, Session& session)
{
    const ConvertOptions options = convertOptions(flags);
    checkConversion(flags.output, options);
    ThreadLimit threads(threadCount(flags.common));
    checkNotInput(flags.output, {flags.input.path});
    checkOutputs({flags.output}, {flags.input.path}, flags.common);
    return threads.run([&] { return convertFile(flags, options, threads.count(), session); });
}

} // namespace

Command addConvertCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("convert", "write the points of one file into another format");
    const auto flags = std::make_shared<ConvertFlags>();
    command->add_option("IN", flags->input.path, kInputHelp)->required()->check(notEmpty());
    command->add_option("-o,--output", flags->output, "file to write: .vdb .ply .npz .npy")
        ->type_name("OUT")
        ->required()
        ->check(notEmpty());
    addInputFlags(*command, flags->input, false);
    command
        ->add_option("--voxel-size", flags->voxelSize,
                     "voxel edge of a .vdb in world units; default: what gives 8 points an occupied voxel")
        ->type_name("SIZE")
        ->check(notEmpty());
    command
        ->add_option("--keep", flags->keep,
                     "attributes and groups of a .vdb, properties of a .ply, arrays of an .npz that come "
                     "along: all, none, or names separated by commas")
        ->type_name("LIST")
        ->check(notEmpty())
        ->capture_default_str();
    command
        ->add_option("--nonfinite", flags->nonfinite,
                     "what to do with points that have a NaN or infinite coordinate: skip leaves them out "
                     "of a .vdb and keeps them in other files; or fail")
        ->type_name("HOW")
        ->check(CLI::IsMember({"skip", "fail"}))
        ->capture_default_str();
    addCommonFlags(*command, flags->common);
    return {command, [flags](Session& session) { return runConvertCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
