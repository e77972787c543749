// Which grid of a .vdb file a caller means, and what it says of itself. Its points are read by io/vdb, without OpenVDB.
#include "io/vdb_file.h"

#include "io/array_readers.h"
#include "io/vdb/point_reader.h"
#include "io/vdb/tile_reader.h"
#include "io/vdb_layout.h"
#include "points/transform_check.h"
#include "vdb_nns/error.h"

#include <cmath>
#include <cstring>
#include <set>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

constexpr const char* kRadiusMetadata = "suggested_radius";

// Number of the entry that a caller means, by "name", or "name[n]" where a name is there several times.
std::size_t chooseEntry(const std::string& path, const std::vector<VdbEntry>& entries,
                        const std::string& wanted)
{
    std::vector<std::size_t> pointGrids, matching;
    std::string list;
    for (std::size_t i = 0; i < entries.size(); ++i) {
        if (entries[i].gridType != kVdbPointGridType) continue;
        const std::string label = gridLabel(entries[i].uniqueName);
        list += (pointGrids.empty() ? "'" : ", '") + label + "'";
        pointGrids.push_back(i);
        if (wanted == label) return i;
        if (wanted == entries[i].uniqueName.substr(0, entries[i].uniqueName.find('\x1e')))
            matching.push_back(i);
    }
    if (pointGrids.empty()) {
        throw InputError(path + ": has no point grid among its " + std::to_string(entries.size()) +
                         " grids; give a file with a PointDataGrid");
    }
    if (wanted.empty() && pointGrids.size() == 1) return pointGrids[0];
    if (!wanted.empty() && matching.size() == 1) return matching[0];
    if (wanted.empty() || matching.size() > 1) {
        throw InvalidInput(path + ": has several point grids: " + list + "; name one of them (--grid)");
    }
    throw InvalidInput(path + ": has no point grid '" + wanted + "'; its point grids are " + list);
}

template <typename Number>
double numberOf(const VdbMetadata& item)
{
    Number value;
    std::memcpy(&value, item.value.data(), sizeof value); // readMetadata() has checked the size
    return static_cast<double>(value);
}

void describe(const VdbGridHeader& header, const VdbPointLayout& layout, PointFileInfo& info)
{
    const VdbMetadata* const name = header.find("name");
    info.grid = name && name->type == "string" ? name->value : std::string();
    info.voxelSize = header.transform.voxelSize;
    const VdbMetadata* const radius = header.find(kRadiusMetadata);
    if (radius && radius->type == "double") info.suggestedRadius = numberOf<double>(*radius);
    if (radius && radius->type == "float") info.suggestedRadius = numberOf<float>(*radius);
    info.groups = vdbGroupNames(layout);
    for (std::size_t leaf = 0; leaf < layout.leaves.size(); ++leaf) {
        const VdbDescriptor& descriptor = layout.descriptor(leaf);
        if (descriptor.attributes.empty()) continue; // made, but never given points
        for (const VdbDescriptor::Attribute& attribute : descriptor.attributes) {
            info.attributes.push_back({attribute.name, attribute.valueType, attribute.codec});
            if (attribute.name == "P") info.codec = attribute.codec;
        }
        return;
    }
}

void checkTransform(const std::string& text, const VdbTransform& transform)
{
    if (!transform.isLinear) {
        throw InputError(text + "its transform (" + transform.mapType +
                         ") is not linear; resample the points to a grid with an affine transform");
    }
    if (!isInvertible(transform.linear, transform.translation)) {
        throw InputError(text +
                         "the matrix of its transform is singular or not finite, so that its points have "
                         "no place in space; repair the transform");
    }
}

} // namespace

std::vector<std::string> vdbGroupNames(const VdbPointLayout& layout)
{
    std::set<std::string> names;
    for (const VdbDescriptor& descriptor : layout.descriptors) {
        for (const auto& [name, bit] : descriptor.groups) names.insert(name);
    }
    return {names.begin(), names.end()};
}

VdbGridLayout readVdbGridLayout(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& entry)
{
    VdbCursor cursor(file, entry.gridBegin, entry.gridEnd);
    cursor.setPart(gridText(entry.uniqueName));
    VdbGridHeader header = readGridHeader(cursor);
    checkTransform(file.name() + ": " + gridText(entry.uniqueName) + ": ", header.transform);
    const VdbEntry* const parent = parentOf(file, directory, entry);
    if (parent) { // has its tree; what stands before that is its own
        if (cursor.left() > 0) cursor.fail("the end of an instance");
        cursor = VdbCursor(file, parent->gridBegin, parent->gridEnd);
        cursor.setPart(gridText(parent->uniqueName));
        if (parent->gridType != kVdbPointGridType)
            cursor.fail("points, as its instance has, not " + parent->gridType + ",");
    }
    const std::uint32_t compression = parent ? readGridHeader(cursor).compression : header.compression;
    VdbPointLayout layout = readPointLayout(cursor, compression);
    if (cursor.left() > 0) {
        cursor.fail("the end of the grid, which the directory says is byte " + std::to_string(cursor.end()) +
                    ",");
    }
    return {std::move(header), std::move(layout)};
}

VdbFile::VdbFile(const ByteSource& file, const std::string& grid, const std::optional<TileOfFile>& tile,
                 std::uint64_t allowedBytes, const CancelCheck& cancel, PointFileInfo& info)
{
    cancel.update(0);
    const VdbDirectory directory = readVdbDirectory(file);
    mChosen = chooseEntry(file.name(), directory.entries, grid);
    mGridName = directory.entries[mChosen].uniqueName;
    const std::string part = gridText(mGridName);
    const auto [header, layout] = readVdbGridLayout(file, directory, directory.entries[mChosen]);
    cancel.update(0.2);

    const VdbPointReader reader(file, layout, part);
    const VdbLeafRange all{0, layout.leaves.size()};
    GridPoints points;
    points.linear = header.transform.linear;
    points.translation = header.transform.translation;
    describe(header, layout, info);
    if (tile) {
        TileOfFile which = *tile;
        if (which.radius == 0) which.radius = info.suggestedRadius.value_or(0);
        if (!(which.radius > 0) || !std::isfinite(which.radius))
            throw InvalidInput(file.name() +
                               ": no radius: give -r RADIUS (the file suggests none that is one)");
        mTile = readTile(reader, layout, file.name(), which, allowedBytes, cancel, points);
    } else {
        checkPointsFit(file.name(), reader.pointBytes(all), allowedBytes);
        reader.readPoints(all, cancel, points);
    }
    mView = viewOf(std::move(points));
    cancel.update(1);
}

} // namespace vdb_nns
