// vdb_nns verify: checks lists and attributes against the independent exact search.
#include "cli_options.h"
#include "command.h"
#include "exit_codes.h"
#include "machine.h"
#include "measure_options.h"
#include "query_options.h"
#include "report.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/version.h"
#include "verify/array_points.h"
#include "verify/independent_search.h"
#include "verify/lists_reader.h"
#include "verify/result_file.h"
#include "verify_measures.h"

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
    QueryFlags query;
    MeasureFlags measures;
    std::string result, sample, seed = "1";
};

Json exampleJson(const FaultExample& example)
{
    return {{"query", example.query},
            {"neighbor", example.neighbor},
            {"distance", example.distance},
            {"ulps", example.ulps},
            {"value", example.fileValue}};
}

// What was checked: `radius` of all pairs where points have none of their own.
struct Checked {
    std::optional<double> radius;
    std::uint64_t badRadii = 0;
};

// What reports of lists and of attributes have alike; `holds` says which.
Json headJson(const VerifyFlags& flags, const Checked& checked, const char* holds, bool passed)
{
    Json json;
    json["schema"] = 1;
    json["version"] = VDB_NNS_VERSION;
    json["command"] = "verify";
    json["path"] = flags.input.path;
    json[holds] = flags.result;
    json["radius"] = checked.radius ? Json(*checked.radius) : Json(nullptr);
    json["bad_radii"] = checked.radius ? Json(nullptr) : Json(checked.badRadii);
    json["passed"] = passed;
    return json;
}

