#include "measure_options.h"

#include "command_words.h"
#include "report.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <optional>
#include <utility>

namespace vdb_nns::cli {
namespace {

struct KernelName {
    const char* name;
    SmoothingKernel kernel;
};
constexpr KernelName kKernels[] = {{"cubic", SmoothingKernel::kCubic},
                                   {"wendland2", SmoothingKernel::kWendland2},
                                   {"poly6", SmoothingKernel::kPoly6},
                                   {"tophat", SmoothingKernel::kTophat}};

SmoothingKernel parseKernel(const std::string& text)
{
    for (const KernelName& known : kKernels) {
        if (text == known.name) return known.kernel;
    }
    throw InvalidInput("--kernel: '" + text + "' is not cubic, wendland2, poly6 or tophat");
}

double parseMass(const std::string& text)
{
    const double mass = parseNumber(text, "--mass");
    if (mass < 0) throw InvalidInput("--mass: '" + text + "' is negative; give 0 or more");
    return mass;
}

std::uint32_t parseNeighbors(const std::string& text, const std::string& flag, std::uint32_t least)
{
    return static_cast<std::uint32_t>(
        parseRange(text, flag, least, std::numeric_limits<std::uint32_t>::max()));
}

PcaOptions parsePca(const MeasureFlags& flags)
{
    PcaOptions pca;
    pca.anisotropy = parseNumber(flags.pcaAnisotropy, "--pca-anisotropy");
    if (!(pca.anisotropy > 0 && pca.anisotropy <= 1))
        throw InvalidInput("--pca-anisotropy: '" + flags.pcaAnisotropy +
                           "' is out of range; give a number above 0 and up to 1");
    pca.stretch = parseNumber(flags.pcaStretch, "--pca-stretch");
    pca.threshold = parseNeighbors(flags.pcaThreshold, "--pca-threshold", 0);
    pca.average = parseNumber(flags.pcaAverage, "--pca-average");
    if (!(pca.average >= 0 && pca.average <= 1))
        throw InvalidInput("--pca-average: '" + flags.pcaAverage + "' is out of range; give 0 to 1");
    return pca;
}

void checkPrefix(const std::string& prefix)
{
    const auto allowed = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == ':' || c == '|'; };
    if (std::all_of(prefix.begin(), prefix.end(), allowed)) return;
    throw InvalidInput("--prefix: '" + prefix +
                       "' has a character that attribute names may not have; use letters, digits, _ : |");
}

// Without blanks about the names.
std::vector<std::string> splitNames(const std::string& list)
{
    std::vector<std::string> names;
    if (list.empty()) return names;
    for (std::size_t begin = 0; begin <= list.size();) {
        const std::size_t end = std::min(list.find(',', begin), list.size());
        const std::size_t first = std::min(list.find_first_not_of(' ', begin), end);
        const std::size_t last = list.find_last_not_of(' ', end - 1);
        const std::string name = first < end ? list.substr(first, last + 1 - first) : std::string();
        if (name.empty())
            throw InvalidInput("--attributes: '" + list +
                               "' has an empty name; give names with commas between, e.g. count,density");
        names.push_back(name);
        begin = end + 1;
    }
    return names;
}

bool isAverage(const std::string& name)
{
    return name.compare(0, 8, "average:") == 0;
}

void checkClusters(const std::vector<std::string>& names, const QueryPlan& query)
{
    for (const std::string& name : names) {
        if (name != "cluster" && name != "cluster_size") continue;
        const std::string start = "--attributes: " + name + " does not go together with ";
        if (query.nearest > 0)
            throw InvalidInput(start + "--nearest: clusters are made of all pairs; leave one out");
        if (query.hasRoles)
            throw InvalidInput(start +
                               "queries or groups: clusters are those of one set of points, all of which ask "
                               "and are candidates; leave out " +
                               (query.hasQueries ? "--queries" : "--query-group and --candidate-group"));
    }
}

// ---- values of the candidates -------------------------------------------------------------------------------------

// What a message says that these can be.
constexpr const char* kMassTypes = "one number a point: float, double, int32 or int64";
constexpr const char* kAverageTypes = "float, double, int32, int64, vec3s and vec3d, one value a point";

// Whether a file calls its positions so, or one of their coordinates.
bool isPosition(const PointFileInfo& info, const std::string& name)
{
    if (info.format == "vdb") return name == "P";
    if (info.format == "ply") return name == "x" || name == "y" || name == "z";
    return info.format == "npz" && name == "positions";
}

// `flag` begins messages.
[[noreturn]] void failMissing(const PointFile& file, const std::vector<StoredValue>& list,
                              const std::string& name, const std::string& flag)
{
    const PointFileInfo& info = file.info();
    if (isPosition(info, name)) {
        const bool isMass = flag == "--mass-attribute";
        throw InvalidInput(flag + ": " + info.path + ": '" + name + "' is the position, which is no " +
                           (isMass
                                ? std::string("mass; masses are ") + kMassTypes
                                : std::string("attribute to average; averages are made of ") + kAverageTypes +
                                      ". The weighted mean of the positions is pws of pca with "
                                      "--pca-average 1"));
    }
    if (info.format == "vdb" || info.format == "ply")
        file.readScalars(name); // whose message knows the nearest name
    if (list.empty())
        throw InvalidInput(flag + ": " + info.path + " has no values named '" + name +
                           "'; a .vdb, a .ply and an .npz may have such values");
    std::string all;
    std::vector<std::string> names;
    for (const StoredValue& value : list) {
        all += (all.empty() ? "'" : ", '") + value.name + "'";
        names.push_back(value.name);
    }
    const std::string nearest = nearestName(name, names);
    throw InvalidInput(flag + ": " + info.path + " has no values named '" + name + "'; " +
                       (nearest.empty() ? "it has " : "did you mean '" + nearest + "'? It has ") + all);
}

// An attribute rather than a group of that name.
StoredValue findValue(const PointFile& file, const std::vector<StoredValue>& list, const std::string& name,
                      const std::string& flag)
{
    const StoredValue* group = nullptr;
    for (const StoredValue& value : list) {
        if (value.name != name) continue;
        if (!value.isGroup) return value;
        group = &value;
    }
    if (!group) failMissing(file, list, name, flag);
    return *group;
}

bool isScalar(AttributeType type)
{
    return attributeWidth(type) == 1;
}

template <typename T>
std::vector<double> asDoubles(const PointAttribute& attribute)
{
    const T* const values = static_cast<const T*>(attribute.values.get());
    std::vector<double> result(attribute.count);
    std::transform(values, values + attribute.count, result.begin(),
                   [](T value) { return static_cast<double>(value); });
    return result;
}

std::vector<double> asDoubles(const PointAttribute& attribute)
{
    switch (attribute.type) {
    case AttributeType::kFloat:
        return asDoubles<float>(attribute);
    case AttributeType::kInt32:
        return asDoubles<std::int32_t>(attribute);
    case AttributeType::kInt64:
        return asDoubles<std::int64_t>(attribute);
    default:
        return asDoubles<double>(attribute);
    }
}

void checkMasses(const PointFile& file, const std::string& name, const std::vector<double>& masses)
{
    const auto isBad = [](double mass) { return !(mass >= 0 && std::isfinite(mass)); };
    const auto first = std::find_if(masses.begin(), masses.end(), isBad);
    if (first == masses.end()) return;
    const auto count = static_cast<std::uint64_t>(std::count_if(first, masses.end(), isBad));
    throw InputError("--mass-attribute: " + file.info().path + ": '" + name + "' of point " +
                     std::to_string(first - masses.begin()) + " is " + shortest(*first) + ", and " +
                     countText(count) + " of " + countText(masses.size()) +
                     " masses are negative, NaN or infinite; masses are 0 or more");
}

std::vector<double> readMasses(const PointFile& file, const std::vector<StoredValue>& list,
                               const std::string& name, Progress* progress)
{
    const StoredValue value = findValue(file, list, name, "--mass-attribute");
    if (value.isGroup || !value.readAs || !isScalar(*value.readAs)) {
        throw InputError("--mass-attribute: " + file.info().path + ": '" + name + "' has type " + value.type +
                         "; masses are " + kMassTypes);
    }
    std::vector<double> masses = asDoubles(file.readValues({value}, progress).attributes.at(0));
    checkMasses(file, name, masses);
    return masses;
}

std::vector<PointAttribute> readAveraged(const PointFile& file, const std::vector<StoredValue>& list,
                                         const std::vector<std::string>& names, Progress* progress)
{
    std::vector<StoredValue> chosen;
    for (const std::string& name : names) {
        const StoredValue value = findValue(file, list, name, "--attributes average:" + name);
        if (value.isGroup || !value.readAs || *value.readAs == AttributeType::kMat3s) {
            throw InputError("--attributes average:" + name + ": " + file.info().path + ": '" + name +
                             "' has type " + value.type + "; averages are made of " + kAverageTypes);
        }
        chosen.push_back(value);
    }
    return file.readValues(chosen, progress).attributes;
}

} // namespace

