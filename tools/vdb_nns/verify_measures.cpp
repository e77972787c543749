#include "verify_measures.h"

#include "report.h"
#include "vdb_nns/error.h"
#include "verify/result_file.h"

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

using Json = nlohmann::ordered_json;

// The measures of which any value is in the result. Averages are those of the attributes of IN that are there under their names.
std::vector<std::string> measuresOf(const ResultFile& result, const MeasureTask& task, Progress* progress)
{
    MeasureOptions options;
    options.prefix = task.flags.prefix;
    std::vector<std::string> found;
    for (const std::string& name : measureNames()) {
        if (name.back() != ':') {
            if (result.hasAny(checkMeasures({name}, options))) found.push_back(name);
            continue;
        }
        std::vector<std::string> attributes;
        for (const StoredValue& value : task.input.candidates.listValues(progress))
            attributes.push_back(value.name);
        for (const std::string& of : result.namesBehind(task.flags.prefix + name, attributes))
            found.push_back(name + of);
    }
    if (!found.empty() || result.isEmpty()) return found;
    throw InvalidInput(task.result + ": has no attribute of a measure: none begins with '" +
                       task.flags.prefix + "' and the name of one (--prefix), and there are none of pca");
}

} // namespace

MeasureReport checkResult(const MeasureTask& task, const ProgressSpan& span)
{
    Progress* const progress = &span.printer;
    const double read = span.begin + 0.1 * (span.end - span.begin); // a rough share, for progress only
    span.printer.begin("read", span.begin, read);
    const ResultFile result(task.result, task.grid, progress);
    const QueryPlan& query = task.input.plan;
    const MeasurePlan plan = task.flags.attributes.empty()
                                 ? checkMeasureFlags(task.flags, measuresOf(result, task, progress), query)
                                 : checkMeasureFlags(task.flags, query);
    const MeasureInput input = readMeasureInput(task.input.candidates, plan, progress);
    MeasureClaims claims;
    claims.path = task.result;
    claims.names = plan.names;
    claims.options = optionsOf(plan, input);
    claims.values = result.read(checkMeasures(plan.names, claims.options), progress);
    const PointFile& queries = task.input.queries ? *task.input.queries : task.input.candidates;
    const std::vector<std::uint32_t> places = result.placesOf(queries, progress);
    if (!places.empty()) {
        claims.values = placedValues(claims.values, places);
        for (const std::uint32_t place : places) claims.isThere.push_back(place != ~std::uint32_t(0));
    }
    span.printer.begin("verify", read, span.end);
    return verifyMeasures(task.terms, claims, task.options, progress);
}

Json faultsJson(const MeasureReport& report)
{
    Json faults = Json::object();
    for (const ValueFinding& finding : report.findings) {
        Json examples = Json::array();
        for (const ValueExample& example : finding.examples) {
            Json one = {{"query", example.query},
                        {"component", example.component},
                        {"value", example.value},
                        {"expected", example.expected},
                        {"bound", example.bound}};
            if (!example.what.empty()) one["what"] = example.what;
            examples.push_back(std::move(one));
        }
        faults[finding.name] = {{"count", finding.count},
                                {"checked", finding.checked},
                                {"undetermined", finding.undetermined},
                                {"examples", std::move(examples)}};
    }
    return faults;
}

std::string faultsText(const MeasureReport& report)
{
    std::string text;
    for (const ValueFinding& finding : report.findings) {
        text += format("  %-16s %llu wrong of %llu", finding.name.c_str(),
                       static_cast<unsigned long long>(finding.count),
                       static_cast<unsigned long long>(finding.checked));
        if (finding.undetermined > 0)
            text += format(", %llu not determined", static_cast<unsigned long long>(finding.undetermined));
        text += "\n";
        for (const ValueExample& example : finding.examples) {
            text += format("    %llu", static_cast<unsigned long long>(example.query));
            if (example.component > 0) text += format("[%zu]", example.component);
            text += ": " + shortest(example.value);
            if (!example.what.empty()) text += " " + example.what;
            if (!std::isnan(example.expected)) text += ", expected " + shortest(example.expected);
            if (example.bound > 0) text += format(" within %.2g", example.bound);
            text += "\n";
        }
    }
    return text;
}

} // namespace vdb_nns::cli
