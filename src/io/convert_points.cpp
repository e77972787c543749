// From one point file to another: what comes along is chosen before it is read.
#include "io/value_names.h"
#include "util/nearest_name.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"
#include "vdb_nns/write_points.h"

#include <algorithm>
#include <cctype>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

struct FormatName {
    const char* extension;
    PointFormat format;
};
constexpr FormatName kFormats[] = {{"vdb", PointFormat::kVdb},
                                   {"ply", PointFormat::kPly},
                                   {"npz", PointFormat::kNpz},
                                   {"npy", PointFormat::kNpy}};

const FormatName& formatOf(const std::string& path)
{
    const std::size_t dot = path.find_last_of("./");
    std::string extension;
    const bool hasStem = dot != std::string::npos && dot > 0 && path[dot - 1] != '/';
    if (hasStem && path[dot] == '.') extension = path.substr(dot + 1);
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    for (const FormatName& known : kFormats) {
        if (extension == known.extension) return known;
    }
    throw InvalidInput(path + ": the extension '" + shownText(extension) +
                       "' is not known; points are written as .vdb .ply .npz .npy");
}

// What a file calls its values.
std::string valuesText(const std::string& format)
{
    if (format == "vdb") return "attributes and groups";
    if (format == "ply") return "properties beside x, y and z";
    if (format == "npz") return "arrays beside the positions";
    return "values beside the positions that are read";
}

std::vector<std::string> namesOf(const std::string& list)
{
    std::vector<std::string> names;
    for (std::size_t begin = 0; begin <= list.size();) {
        const std::size_t end = std::min(list.find(',', begin), list.size());
        const std::string name = list.substr(begin, end - begin);
        begin = end + 1;
        const std::size_t first = name.find_first_not_of(" \t");
        if (first == std::string::npos)
            throw InvalidInput("the values to keep, '" + shownText(list) +
                               "', have an empty name; give all, none, or names with commas between");
        names.push_back(name.substr(first, name.find_last_not_of(" \t") - first + 1));
    }
    return names;
}

// Whether each value is asked for by name.
std::vector<bool> namedValues(const PointFile& file, const std::vector<StoredValue>& list,
                              const std::string& keep)
{
    std::vector<bool> isNamed(list.size());
    std::vector<std::string> known;
    for (const StoredValue& value : list) known.push_back(value.name);
    for (const std::string& name : namesOf(keep)) {
        bool isThere = false;
        for (std::size_t i = 0; i < list.size(); ++i) {
            if (list[i].name != name) continue;
            isThere = isNamed[i] = true;
        }
        if (isThere) continue;
        const std::string what = valuesText(file.info().format);
        throw InvalidInput(file.info().path + ": has nothing named '" + shownText(name) +
                           "' to be kept (--keep)" + insteadText(name, known, what));
    }
    return isNamed;
}

// Hears whether to stop, and tells of no progress: that of reading several values would begin again with each.
class StopOnly final : public Progress {
public:
    explicit StopOnly(Progress* progress) : mProgress(progress) {}

    void update(const char*, double) override {}
    bool cancelled() const override { return mProgress && mProgress->cancelled(); }

private:
    Progress* mProgress;
};

// Whether files of the format have further values that are not read.
bool hasUnreadValues(const std::string& format)
{
    return format == "vtk" || format == "bgeo";
}

// The attribute of a .vdb that gets the points' numbers.
std::string idOf(PointFormat format)
{
    return format == PointFormat::kVdb ? NewGridOptions().id : std::string();
}

WrittenPoints write(PointFormat format, const PointFile& file, const std::string& path,
                    const PointValues& values, const ConvertOptions& options, const OutputOptions& output,
                    Progress* progress)
{
    switch (format) {
    case PointFormat::kVdb: {
        NewGridOptions grid;
        grid.voxelSize = options.voxelSize;
        grid.suggestedRadius = file.info().suggestedRadius;
        return writeNewVdb(path, file.view(), values, grid, output, progress);
    }
    case PointFormat::kPly:
        return writePly(path, file.view(), values, output, progress);
    case PointFormat::kNpz:
        return writePointsNpz(path, file.view(), values, output, progress);
    case PointFormat::kNpy:
        return writePointsNpy(path, file.view(), output, progress);
    }
    return {};
}

} // namespace

void checkConversion(const std::string& path, const ConvertOptions& options)
{
    if (formatOf(path).format != PointFormat::kVdb && options.voxelSize != 0)
        throw InvalidInput(path + ": only a .vdb has voxels; leave the voxel size (--voxel-size) out");
}

void checkValueNames(const std::string& path, const PointValues& values, const std::string& id)
{
    ValueNames(formatOf(path).format, id, /*hasPositions=*/false).addAll(path, values);
}

KeptValues chooseKeptValues(const PointFile& file, const std::string& path, const std::string& keep,
                            const PointValues& others, bool mayReplace, Progress* progress)
{
    const PointFormat format = formatOf(path).format;
    KeptValues result;
    if (keep == "none") return result;
    ValueNames names(format, idOf(format)), namesBesides = names;
    namesBesides.addAll(path, others);
    const std::vector<StoredValue> list = file.listValues(progress);
    const bool isAll = keep == "all";
    const std::vector<bool> isNamed = isAll ? std::vector<bool>(list.size()) : namedValues(file, list, keep);
    for (std::size_t i = 0; i < list.size(); ++i) {
        const StoredValue& value = list[i];
        if (!isAll && !isNamed[i]) continue;
        const std::string subject = file.info().path + ": '" + shownText(value.name) + "' ";
        if (!value.problem.empty() && !isAll) throw InputError(subject + value.problem);
        std::string problem = value.problem;
        if (problem.empty()) problem = names.add(value.name, value.readAs);
        if (problem.empty()) {
            if (namesBesides.add(value.name, value.readAs).empty()) {
                result.values.push_back(value);
            } else if (!mayReplace) {
                throw InvalidInput(
                    subject + "exists, and " + path +
                    " is to get another value of that name; use --force to replace it, another "
                    "--prefix, or leave it out of --keep");
            }
        } else if (isAll) {
            result.leftOut.push_back({value.name, problem});
        } else {
            throw InvalidInput(subject + problem + "; leave it out of --keep");
        }
    }
    if (hasUnreadValues(file.info().format))
        result.leftOut.push_back(
            {"what the ." + file.info().format + " holds beside positions", "is not read"});
    return result;
}

Conversion convertPoints(const PointFile& file, const std::string& path, const ConvertOptions& options,
                         const OutputOptions& output, Progress* progress)
{
    checkConversion(path, options);
    const FormatName& target = formatOf(path);
    Conversion result;
    result.format = target.extension;
    result.hasId = !idOf(target.format).empty();
    StopOnly reading(progress);
    KeptValues kept = chooseKeptValues(file, path, options.keep, {}, false, &reading);
    result.leftOut = std::move(kept.leftOut);
    const PointValues values = file.readValues(kept.values, &reading);
    for (const PointAttribute& attribute : values.attributes)
        result.kept.push_back({attribute.name, attributeTypeName(attribute.type)});
    for (const PointGroup& group : values.groups) result.kept.push_back({group.name, "group"});
    result.written = write(target.format, file, path, values, options, output, progress);
    return result;
}

} // namespace vdb_nns