const char* kernelName(SmoothingKernel kernel)
{
    return std::find_if(std::begin(kKernels), std::end(kKernels),
                        [&](const KernelName& known) { return known.kernel == kernel; })
        ->name;
}

void addMeasureFlags(CLI::App& app, MeasureFlags& flags, const std::string& without)
{
    const auto add = [&](const std::string& name, std::string& target, const char* type,
                         const std::string& help) {
        return app.add_option(name, target, help)->type_name(type)->check(notEmpty());
    };
    const auto addDefault = [&](const std::string& name, std::string& target, const char* type,
                                const std::string& help) {
        return add(name, target, type, help)->capture_default_str()->each([&flags, name](const std::string&) {
            flags.given.push_back(name);
        });
    };
    std::string names;
    for (const std::string& name : measureNames())
        names += (names.empty() ? "" : ", ") + name + (name.back() == ':' ? "NAME" : "");
    CLI::Option* const attributes =
        app.add_option("--attributes", flags.attributes,
                       "measures, which become attributes, separated by commas: " + names +
                           (without.empty() ? "" : "; default: " + without))
            ->type_name("LIST")
            ->check(notEmpty());
    if (!flags.attributes.empty()) attributes->capture_default_str();
    app.add_option("--prefix", flags.prefix, "prefix of the attributes' names, but for those of pca")
        ->type_name("P")
        ->capture_default_str();
    addDefault(
        "--kernel", flags.kernel, "NAME",
        "weight of a neighbor by its distance: cubic, wendland2, poly6 or tophat; of density, average, "
        "normal and eigenvalues")
        ->check(CLI::IsMember({"cubic", "wendland2", "poly6", "tophat"}));
    addDefault("--mass", flags.mass, "M", "mass of every point, for density");
    add("--mass-attribute", flags.massAttribute, "NAME",
        "a mass for each point of IN, for density: an attribute of a .vdb, a property of a .ply or an array "
        "of an .npz");
    add("--min-neighbors", flags.minNeighbors, "K",
        "clusters are those of DBSCAN, whose core points have K neighbors or more, themselves not counted; "
        "default: whatever is connected");
    addDefault("--pca-anisotropy", flags.pcaAnisotropy, "A",
               "the least ratio of two principal lengths of pca, above 0 and up to 1");
    addDefault("--pca-stretch", flags.pcaStretch, "S",
               "stretch that pca gives points with too few neighbors");
    addDefault("--pca-threshold", flags.pcaThreshold, "N",
               "neighbors, the point itself counted, from which on pca makes an ellipsoid; 0: never");
    addDefault("--pca-average", flags.pcaAverage, "A",
               "how far pca moves points to the mean of their neighbors, 0 to 1");
}

