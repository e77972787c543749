#include "attribute_output.h"

#include "report.h"
#include "vdb_nns/error.h"

#include <algorithm>

namespace vdb_nns::cli {

WrittenKinds writtenKinds(const std::vector<std::string>& outputs)
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
