#include "attribute_output.h"

#include "report.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstdint>
#include <utility>

namespace vdb_nns::cli {

WrittenKinds writtenKinds(const std::vector<std::string>& outputs, const std::string& rows)
{
    WrittenKinds kinds;
    for (const std::string& path : outputs) {
        const std::string extension = extensionOf(path);
        if (extension != ".npz" && extension != ".vdb" && extension != ".ply") {
            throw InvalidInput(path + ": the extension '" + extension +
                               "' is not known; use .npz for lists, .vdb or .ply for points with attributes");
        }
        kinds.npz |= extension == ".npz";
        kinds.vdb |= extension == ".vdb";
    }
    kinds.newGrid = kinds.vdb && extensionOf(rows) != ".vdb";
    return kinds;
}

bool makesNewGrid(const PointFile& points)
{
    return points.info().format != "vdb";
}

namespace {

void checkExisting(const PointFile& points, const PointValues& values)
{
    // The names of pca have no prefix.
    const auto refuse = [](const char* what, const std::string& name) {
        const bool isPca = name == "stretch" || name == "xform" || name == "pws" || name == "ellipsoids";
        throw InvalidInput(std::string("the ") + what + " '" + name + "' exists; use --force to replace it" +
                           (isPca ? "" : ", or another --prefix"));
    };
    const PointFileInfo& info = points.info();
    for (const PointAttribute& attribute : values.attributes) {
        const auto isIt = [&](const AttributeInfo& a) { return a.name == attribute.name; };
        if (std::any_of(info.attributes.begin(), info.attributes.end(), isIt))
            refuse("attribute", attribute.name);
    }
    for (const PointGroup& group : values.groups) {
        if (std::find(info.groups.begin(), info.groups.end(), group.name) != info.groups.end())
            refuse("group", group.name);
    }
}

} // namespace

void checkAttributeOutputs(const AttributeOutputs& outputs, const PointFile& points,
                           const PointValues& values, const NewGridOptions& grid, bool mayReplace,
                           Progress* progress)
{
    if (!outputs.arrays.empty()) checkValueNames(outputs.arrays, values);
    for (const std::string& path : outputs.points) {
        const bool isVdb = extensionOf(path) == ".vdb", isNew = isVdb && makesNewGrid(points);
        checkValueNames(path, values, isNew ? grid.id : std::string());
        if (isNew) checkNewVdb(path, points.view(), grid, progress);
        if (isVdb && !isNew && !mayReplace) checkExisting(points, values);
    }
}

std::uint64_t KeptOutputs::bytesEach() const
{
    std::uint64_t most = 0;
    for (const auto& each : byPath) {
        std::uint64_t bytes = each.second.groups.size();
        for (const PointAttribute& attribute : each.second.attributes)
            bytes += attributeBytes(attribute.type);
        most = std::max(most, bytes);
    }
    return most;
}

PointValues KeptOutputs::before(const std::string& path, const PointValues& measures) const
{
    const auto found = byPath.find(path);
    if (found == byPath.end()) return measures;
    PointValues values = found->second;
    values.attributes.insert(values.attributes.end(), measures.attributes.begin(), measures.attributes.end());
    values.groups.insert(values.groups.end(), measures.groups.begin(), measures.groups.end());
    return values;
}

std::vector<Conversion::Kept> KeptOutputs::kept() const
{
    std::vector<Conversion::Kept> result;
    const auto add = [&](const std::string& name, const std::string& type) {
        const auto isIt = [&](const Conversion::Kept& k) { return k.name == name && k.type == type; };
        if (std::none_of(result.begin(), result.end(), isIt)) result.push_back({name, type});
    };
    for (const auto& each : byPath) {
        for (const PointAttribute& attribute : each.second.attributes)
            add(attribute.name, attributeTypeName(attribute.type));
    }
    for (const auto& each : byPath) {
        for (const PointGroup& group : each.second.groups) add(group.name, "group");
    }
    return result;
}

namespace {

// Whether it has integers that no property of a .ply holds.
bool hasLargeIntegers(const PointAttribute& attribute)
{
    constexpr std::int64_t kMost = std::int64_t(1) << 53;
    if (attribute.type != AttributeType::kInt64) return false;
    const auto* const values = static_cast<const std::int64_t*>(attribute.values.get());
    return std::any_of(values, values + attribute.count,
                       [](std::int64_t v) { return v > kMost || v < -kMost; });
}

bool isOneOf(const std::vector<StoredValue>& list, const std::string& name, bool isGroup)
{
    return std::any_of(list.begin(), list.end(),
                       [&](const StoredValue& v) { return v.name == name && v.isGroup == isGroup; });
}

// Each once.
void addLeftOut(const Conversion::LeftOut& left, std::vector<Conversion::LeftOut>& list)
{
    const auto isIt = [&](const Conversion::LeftOut& other) {
        return other.name == left.name && other.why == left.why;
    };
    if (std::none_of(list.begin(), list.end(), isIt)) list.push_back(left);
}

// Those of the values that were chosen for a file, as far as their numbers suit it.
PointValues valuesFor(const std::string& path, const std::vector<StoredValue>& chosen,
                      const PointValues& values, bool mayLeaveOut, std::vector<Conversion::LeftOut>& leftOut)
{
    const auto named = [](const auto& list, const std::string& name) {
        return std::find_if(list.begin(), list.end(), [&](const auto& v) { return v.name == name; });
    };
    PointValues result;
    for (const StoredValue& value : chosen) {
        if (value.isGroup) {
            result.groups.push_back(*named(values.groups, value.name));
            continue;
        }
        const PointAttribute& attribute = *named(values.attributes, value.name);
        if (extensionOf(path) != ".ply" || !hasLargeIntegers(attribute)) {
            result.attributes.push_back(attribute);
            continue;
        }
        const std::string why = "has integers beyond 2^53, which a .ply cannot hold";
        if (!mayLeaveOut)
            throw InputError(path + ": '" + attribute.name + "' " + why + "; leave it out of --keep");
        addLeftOut({attribute.name, why}, leftOut);
    }
    return result;
}

} // namespace

KeptOutputs readKept(const AttributeOutputs& outputs, const PointFile& points, const std::string& keep,
                     const PointValues& measures, bool mayReplace, Progress* progress)
{
    KeptOutputs result;
    std::vector<StoredValue> all; // each once
    std::map<std::string, std::vector<StoredValue>> chosen;
    for (const std::string& path : outputs.points) {
        if (extensionOf(path) == ".vdb" && !makesNewGrid(points)) continue;
        KeptValues kept = chooseKeptValues(points, path, keep, measures, mayReplace, progress);
        for (const Conversion::LeftOut& left : kept.leftOut) addLeftOut(left, result.leftOut);
        for (const StoredValue& value : kept.values) {
            if (!isOneOf(all, value.name, value.isGroup)) all.push_back(value);
        }
        chosen[path] = std::move(kept.values);
    }
    if (all.empty()) return result;
    const PointValues values = points.readValues(all, progress);
    for (const auto& each : chosen)
        result.byPath[each.first] = valuesFor(each.first, each.second, values, keep == "all", result.leftOut);
    return result;
}

std::optional<WrittenPoints> writePoints(const std::string& path, const PointFile& points,
                                         const PointValues& values, const NewGridOptions& grid,
                                         const OutputOptions& output, Progress* progress)
{
    if (extensionOf(path) == ".ply") {
        writePly(path, points.view(), values, output, progress);
        return std::nullopt;
    }
    if (makesNewGrid(points)) return writeNewVdb(path, points.view(), values, grid, output, progress);
    points.writeVdb(path, values, output, progress);
    return std::nullopt;
}

std::vector<std::string> warningsOf(const std::string& path, const WrittenPoints& written)
{
    std::vector<std::string> warnings;
    if (written.skipped > 0) {
        warnings.push_back(path + ": " + countText(written.skipped) +
                           " points with a NaN or infinite coordinate are left out; the attribute id tells "
                           "which are there");
    }
    if (written.largestRounding > 0) {
        warnings.push_back(path + ": positions were rounded by up to " +
                           format("%.3g", written.largestRounding) +
                           " (world units), so that pairs whose distance is within " +
                           format("%.3g", 2 * written.largestRounding) +
                           " of the radius may be neighbors in one file and not in the other");
    }
    return warnings;
}

} // namespace vdb_nns::cli