void checkMeasureUse(const MeasureFlags& flags, const std::vector<std::string>& names)
{
    const auto isAsked = [&](const char* name) {
        return std::find(names.begin(), names.end(), name) != names.end();
    };
    const auto check = [](const std::string& flag, bool isUsed, const char* measures) {
        if (isUsed) return;
        throw InvalidInput(flag + " is about " + measures +
                           "; ask for such a measure by --attributes, or leave the flag out");
    };
    const bool weighs = isAsked("density") || isAsked("normal") || isAsked("eigenvalues") ||
                        std::any_of(names.begin(), names.end(), isAverage);
    for (const std::string& flag : flags.given) {
        if (flag == "--kernel") check(flag, weighs, "density, average, normal and eigenvalues");
        if (flag == "--mass") check(flag, isAsked("density"), "density");
        if (flag.compare(0, 6, "--pca-") == 0) check(flag, isAsked("pca"), "pca");
    }
    if (!flags.massAttribute.empty()) check("--mass-attribute", isAsked("density"), "density");
    if (!flags.minNeighbors.empty())
        check("--min-neighbors", isAsked("cluster") || isAsked("cluster_size"), "cluster and cluster_size");
}

MeasurePlan checkMeasureFlags(const MeasureFlags& flags, const QueryPlan& query)
{
    return checkMeasureFlags(flags, splitNames(flags.attributes), query);
}

MeasurePlan checkMeasureFlags(const MeasureFlags& flags, const std::vector<std::string>& names,
                              const QueryPlan& query)
{
    MeasurePlan plan;
    plan.names = names;
    checkPrefix(flags.prefix);
    plan.prefix = plan.options.prefix = flags.prefix;
    plan.options.kernel = parseKernel(flags.kernel);
    plan.options.mass = parseMass(flags.mass);
    plan.options.pca = parsePca(flags);
    if (!flags.minNeighbors.empty())
        plan.options.minNeighbors = parseNeighbors(flags.minNeighbors, "--min-neighbors", 1);
    plan.massAttribute = flags.massAttribute;
    const bool givesMass = std::find(flags.given.begin(), flags.given.end(), "--mass") != flags.given.end();
    if (givesMass && !flags.massAttribute.empty())
        throw InvalidInput("--mass and --mass-attribute do not go together: one mass serves all, or each "
                           "point has its own; leave one out");
    if (names.empty()) return plan;
    plan.results = checkMeasures(names, plan.options);
    checkMeasureUse(flags, names);
    checkClusters(names, query);
    return plan;
}

MeasureInput readMeasureInput(const PointFile& candidates, const MeasurePlan& plan, Progress* progress)
{
    MeasureInput input;
    if (plan.massAttribute.empty() && plan.results.averaged.empty()) return input;
    const std::vector<StoredValue> list = candidates.listValues(progress);
    if (!plan.massAttribute.empty())
        input.masses = readMasses(candidates, list, plan.massAttribute, progress);
    input.averaged = readAveraged(candidates, list, plan.results.averaged, progress);
    return input;
}

MeasureOptions optionsOf(const MeasurePlan& plan, const MeasureInput& input)
{
    MeasureOptions options = plan.options;
    options.masses = {input.masses.data(), input.masses.size()};
    options.attributes = input.averaged;
    return options;
}

} // namespace vdb_nns::cli
