#include "measure/measure_list.h"

#include "util/known_value.h"
#include "util/nearest_name.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <set>

namespace vdb_nns {

namespace {

const std::string kAverage = "average:";

// In the order of MeasureKind.
const std::vector<std::string>& names()
{
    static const std::vector<std::string> all = {
        "count",       "density", "mean_distance", "nearest_distance", "nearest",  kAverage,   "normal",
        "eigenvalues", "pca",     "cluster",       "cluster_size",     "isolated", "nonfinite"};
    return all;
}

InvalidInput unknownMeasure(const std::string& name)
{
    std::vector<std::string> shown = names();
    std::replace(shown.begin(), shown.end(), kAverage, kAverage + "NAME");
    const std::string nearest = nearestName(name, names());
    std::string text = "'" + shownText(name) + "' is no measure";
    if (!nearest.empty()) text += "; did you mean '" + nearest + (nearest == kAverage ? "NAME'?" : "'?");
    text += (nearest.empty() ? "; the measures are " : " The measures are ");
    for (std::size_t i = 0; i < shown.size(); ++i) text += (i ? ", " : "") + shown[i];
    return InvalidInput(text);
}

Measure measureOf(const std::string& name)
{
    const bool isAverage = name.compare(0, kAverage.size(), kAverage) == 0;
    if (isAverage && name.size() == kAverage.size())
        throw InvalidInput("'average:' lacks the name of an attribute, as in average:v");
    const auto found = std::find(names().begin(), names().end(), isAverage ? kAverage : name);
    if (found == names().end()) throw unknownMeasure(name);
    return {static_cast<MeasureKind>(found - names().begin()),
            isAverage ? name.substr(kAverage.size()) : std::string()};
}

} // namespace

const std::vector<std::string>& measureNames()
{
    return names();
}

std::vector<Measure> measuresOf(const std::vector<std::string>& given)
{
    std::vector<Measure> measures;
    std::set<std::string> seen;
    for (const std::string& name : given) {
        if (!seen.insert(name).second)
            throw InvalidInput("the measure '" + shownText(name) + "' is given twice");
        measures.push_back(measureOf(name));
    }
    return measures;
}

void checkMeasureOptions(const MeasureOptions& options)
{
    requireKnown(options.kernel, SmoothingKernel::kTophat, "smoothing kernel");
    if (!(options.mass >= 0) || !std::isfinite(options.mass))
        throw InvalidInput("a mass of " + std::to_string(options.mass) +
                           " is none: give a number that is finite and not negative");
    const PcaOptions& pca = options.pca;
    if (!(pca.anisotropy > 0 && pca.anisotropy <= 1))
        throw InvalidInput(
            "pca: an anisotropy of " + std::to_string(pca.anisotropy) +
            " is no ratio of a smaller length to a larger one: give more than 0 and at most 1");
    if (!std::isfinite(pca.stretch))
        throw InvalidInput("pca: the stretch of points without an ellipsoid is not finite");
    if (!(pca.average >= 0 && pca.average <= 1))
        throw InvalidInput("pca: positions cannot move to the mean by " + std::to_string(pca.average) +
                           ": give 0 to 1");
    if (options.minNeighbors && *options.minNeighbors == 0)
        throw InvalidInput("core points with 0 neighbors are all points: give 1 or more");
}

std::string resultName(const Measure& measure, const std::string& prefix)
{
    if (measure.kind == MeasureKind::kPca) return "stretch";
    return prefix + names()[static_cast<std::size_t>(measure.kind)] + measure.attribute;
}

const PointAttribute& averagedAttribute(const Measure& measure, const MeasureOptions& options)
{
    std::vector<std::string> others;
    for (const PointAttribute& attribute : options.attributes) {
        if (attribute.name == measure.attribute) return attribute;
        others.push_back(attribute.name);
    }
    throw InvalidInput("average:" + shownText(measure.attribute) + ": the candidates have no such attribute" +
                       insteadText(measure.attribute, others, "attributes"));
}

AttributeType averageType(const PointAttribute& attribute)
{
    switch (attribute.type) {
    case AttributeType::kInt32:
    case AttributeType::kInt64:
        return AttributeType::kFloat;
    case AttributeType::kMat3s:
        break;
    default:
        return attribute.type;
    }
    throw InvalidInput("the attribute '" + shownText(attribute.name) +
                       "' is mat3s, which has no average: give a float, double, vec3s, vec3d or integers");
}

MeasuredNames checkMeasures(const std::vector<std::string>& given, const MeasureOptions& options)
{
    checkMeasureOptions(options);
    MeasuredNames result;
    for (const Measure& measure : measuresOf(given)) {
        const std::string name = resultName(measure, options.prefix);
        const auto add = [&](AttributeType type) { result.attributes.push_back({name, type}); };
        switch (measure.kind) {
        case MeasureKind::kCount:
        case MeasureKind::kNearest:
        case MeasureKind::kCluster:
        case MeasureKind::kClusterSize:
            add(AttributeType::kInt32);
            break;
        case MeasureKind::kDensity:
        case MeasureKind::kMeanDistance:
        case MeasureKind::kNearestDistance:
            add(AttributeType::kFloat);
            break;
        case MeasureKind::kNormal:
        case MeasureKind::kEigenvalues:
            add(AttributeType::kVec3s);
            break;
        case MeasureKind::kPca:
            add(AttributeType::kVec3s);
            result.attributes.push_back({"xform", AttributeType::kMat3s});
            result.attributes.push_back({"pws", AttributeType::kVec3d});
            result.groups.push_back("ellipsoids");
            break;
        case MeasureKind::kIsolated:
        case MeasureKind::kNonfinite:
            result.groups.push_back(name);
            break;
        case MeasureKind::kAverage: {
            const auto found =
                std::find_if(options.attributes.begin(), options.attributes.end(),
                             [&](const PointAttribute& a) { return a.name == measure.attribute; });
            add(found == options.attributes.end() ? AttributeType::kFloat : averageType(*found));
            result.averaged.push_back(measure.attribute);
            break;
        }
        }
    }
    return result;
}

} // namespace vdb_nns
