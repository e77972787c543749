#include "query_options.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace vdb_nns::cli {
namespace {

struct ModeName {
    const char* name;
    RadiusMode mode;
};
constexpr ModeName kModes[] = {{"gather", RadiusMode::kGather},
                               {"scatter", RadiusMode::kScatter},
                               {"symmetric", RadiusMode::kSymmetric}};

RadiusMode parseMode(const std::string& text)
{
    for (const ModeName& known : kModes) {
        if (text == known.name) return known.mode;
    }
    throw InvalidInput("--radius-mode: '" + text + "' is not gather, scatter or symmetric");
}

std::uint32_t parseNearest(const std::string& text)
{
    if (text.empty()) return 0;
    const std::uint64_t count = parseCount(text, "--nearest");
    if (count == 0) throw InvalidInput("--nearest: of 0 neighbors no list is left; give 1 or more");
    if (count > std::numeric_limits<std::uint32_t>::max())
        throw InvalidInput("--nearest: '" + text + "' is out of range; give 1 to 4294967295");
    return static_cast<std::uint32_t>(count);
}

bool parseOrder(const std::string& text)
{
    if (text == "number" || text == "distance") return text == "distance";
    throw InvalidInput("--order: '" + text + "' is not number or distance");
}

void checkRadiusFlags(const QueryFlags& flags, const QueryPlan& plan, const InputFlags& input)
{
    const bool hasAttribute = !flags.radiusAttribute.empty();
    const std::string file = !flags.radiusFile.empty() ? "--radius-file" : "--queries-radius-file";
    const std::string source = hasAttribute ? "--radius-attribute" : file;
    if (!plan.hasRadii) {
        const char* const flag = flags.givesScale  ? "--radius-scale"
                                 : flags.givesMode ? "--radius-mode"
                                                   : nullptr;
        if (!flag) return;
        throw InvalidInput(std::string(flag) +
                           " is about radii of particles; give them by --radius-attribute or --radius-file");
    }
    if (!input.radius.empty()) {
        throw InvalidInput(
            "-r and " + source +
            " do not go together: one radius serves all, or each particle has its own; leave one out");
    }
    if (hasAttribute && (!flags.radiusFile.empty() || !flags.queriesRadiusFile.empty())) {
        throw InvalidInput("--radius-attribute and " + file +
                           " do not go together: radii come from one of the two; leave one out");
    }
    if (hasAttribute) return;
    if (!plan.hasQueries) {
        if (flags.queriesRadiusFile.empty()) return;
        throw InvalidInput(
            "--queries-radius-file belongs to the points of --queries or --queries-grid, of which "
            "there are none; give the radii by --radius-file");
    }
    const std::string mode = "--radius-mode " + flags.radiusMode + " reads the radii of ";
    if (plan.readsQueryRadii() && flags.queriesRadiusFile.empty())
        throw InvalidInput(mode + "the queries: --queries-radius-file is missing");
    if (plan.readsCandidateRadii() && flags.radiusFile.empty())
        throw InvalidInput(mode + "the candidates: --radius-file is missing");
}

// Where the points of the queries are.
const std::string& queriesPath(const QueryFlags& flags, const InputFlags& input)
{
    return flags.queries.empty() ? input.path : flags.queries;
}

// What the formats of the files offer, by their extensions.
void checkFormats(const QueryFlags& flags, const QueryPlan& plan, const InputFlags& input)
{
    const auto check = [](const std::string& flag, const std::string& path, bool isOffered,
                          const char* what) {
        if (!isOffered) throw InvalidInput(flag + ": " + path + " has no " + what);
    };
    const auto isVdb = [](const std::string& path) { return extensionOf(path) == ".vdb"; };
    const auto isNamed = [&](const std::string& path) { return isVdb(path) || extensionOf(path) == ".ply"; };
    const std::string& queries = queriesPath(flags, input);
    if (!flags.queriesGrid.empty())
        check("--queries-grid", queries, isVdb(queries), "grids; only a .vdb has");
    if (!flags.queryGroup.empty())
        check("--query-group", queries, isVdb(queries), "point groups; only a .vdb has");
    if (!flags.candidateGroup.empty())
        check("--candidate-group", input.path, isVdb(input.path), "point groups; only a .vdb has");
    if (flags.radiusAttribute.empty()) return;
    const char* const what = "named values; a .vdb and a .ply have; give the radii by --radius-file";
    if (plan.readsQueryRadii()) check("--radius-attribute", queries, isNamed(queries), what);
    if (plan.readsCandidateRadii()) check("--radius-attribute", input.path, isNamed(input.path), what);
}

// Times the scale.
std::vector<double> readRadii(const PointFile& file, const std::string& attribute, const std::string& path,
                              double scale, Progress* progress)
{
    std::vector<double> radii = attribute.empty() ? readRadiusFile(path, file.view().size(), progress)
                                                  : file.readScalars(attribute, progress);
    for (double& radius : radii) radius *= scale;
    return radii;
}

bool isBad(double radius)
{
    return !(radius > 0) || !std::isfinite(radius);
}

// isRead(i) of those whose radius counts.
template <typename IsRead>
std::uint64_t countBad(const std::vector<double>& radii, const IsRead& isRead)
{
    std::uint64_t count = 0;
    for (std::size_t i = 0; i < radii.size(); ++i) count += isBad(radii[i]) && isRead(i);
    return count;
}

bool isChosen(const std::vector<std::uint8_t>& chosen, std::size_t i)
{
    return chosen.empty() || chosen[i] != 0;
}

void readAllRadii(const QueryFlags& flags, const QueryPlan& plan, Progress* progress, QueryInput& result)
{
    const std::string& attribute = flags.radiusAttribute;
    const auto ofQueries = [&](std::size_t i) { return isChosen(result.queryChosen, i); };
    const auto ofCandidates = [&](std::size_t j) { return isChosen(result.candidateChosen, j); };
    if (plan.readsQueryRadii()) {
        const std::string& path = plan.hasQueries ? flags.queriesRadiusFile : flags.radiusFile;
        const PointFile& file = plan.hasQueries ? *result.queries : result.candidates;
        result.queryRadii = readRadii(file, attribute, path, plan.radiusScale, progress);
    }
    if (plan.readsCandidateRadii() && (plan.hasQueries || !plan.readsQueryRadii()))
        result.candidateRadii =
            readRadii(result.candidates, attribute, flags.radiusFile, plan.radiusScale, progress);
    const bool isShared = plan.readsQueryRadii() && plan.readsCandidateRadii() && !plan.hasQueries;
    if (isShared) {
        result.badRadii =
            countBad(result.queryRadii, [&](std::size_t i) { return ofQueries(i) || ofCandidates(i); });
    } else {
        result.badRadii =
            countBad(result.queryRadii, ofQueries) + countBad(result.candidateRadii, ofCandidates);
    }
}

Span<const double> spanOf(const std::vector<double>& values)
{
    return {values.data(), values.size()};
}

} // namespace