std::string dumped(const Json& json)
{
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string reportJson(const VerifyFlags& flags, const Checked& checked, const VerifyReport& report,
                       double seconds)
{
    Json json = headJson(flags, checked, "lists", report.passed());
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
    return dumped(json);
}

std::string reportJson(const VerifyFlags& flags, const Checked& checked, const MeasureReport& report,
                       double seconds)
{
    Json json = headJson(flags, checked, "attributes", report.passed());
    json["queries"] = report.queries;
    json["expected_pairs"] = report.expectedPairs;
    json["exact_pairs"] = report.exactPairs;
    json["faults"] = faultsJson(report);
    json["seconds"] = seconds;
    return dumped(json);
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

std::string headText(const Checked& checked, std::uint64_t queries)
{
    std::string text = format("queries     %llu\n", static_cast<unsigned long long>(queries));
    if (checked.radius) return text;
    return text + format("radii       of points, %llu of them NaN, infinite or not positive\n",
                         static_cast<unsigned long long>(checked.badRadii));
}

std::string endText(const char* what, bool passed, double seconds)
{
    return format("time        %.3f s\nresult      the %s are %s\n", seconds, what,
                  passed ? "right" : "WRONG");
}

std::string reportText(const Checked& checked, const VerifyReport& report, double seconds)
{
    std::string text = headText(checked, report.queries);
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
    return text + endText("lists", report.passed(), seconds);
}

std::string reportText(const Checked& checked, const MeasureReport& report, double seconds)
{
    return headText(checked, report.queries) +
           format("pairs       %llu\nexact       %llu pairs needed exact arithmetic\n",
                  static_cast<unsigned long long>(report.expectedPairs),
                  static_cast<unsigned long long>(report.exactPairs)) +
           faultsText(report) + endText("attributes", report.passed(), seconds);
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

// Points as verify takes them: from its own reader where that can read the file.
struct CheckedPoints {
    std::optional<Positions> own;
    ParticleView view;
};

CheckedPoints checkedPoints(const PointFile& file, const std::string& path, const PointFileOptions& options)
{
    CheckedPoints points;
    points.own = readOwnPoints(file, path, options);
    points.view =
        points.own ? ParticleView::fromArray(points.own->data(), points.own->size() / 3) : file.view();
    return points;
}

Vec3d translationOf(const PointFile& file)
{
    const Matrix4& transform = file.info().transform;
    return {transform[0][3], transform[1][3], transform[2][3]};
}

// Radii of the points of a file that verify can read itself, too: properties, and radius files.
// @throws CheckFailed where the engine's reader understands the file differently
void checkRadii(const std::vector<double>& radii, const std::string& path, const std::string& radiusFile,
                const VerifyFlags& flags, double scale, const PointFileOptions& options)
{
    const std::string& attribute = flags.query.radiusAttribute;
    if (radii.empty() || (!attribute.empty() && extensionOf(path) != ".ply")) return;
    const std::string& source = attribute.empty() ? radiusFile : path;
    std::vector<double> own =
        attribute.empty() ? readNpyNumbers(source, options) : readPlyScalars(source, attribute, options);
    for (double& radius : own) radius *= scale;
    if (const std::optional<std::string> difference = findDifference(source, radii, own))
        throw CheckFailed(*difference);
}

bool isVdb(const std::string& path)
{
    return extensionOf(path) == ".vdb";
}

// Lists have no measures.
void checkListFlags(const VerifyFlags& flags)
{
    const MeasureFlags& measures = flags.measures;
    std::string flag = measures.given.empty() ? std::string() : measures.given[0];
    if (!measures.minNeighbors.empty()) flag = "--min-neighbors";
    if (!measures.massAttribute.empty()) flag = "--mass-attribute";
    if (!measures.attributes.empty()) flag = "--attributes";
    if (flag.empty()) return;
    throw InvalidInput(flag + " is about attributes, and " + flags.result +
                       " holds lists; give the .vdb, .ply or .npz that has the attributes");
}

// What a report is about, for the sentence of the error.
const char* subject(const VerifyReport&)
{
    return "the neighbors";
}
const char* subject(const MeasureReport&)
{
    return "the measures";
}

// Delivers a report, of lists or of attributes, and fails where something was wrong.
template <typename Report>
int deliver(const VerifyFlags& flags, const Checked& checked, const Report& report, ProgressPrinter& progress,
            const Stopwatch& watch)
{
    throwIfStopped();
    progress.finish();
    deliverJson(flags.common.json, reportJson(flags, checked, report, watch.seconds()),
                outputOptions(flags.common));
    if (!flags.common.quiet && !jsonToStdout(flags.common))
        writeSummary(reportText(checked, report, watch.seconds()));
    if (report.passed()) return kDone;
    throw CheckFailed(flags.result + " differs from " + subject(report) + " of " + flags.input.path + " in " +
                      std::to_string(report.faultCount()) + " places (" + std::to_string(report.queries) +
                      " queries checked)");
}

int verifyFile(const VerifyFlags& flags, const QueryPlan& plan, const VerifyOptions& options,
               Session& session)
{
    const Stopwatch watch;
    ProgressPrinter progress(progressMode(flags.common));
    progress.begin("read", 0, 0.2);
    const PointFileOptions inputOptions = pointFileOptions(flags.input, 0, &progress);
    const QueryInput input = readQueryInput(PointFile::read(flags.input.path, inputOptions), flags.query,
                                            plan, flags.input, 0, &progress);
    const CheckedPoints candidates = checkedPoints(input.candidates, flags.input.path, inputOptions);
    SearchTerms terms;
    terms.queries = input.querySet();
    terms.candidates = input.candidateSet();
    terms.queries.view = terms.candidates.view = candidates.view;
    CheckedPoints queries;
    const std::string& queriesPath = flags.query.queries.empty() ? flags.input.path : flags.query.queries;
    terms.queryTranslation = terms.candidateTranslation = translationOf(input.candidates);
    if (input.queries) {
        queries = checkedPoints(*input.queries, queriesPath,
                                queryFileOptions(flags.query, flags.input, 0, &progress));
        terms.queries.view = queries.view;
        terms.queryTranslation = translationOf(*input.queries);
    }
    const std::string &radiusFile = flags.query.radiusFile,
                      &queriesRadiusFile = flags.query.queriesRadiusFile;
    checkRadii(input.queryRadii, queriesPath, input.queries ? queriesRadiusFile : radiusFile, flags,
               plan.radiusScale, inputOptions);
    checkRadii(input.candidateRadii, flags.input.path, radiusFile, flags, plan.radiusScale, inputOptions);
    session.path = flags.input.path;
    session.grid = flags.input.grid;
    session.otherPath = flags.result;
    Checked checked{{}, input.badRadii};
    if (!plan.hasRadii) {
        const std::optional<double> suggested =
            flags.input.radius.empty() ? input.candidates.info().suggestedRadius : std::optional<double>();
        checked.radius = chooseRadius(flags.input.radius, suggested, flags.input.path, flags.common.quiet);
    }
    terms.radius = input.radius(checked.radius.value_or(0));
    terms.nearest = plan.nearest;
    terms.byDistance = plan.byDistance;
    terms.includeSelf = plan.includeSelf;
    if (ResultFile::holdsValues(flags.result)) {
        const std::string& grid = input.queries ? flags.query.queriesGrid : flags.input.grid;
        const MeasureTask task{
            flags.result, isVdb(queriesPath) ? grid : std::string(), flags.measures, input, terms, options};
        return deliver(flags, checked, checkResult(task, {progress, 0.2, 1}), progress, watch);
    }
    checkListFlags(flags);
    const ListsFile lists = ListsFile::open(flags.result, &progress);
    progress.begin("verify", 0.2, 1);
    return deliver(flags, checked, verifyLists(terms, lists, options, &progress), progress, watch);
}

int runVerifyCommand(const VerifyFlags& flags, Session& session)
{
    VerifyOptions options;
    if (!flags.input.radius.empty()) parsePositive(flags.input.radius, "--radius");
    const QueryPlan plan = checkQueryFlags(flags.query, flags.input);
    if (!flags.sample.empty()) options.sample = parseCount(flags.sample, "--sample");
    if (options.sample && *options.sample == 0)
        throw InvalidInput("--sample: 0 queries check nothing; give 1 or more");
    options.seed = parseCount(flags.seed, "--seed");
    checkMeasureFlags(flags.measures, plan);
    ThreadLimit threads(threadCount(flags.common));
    std::vector<std::string> inputs = queryFiles(flags.query);
    inputs.insert(inputs.end(), {flags.input.path, flags.result});
    checkOutputs({}, inputs, flags.common);
    return threads.run([&] { return verifyFile(flags, plan, options, session); });
}

} // namespace

Command addVerifyCommand(CLI::App& app)
{
    CLI::App* command =
        app.add_subcommand("verify", "check lists and attributes against an independent exact search");
    const auto flags = std::make_shared<VerifyFlags>();
    command->add_option("IN", flags->input.path, "point file that was searched")
        ->required()
        ->check(notEmpty());
    command
        ->add_option(
            "RESULT", flags->result,
            "what to check: lists (.npz), points with attributes (.vdb .ply) or arrays of them (.npz)")
        ->required()
        ->check(notEmpty());
    addInputFlags(*command, flags->input, true);
    addQueryFlags(*command, flags->query);
    addMeasureFlags(*command, flags->measures, "those that the result has");
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
