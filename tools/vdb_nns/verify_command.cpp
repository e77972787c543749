// vdb_nns verify: checks lists against the independent exact search.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/version.h"
#include "verify/array_points.h"
#include "verify/independent_search.h"
#include "verify/lists_reader.h"

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

struct VerifyFlags {
    CommonFlags common;
    InputFlags input;
    std::string lists, sample, seed = "1";
};

Json exampleJson(const FaultExample& example)
{
    return {{"query", example.query},
            {"neighbor", example.neighbor},
            {"distance", example.distance},
            {"ulps", example.ulps},
            {"value", example.fileValue}};
}

std::string verifyJson(const VerifyFlags& flags, double radius, const VerifyReport& report, double seconds)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "verify";
    json["path"] = flags.input.path;
    json["lists"] = flags.lists;
    json["radius"] = radius;
    json["passed"] = report.passed();
    json["queries"] = report.queries;
    json["listed_pairs"] = report.listedPairs;
    json["expected_pairs"] = report.expectedPairs;
    json["exact_pairs"] = report.exactPairs;
    for (std::size_t kind = 0; kind < kFaultKinds; ++kind) {
        const FaultFinding& finding = report.findings[kind];
        std::string key = faultName(static_cast<Fault>(kind));
        for (char& c : key) c = c == ' ' ? '_' : c;
        Json examples = Json::array();
        for (const FaultExample& example : finding.examples) examples.push_back(exampleJson(example));
        json["faults"][key] = {{"count", finding.count}, {"examples", examples}};
    }
    json["seconds"] = seconds;
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string exampleText(Fault fault, const FaultExample& example)
{
    std::string text = format("    %llu -> %lld", static_cast<unsigned long long>(example.query),
                              static_cast<long long>(example.neighbor));
    if (!std::isnan(example.distance)) {
        text += format(", distance %.17g, radius %+.4g ulp", example.distance, example.ulps);
    }
    if (fault == Fault::kWrongDistance)
        text += format(", the file has %.9g", static_cast<double>(example.fileValue));
    return text + "\n";
}

std::string verifyText(const VerifyReport& report, double seconds)
{
    std::string text = format("queries     %llu\n", static_cast<unsigned long long>(report.queries));
    text += format("pairs       %llu listed, %llu expected\n",
                   static_cast<unsigned long long>(report.listedPairs),
                   static_cast<unsigned long long>(report.expectedPairs));
    text += format("exact       %llu pairs needed exact arithmetic\n",
                   static_cast<unsigned long long>(report.exactPairs));
    for (std::size_t kind = 0; kind < kFaultKinds; ++kind) {
        const FaultFinding& finding = report.findings[kind];
        const auto fault = static_cast<Fault>(kind);
        text += format("  %-16s %llu\n", faultName(fault), static_cast<unsigned long long>(finding.count));
        for (const FaultExample& example : finding.examples) text += exampleText(fault, example);
    }
    text += format("time        %.3f s\n", seconds);
    return text +
           (report.passed() ? "result      the lists are right\n" : "result      the lists are WRONG\n");
}

// The positions that verify reads itself: none of a .vdb.
// @throws CheckFailed where the engine's reader understands the file differently
std::optional<Positions> readOwnPoints(const PointFile& file, const std::string& path,
                                       const PointFileOptions& options)
{
    if (!isArrayPointFile(path)) return std::nullopt;
    Positions own = readArrayPoints(path, options);
    if (const std::optional<std::string> difference = findDifference(path, file.view(), own))
        throw CheckFailed(*difference);
    return own;
}

int verifyFile(const VerifyFlags& flags, const VerifyOptions& options, Session& session)
{
    const Stopwatch watch;
    ProgressPrinter progress(progressMode(flags.common));
    progress.begin("read", 0, 0.2);
    const PointFileOptions inputOptions = pointFileOptions(flags.input, 0, &progress);
    const PointFile file = PointFile::read(flags.input.path, inputOptions);
    session.path = flags.input.path;
    session.grid = flags.input.grid;
    session.otherPath = flags.lists;
    const std::optional<Positions> own = readOwnPoints(file, flags.input.path, inputOptions);
    const ParticleView points = own ? ParticleView::fromArray(own->data(), own->size() / 3) : file.view();
    const std::optional<double> suggested =
        flags.input.radius.empty() ? file.info().suggestedRadius : std::optional<double>();
    const double radius = chooseRadius(flags.input.radius, suggested, flags.input.path, flags.common.quiet);
    const ListsFile lists = ListsFile::open(flags.lists, &progress);
    progress.begin("verify", 0.2, 1);
    const VerifyReport report = verifyLists(points, radius, lists, options, &progress);
    throwIfStopped();
    progress.finish();
    deliverJson(flags.common.json, verifyJson(flags, radius, report, watch.seconds()),
                outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common)) writeSummary(verifyText(report, watch.seconds()));
    if (!report.passed()) {
        throw CheckFailed(flags.lists + " differs from the neighbors of " + flags.input.path + " in " +
                          std::to_string(report.faultCount()) + " places (" + std::to_string(report.queries) +
                          " queries checked)");
    }
    return kDone;
}

int runVerifyCommand(const VerifyFlags& flags, Session& session)
{
    VerifyOptions options;
    if (!flags.input.radius.empty()) parsePositive(flags.input.radius, "--radius");
    if (!flags.sample.empty()) options.sample = parseCount(flags.sample, "--sample");
    if (options.sample && *options.sample == 0)
        throw InvalidInput("--sample: 0 queries check nothing; give 1 or more");
    options.seed = parseCount(flags.seed, "--seed");
    ThreadLimit threads(threadCount(flags.common));
    checkOutputs({}, {flags.input.path, flags.lists}, flags.common);
    return threads.run([&] { return verifyFile(flags, options, session); });
}

} // namespace

Command addVerifyCommand(CLI::App& app)
{
    CLI::App* command = app.add_subcommand("verify", "check lists against an independent exact search");
    const auto flags = std::make_shared<VerifyFlags>();
    command->add_option("IN", flags->input.path, "point file that was searched")
        ->required()
        ->check(notEmpty());
    command->add_option("LISTS", flags->lists, "lists to check (.npz)")->required()->check(notEmpty());
    addInputFlags(*command, flags->input, true);
    command
        ->add_option("--sample", flags->sample,
                     "check N random queries against all points; default: all queries")
        ->type_name("N")
        ->check(notEmpty());
    command->add_option("--seed", flags->seed, "seed of the sample")->type_name("N")->capture_default_str();
    addCommonFlags(*command, flags->common);
    return {command, [flags](Session& session) { return runVerifyCommand(*flags, session); }};
}

} // namespace vdb_nns::cli