void addQueryFlags(CLI::App& app, QueryFlags& flags)
{
    const auto add = [&](const char* names, std::string& target, const char* type, const char* help) {
        return app.add_option(names, target, help)->type_name(type)->check(notEmpty());
    };
    add("--queries", flags.queries, "FILE",
        "point file whose points are the rows, while those of IN are the columns; --columns and --array "
        "count for "
        "it too if it has the format of IN");
    add("--queries-grid", flags.queriesGrid, "NAME", "point grid of --queries; alone: another grid of IN");
    add("--query-group", flags.queryGroup, "LIST",
        "point groups of a .vdb whose points have rows: those of any group but for those behind a ^, e.g. "
        "fluid,^boundary");
    add("--candidate-group", flags.candidateGroup, "LIST",
        "point groups of IN whose points are neighbors, likewise");
    add("--radius-attribute", flags.radiusAttribute, "NAME",
        "a radius for each point: an attribute of a .vdb (float or double), or a property of a .ply");
    add("--radius-file", flags.radiusFile, "FILE",
        "a radius for each point of IN: an .npy of shape (N,), float32 or float64");
    add("--queries-radius-file", flags.queriesRadiusFile, "FILE", "likewise, of the points of --queries");
    add("--radius-scale", flags.radiusScale, "S", "factor of all radii of points")
        ->capture_default_str()
        ->each([&flags](const std::string&) { flags.givesScale = true; });
    add("--radius-mode", flags.radiusMode, "MODE",
        "whose radius counts: of the query (gather), of the neighbor (scatter), or the larger one "
        "(symmetric)")
        ->check(CLI::IsMember({"gather", "scatter", "symmetric"}))
        ->capture_default_str()
        ->each([&flags](const std::string&) { flags.givesMode = true; });
    add("--nearest", flags.nearest, "K",
        "of every list the K nearest; equal distances by the smaller number; default: all");
    add("--order", flags.order, "ORDER", "order of the rows of an .npz: number, or distance")
        ->check(CLI::IsMember({"number", "distance"}))
        ->capture_default_str();
    app.add_flag("--include-self", flags.includeSelf,
                 "a query that is a candidate stands in its own list, beside the K nearest");
}

