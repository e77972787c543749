#include "measure_claims.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <string>
#include <utility>

namespace vdb_nns::cli {

namespace {

const std::string kAverage = "average:";

template <typename Found>
auto findNamed(const std::vector<Found>& values, const std::string& name)
{
    return std::find_if(values.begin(), values.end(), [&](const Found& v) { return v.name == name; });
}

// The type of what an average is made of values of that type.
AttributeType averageType(AttributeType type)
{
    return type == AttributeType::kInt32 || type == AttributeType::kInt64 ? AttributeType::kFloat : type;
}

struct MeasureName {
    const char* name;
    Measure measure;
    AttributeType type; // of those that are one attribute
};
constexpr MeasureName kMeasures[] = {{"count", Measure::kCount, AttributeType::kInt32},
                                     {"density", Measure::kDensity, AttributeType::kFloat},
                                     {"mean_distance", Measure::kMeanDistance, AttributeType::kFloat},
                                     {"nearest_distance", Measure::kNearestDistance, AttributeType::kFloat},
                                     {"nearest", Measure::kNearest, AttributeType::kInt32},
                                     {"normal", Measure::kNormal, AttributeType::kVec3s},
                                     {"eigenvalues", Measure::kEigenvalues, AttributeType::kVec3s},
                                     {"pca", Measure::kPca, {}},
                                     {"cluster", Measure::kCluster, AttributeType::kInt32},
                                     {"cluster_size", Measure::kClusterSize, AttributeType::kInt32},
                                     {"isolated", Measure::kIsolated, {}},
                                     {"nonfinite", Measure::kNonfinite, {}}};

class ClaimReader {
public:
    ClaimReader(const MeasureClaims& claims, std::uint64_t queries, std::uint64_t candidates)
        : mClaims(claims), mQueries(queries), mCandidates(candidates)
    {
    }

    std::vector<Claim> read(std::vector<ValueFinding>& findings) const
    {
        std::vector<Claim> result;
        for (const std::string& name : mClaims.names) {
            Claim claim;
            claim.finding = findings.size();
            if (name.compare(0, kAverage.size(), kAverage) == 0) {
                readAverage(name, claim);
            } else {
                readNamed(name, claim);
            }
            if (claim.measure == Measure::kPca) {
                for (const char* part : {"stretch", "xform", "pws", "ellipsoids"})
                    findings.push_back({part, 0, 0, 0, {}});
            } else {
                findings.push_back({name, 0, 0, 0, {}});
            }
            result.push_back(std::move(claim));
        }
        return result;
    }

private:
    void readAverage(const std::string& name, Claim& claim) const
    {
        const std::string of = name.substr(kAverage.size());
        const auto source = findNamed(mClaims.options.attributes, of);
        if (source == mClaims.options.attributes.end())
            throw InvalidInput("verify: the values of '" + of +
                               "', of which averages are checked, are missing");
        claim.measure = Measure::kAverage;
        claim.source = *source;
        claim.attribute = attribute(mClaims.options.prefix + name, averageType(source->type));
    }

    void readNamed(const std::string& name, Claim& claim) const
    {
        const auto* const known = std::find_if(std::begin(kMeasures), std::end(kMeasures),
                                               [&](const MeasureName& m) { return name == m.name; });
        if (known == std::end(kMeasures)) throw InvalidInput("verify: '" + name + "' is no measure");
        claim.measure = known->measure;
        const std::string inFile = mClaims.options.prefix + name;
        switch (known->measure) {
        case Measure::kPca:
            claim.attribute = attribute("stretch", AttributeType::kVec3s);
            claim.xform = attribute("xform", AttributeType::kMat3s);
            claim.position = attribute("pws", AttributeType::kVec3d);
            claim.group = group("ellipsoids");
            break;
        case Measure::kIsolated:
        case Measure::kNonfinite:
            claim.group = group(inFile);
            break;
        case Measure::kNearest:
        case Measure::kCluster:
        case Measure::kClusterSize: {
            const bool isLarge = mCandidates > std::uint64_t(std::numeric_limits<std::int32_t>::max());
            claim.attribute = attribute(inFile, isLarge ? AttributeType::kInt64 : AttributeType::kInt32);
            break;
        }
        default:
            claim.attribute = attribute(inFile, known->type);
        }
    }

    PointAttribute attribute(const std::string& name, AttributeType type) const
    {
        const auto found = findNamed(mClaims.values.attributes, name);
        if (mQueries == 0) return {name, type, 0, {}}; // a .vdb without points has no attributes
        if (found == mClaims.values.attributes.end())
            throw InvalidInput(mClaims.path + ": has no attribute '" + name + "', which is to be checked");
        if (found->type != type)
            throw InputError(mClaims.path + ": '" + name + "' has type " + attributeTypeName(found->type) +
                             "; expected is " + attributeTypeName(type));
        checkCount(name, found->count);
        return *found;
    }

    PointGroup group(const std::string& name) const
    {
        const auto found = findNamed(mClaims.values.groups, name);
        if (mQueries == 0) return {name, 0, {}};
        if (found == mClaims.values.groups.end())
            throw InvalidInput(mClaims.path + ": has no group '" + name + "', which is to be checked");
        checkCount(name, found->count);
        return *found;
    }

    void checkCount(const std::string& name, std::uint64_t count) const
    {
        if (count == mQueries) return;
        throw InputError(mClaims.path + ": '" + name + "' has " + std::to_string(count) +
                         " values, but there are " + std::to_string(mQueries) +
                         " points; are these the attributes of this file?");
    }

    const MeasureClaims& mClaims;
    std::uint64_t mQueries, mCandidates;
};

} // namespace

std::vector<Claim> readClaims(const MeasureClaims& claims, std::uint64_t queries, std::uint64_t candidates,
                              std::vector<ValueFinding>& findings)
{
    return ClaimReader(claims, queries, candidates).read(findings);
}

double numberAt(const PointAttribute& attribute, std::uint64_t i, std::size_t component)
{
    const std::size_t at = static_cast<std::size_t>(i) * attributeWidth(attribute.type) + component;
    const void* const values = attribute.values.get();
    switch (attribute.type) {
    case AttributeType::kInt32:
        return static_cast<const std::int32_t*>(values)[at];
    case AttributeType::kInt64: // the integers that measures have are exact
        return static_cast<double>(static_cast<const std::int64_t*>(values)[at]);
    case AttributeType::kDouble:
    case AttributeType::kVec3d:
        return static_cast<const double*>(values)[at];
    default:
        return static_cast<double>(static_cast<const float*>(values)[at]);
    }
}

} // namespace vdb_nns::cli