QueryPlan checkQueryFlags(const QueryFlags& flags, const InputFlags& input)
{
    QueryPlan plan;
    plan.hasQueries = !flags.queries.empty() || !flags.queriesGrid.empty();
    plan.hasRoles = plan.hasQueries || !flags.queryGroup.empty() || !flags.candidateGroup.empty();
    plan.hasRadii =
        !flags.radiusAttribute.empty() || !flags.radiusFile.empty() || !flags.queriesRadiusFile.empty();
    plan.radiusScale = parsePositive(flags.radiusScale, "--radius-scale");
    plan.mode = parseMode(flags.radiusMode);
    plan.nearest = parseNearest(flags.nearest);
    plan.byDistance = parseOrder(flags.order);
    plan.includeSelf = flags.includeSelf;
    if (plan.includeSelf && plan.hasQueries) {
        throw InvalidInput("--include-self and " +
                           std::string(flags.queries.empty() ? "--queries-grid" : "--queries") +
                           " do not go together: between two sets of points nobody is self; leave one out");
    }
    checkRadiusFlags(flags, plan, input);
    checkFormats(flags, plan, input);
    return plan;
}

DeviceFlags deviceFor(const DeviceFlags& given, const QueryPlan& plan)
{
    DeviceFlags device = given;
    if (plan.isForDevices()) return device;
    if (device.device != "auto" && device.device != "cpu") {
        throw InvalidInput("--device " + device.device +
                           ": devices search all points within one radius; queries, groups, radii of points, "
                           "--nearest and --include-self run on the CPU: use --device cpu");
    }
    device.device = "cpu";
    return device;
}

std::vector<std::string> queryFiles(const QueryFlags& flags)
{
    std::vector<std::string> files;
    for (const std::string* const file : {&flags.queries, &flags.radiusFile, &flags.queriesRadiusFile}) {
        if (!file->empty()) files.push_back(*file);
    }
    return files;
}

PointFileOptions queryFileOptions(const QueryFlags& flags, const InputFlags& input,
                                  std::uint64_t hostMemoryBytes, Progress* progress)
{
    InputFlags own = input;
    own.grid = flags.queriesGrid;
    if (extensionOf(queriesPath(flags, input)) != extensionOf(input.path))
        own.columns.clear(), own.array.clear();
    return pointFileOptions(own, hostMemoryBytes, progress);
}

ParticleSet QueryInput::querySet() const
{
    return {queries ? queries->view() : candidates.view(), {queryChosen.data(), queryChosen.size()}};
}

ParticleSet QueryInput::candidateSet() const
{
    return {candidates.view(), {candidateChosen.data(), candidateChosen.size()}};
}

Radius QueryInput::radius(double one) const
{
    Radius radius(one);
    if (!plan.hasRadii) return radius;
    radius.mode = plan.mode;
    if (plan.readsQueryRadii()) radius.ofQueries = spanOf(queryRadii);
    if (plan.readsCandidateRadii()) {
        const bool isShared = plan.readsQueryRadii() && !queries;
        radius.ofCandidates = spanOf(isShared ? queryRadii : candidateRadii);
    }
    radius.value = radius.isOne() ? 1 : 0; // of no particles at all: any radius
    return radius;
}

double QueryInput::largestRadius(double one) const
{
    double largest = plan.hasRadii ? 0 : one;
    for (const std::vector<double>* radii : {&queryRadii, &candidateRadii}) {
        for (const double r : *radii) {
            if (std::isfinite(r)) largest = std::max(largest, r);
        }
    }
    return largest;
}

QueryInput readQueryInput(PointFile candidates, const QueryFlags& flags, const QueryPlan& plan,
                          const InputFlags& input, std::uint64_t hostMemoryBytes, Progress* progress)
{
    QueryInput result;
    result.candidates = std::move(candidates);
    result.plan = plan;
    if (plan.hasQueries) {
        result.queries = PointFile::read(queriesPath(flags, input),
                                         queryFileOptions(flags, input, hostMemoryBytes, progress));
    }
    const PointFile& queries = plan.hasQueries ? *result.queries : result.candidates;
    if (!flags.queryGroup.empty()) result.queryChosen = queries.readGroups(flags.queryGroup, progress);
    if (!flags.candidateGroup.empty())
        result.candidateChosen = result.candidates.readGroups(flags.candidateGroup, progress);
    if (plan.hasRadii) readAllRadii(flags, plan, progress, result);
    return result;
}

} // namespace vdb_nns::cli
