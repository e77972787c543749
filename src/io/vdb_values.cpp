// What the points of a .vdb have beside their positions, read from the file that is opened again.
#include "io/group_list.h"
#include "io/vdb/point_reader.h"
#include "io/vdb_file.h"
#include "io/vdb_layout.h"
#include "points/particle_source.h"
#include "util/nearest_name.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

namespace vdb_nns {

namespace {

bool isGroupArray(const VdbDescriptor::Attribute& attribute)
{
    return attribute.codec == "grp";
}

// Of all leaves but for what holds groups, in the order of the file.
std::vector<std::string> attributeNames(const VdbPointLayout& layout)
{
    std::vector<std::string> names;
    std::set<std::string> known;
    for (const VdbDescriptor& descriptor : layout.descriptors) {
        for (const VdbDescriptor::Attribute& attribute : descriptor.attributes) {
            if (!isGroupArray(attribute) && known.insert(attribute.name).second)
                names.push_back(attribute.name);
        }
    }
    return names;
}

// In words of a user.
std::string typeText(const VdbDescriptor::Attribute& attribute)
{
    if (attribute.codec == "str") return "string";
    if (isGroupArray(attribute)) return "group";
    return escapedText(attribute.valueType) +
           (attribute.codec == "null" ? "" : " with codec " + escapedText(attribute.codec));
}

// An attribute of that name is there, and holds reals wherever it is. `text` begins messages.
void checkScalar(const std::string& text, const VdbPointLayout& layout, const std::string& name)
{
    bool isThere = false;
    for (const VdbDescriptor& descriptor : layout.descriptors) {
        const std::size_t place = descriptor.find(name);
        if (place == VdbDescriptor::kNone) continue;
        isThere = true;
        const VdbDescriptor::Attribute& attribute = descriptor.attributes[place];
        if (attribute.valueType == "float" || attribute.valueType == "double") continue;
        throw InputError(text + "attribute '" + shownText(name) + "' has type " + typeText(attribute) +
                         "; expected is float or double, one number a point");
    }
    if (isThere) return;
    throw InvalidInput(text + "has no attribute '" + shownText(name) + "'" +
                       insteadText(name, attributeNames(layout), "attributes"));
}

// The type that values of an attribute are read as; empty where none holds them.
std::optional<AttributeType> readableType(const VdbDescriptor::Attribute& attribute)
{
    const VdbAttributeType& type = attribute.type;
    if (!type.isKnown || type.codec == VdbCodec::kUnitVector) return std::nullopt;
    const std::size_t width = type.components;
    switch (type.scalar) {
    case VdbScalar::kFloat:
        if (width == 1) return AttributeType::kFloat;
        if (width == 3) return AttributeType::kVec3s;
        if (width == 9) return AttributeType::kMat3s;
        return std::nullopt;
    case VdbScalar::kDouble:
        if (width == 1) return AttributeType::kDouble;
        if (width == 3) return AttributeType::kVec3d;
        return std::nullopt;
    case VdbScalar::kBool:
    case VdbScalar::kInt8:
    case VdbScalar::kInt16:
    case VdbScalar::kInt32:
        if (width == 1) return AttributeType::kInt32;
        return std::nullopt;
    case VdbScalar::kInt64:
        if (width == 1) return AttributeType::kInt64;
        return std::nullopt;
    case VdbScalar::kUint8:
    case VdbScalar::kUint32:
        return std::nullopt; // groups and texts
    }
    return std::nullopt;
}

// Why the values of a leaf's attribute cannot be read together with those of the leaves before, which are read as `before`.
std::string problemOf(const VdbDescriptor::Attribute& attribute, const VdbArray& array,
                      const std::optional<AttributeType>& before)
{
    const std::optional<AttributeType> type = readableType(attribute);
    if (!type)
        return "has type " + typeText(attribute) +
               ", which is none of float, double, int32, int64, vec3s, vec3d and mat3s";
    if (before && *before != *type) return "has not the same type in all leaves";
    if (!array.hasConstantStride || array.stride != 1) return "has several values a point";
    return {};
}

// Smaller integers as int32.
template <typename Number>
void widen(const VdbValues& from, std::int32_t* out)
{
    const Number* const numbers = static_cast<const Number*>(from.bytes.data());
    std::copy(numbers, numbers + from.count, out);
}

PointAttribute attributeOf(const StoredValue& which, VdbValues&& values, std::size_t points)
{
    const AttributeType type = *which.readAs;
    PageBlock block;
    const std::size_t bytes = points * attributeBytes(type);
    const bool isWhole = values.type.isKnown && values.type.bytes() == attributeBytes(type);
    if (isWhole) {
        block = std::move(values.bytes);
    } else if (bytes > 0) {
        block = PageBlock(bytes); // zeros, where no leaf with points has the attribute
        auto* const out = static_cast<std::int32_t*>(block.data());
        if (values.type.isKnown && values.type.scalar == VdbScalar::kInt16) widen<std::int16_t>(values, out);
        if (values.type.isKnown && values.type.scalar == VdbScalar::kInt8) widen<std::int8_t>(values, out);
        if (values.type.isKnown && values.type.scalar == VdbScalar::kBool) widen<std::uint8_t>(values, out);
    }
    const auto owner = std::make_shared<PageBlock>(std::move(block));
    return {which.name, type, points, std::shared_ptr<const void>(owner, owner->data())};
}

void checkFits(const std::string& path, std::uint64_t neededBytes, std::uint64_t allowedBytes)
{
    if (neededBytes <= allowedBytes) return;
    throw CapacityError(path + ": values of its points need " + std::to_string(neededBytes) +
                            " bytes of memory to be read, allowed are " + std::to_string(allowedBytes) +
                            ": split the file, or use a machine with more memory",
                        neededBytes, allowedBytes);
}

// The array of a leaf that holds a group, and its bit there.
struct GroupPlace {
    std::string array;
    unsigned bit = 0;
};

// Empty where the leaves of the descriptor have no such group.
GroupPlace placeOf(const std::string& text, const VdbDescriptor& descriptor, const std::string& group)
{
    const auto found = descriptor.groups.find(group);
    if (found == descriptor.groups.end()) return {};
    std::uint64_t left = found->second / 8;
    for (const VdbDescriptor::Attribute& attribute : descriptor.attributes) {
        if (isGroupArray(attribute) && left-- == 0)
            return {attribute.name, static_cast<unsigned>(found->second % 8)};
    }
    throw InputError(text + "damaged: point group '" + shownText(group) + "' is bit " +
                     std::to_string(found->second) + " of arrays that are not there; write the file again");
}

} // namespace

// What is needed to read values of the points that were read before.
struct VdbFile::Reopened {
    VdbPointLayout layout;
    GridPoints points; // leaves and starts alone
    std::string part;
};

VdbFile::Reopened VdbFile::reopen(const ByteSource& file, const CancelCheck& cancel) const
{
    const auto check = [&](bool isSame) {
        if (isSame) return;
        throw InputError(
            file.name() + ": " + gridText(mGridName) +
            " has changed since its points were read; start again once nobody writes it any more");
    };
    if (mTile)
        throw InvalidInput(file.name() +
                           ": values of the points of a tile alone are not read; read all points");
    cancel.update(0);
    const VdbDirectory directory = readVdbDirectory(file);
    check(mChosen < directory.entries.size() && directory.entries[mChosen].uniqueName == mGridName &&
          directory.entries[mChosen].gridType == kVdbPointGridType);
    Reopened result;
    result.part = gridText(mGridName);
    result.layout = readVdbGridLayout(file, directory, directory.entries[mChosen]).layout;
    const ParticleSource& source = mView.source();
    for (std::size_t i = 0; i < source.fileLeafCount(); ++i) {
        result.points.leaves.push_back(source.fileLeaf(i).origin);
        result.points.starts.push_back(source.fileLeaf(i).firstParticle + source.fileLeaf(i).count);
    }
    // Leaves that are not among those were without points, of which arrays of one value remain.
    const GridPoints& points = result.points;
    const VdbPointLayout& layout = result.layout;
    std::size_t next = 0;
    for (std::size_t leaf = 0; leaf < layout.leaves.size(); ++leaf) {
        const bool hasPoints = next < points.leaves.size() && points.leaves[next] == layout.leaves[leaf];
        const std::uint64_t count = hasPoints ? points.starts[next + 1] - points.starts[next] : 0;
        next += hasPoints;
        for (std::size_t place = 0; place < layout.arrayCount(leaf); ++place) {
            const std::uint32_t size = layout.array(leaf, place).size;
            check(size == count || (count == 0 && size <= 1));
        }
    }
    check(next == points.leaves.size());
    return result;
}

std::vector<double> VdbFile::readScalars(const ByteSource& file, const std::string& name,
                                         std::uint64_t allowedBytes, const CancelCheck& cancel) const
{
    const Reopened grid = reopen(file, cancel);
    if (mView.size() == 0 && grid.layout.descriptors.empty()) return {}; // nothing says what there would be
    checkScalar(file.name() + ": " + grid.part + ": ", grid.layout, name);
    checkFits(file.name(), 2 * sizeof(double) * std::uint64_t(mView.size()), allowedBytes);
    const VdbPointReader reader(file, grid.layout, grid.part);
    const VdbValues values = reader.readAttribute({0, grid.layout.leaves.size()}, name, grid.points, cancel);
    std::vector<double> result(mView.size());
    const bool isFloat = values.type.isKnown && values.type.scalar == VdbScalar::kFloat;
    if (isFloat) {
        const float* const floats = static_cast<const float*>(values.bytes.data());
        std::copy(floats, floats + result.size(), result.begin());
    } else if (values.type.isKnown) {
        const double* const doubles = static_cast<const double*>(values.bytes.data());
        std::copy(doubles, doubles + result.size(), result.begin());
    }
    cancel.update(1);
    return result;
}

std::vector<StoredValue> VdbFile::listValues(const ByteSource& file, const CancelCheck& cancel) const
{
    const Reopened grid = reopen(file, cancel);
    const VdbPointLayout& layout = grid.layout;
    std::vector<StoredValue> list;
    std::map<std::string, std::size_t> places; // in the list
    for (std::size_t leaf = 0; leaf < layout.leaves.size(); ++leaf) {
        const VdbDescriptor& descriptor = layout.descriptor(leaf);
        for (std::size_t k = 0; k < layout.arrayCount(leaf); ++k) {
            const VdbDescriptor::Attribute& attribute = descriptor.attributes[k];
            if (attribute.name == "P" || isGroupArray(attribute)) continue;
            const auto [place, isNew] = places.try_emplace(attribute.name, list.size());
            if (isNew)
                list.push_back({attribute.name, typeText(attribute), false, readableType(attribute), {}});
            StoredValue& value = list[place->second];
            if (value.problem.empty())
                value.problem = problemOf(attribute, layout.array(leaf, k), value.readAs);
        }
    }
    for (StoredValue& value : list) {
        if (!value.problem.empty()) value.readAs.reset();
    }
    for (const std::string& group : vdbGroupNames(layout)) list.push_back({group, "group", true, {}, {}});
    cancel.update(1);
    return list;
}

PointValues VdbFile::readAttributes(const ByteSource& file, const std::vector<StoredValue>& which,
                                    std::uint64_t allowedBytes, const CancelCheck& cancel) const
{
    const Reopened grid = reopen(file, cancel);
    std::uint64_t valueBytes = 0, largest = 0;
    for (const StoredValue& value : which) {
        if (value.isGroup) continue;
        valueBytes += attributeBytes(*value.readAs);
        largest = std::max<std::uint64_t>(largest, attributeBytes(*value.readAs));
    }
    checkFits(file.name(), (valueBytes + largest) * mView.size(), allowedBytes);
    const VdbPointReader reader(file, grid.layout, grid.part);
    const VdbLeafRange all{0, grid.layout.leaves.size()};
    PointValues result;
    for (const StoredValue& value : which) {
        if (value.isGroup) continue;
        result.attributes.push_back(
            attributeOf(value, reader.readAttribute(all, value.name, grid.points, cancel), mView.size()));
    }
    return result;
}

std::vector<std::uint8_t> VdbFile::readGroups(const ByteSource& file, const std::string& list,
                                              std::uint64_t allowedBytes, const CancelCheck& cancel) const
{
    const Reopened grid = reopen(file, cancel);
    const VdbPointLayout& layout = grid.layout;
    const std::string text = file.name() + ": " + grid.part + ": ";
    std::vector<std::uint8_t> chosen(mView.size());
    if (chosen.empty() && layout.descriptors.empty()) return chosen; // nothing says what there would be
    const GroupList groups = parseGroupList(list, vdbGroupNames(layout), file.name() + ": " + grid.part);

    // Where each group is, by descriptor; and the arrays that this takes.
    using Places = std::vector<GroupPlace>;
    std::vector<Places> wanted, leftOut;
    std::map<std::string, VdbValues> arrays;
    for (const VdbDescriptor& descriptor : layout.descriptors) {
        const auto placesOf = [&](const std::vector<std::string>& names) {
            Places places;
            for (const std::string& name : names) {
                places.push_back(placeOf(text, descriptor, name));
                if (!places.back().array.empty()) arrays[places.back().array];
            }
            return places;
        };
        wanted.push_back(placesOf(groups.wanted));
        leftOut.push_back(placesOf(groups.leftOut));
    }
    checkFits(file.name(), (1 + arrays.size()) * std::uint64_t(chosen.size()), allowedBytes);
    const VdbPointReader reader(file, layout, grid.part);
    for (auto& [name, values] : arrays) {
        values = reader.readAttribute({0, layout.leaves.size()}, name, grid.points, cancel);
        const bool isBits =
            !values.type.isKnown || values.type.bytes() == 1; // not known: no leaf with points has it
        if (!isBits)
            throw InputError(text + "damaged: '" + shownText(name) + "' holds no groups in all leaves");
    }

    const auto add = [&](const Places& places, std::size_t begin, std::size_t end, std::uint8_t value) {
        for (const GroupPlace& place : places) {
            if (place.array.empty() || !arrays[place.array].type.isKnown) continue;
            const auto* const bits = static_cast<const unsigned char*>(arrays[place.array].bytes.data());
            for (std::size_t i = begin; i < end; ++i) {
                if (bits[i] >> place.bit & 1) chosen[i] = value;
            }
        }
    };
    std::size_t next = 0;
    for (std::size_t leaf = 0; leaf < layout.leaves.size() && next < grid.points.leaves.size(); ++leaf) {
        if (grid.points.leaves[next] != layout.leaves[leaf]) continue;
        const std::size_t begin = static_cast<std::size_t>(grid.points.starts[next]);
        const std::size_t end = static_cast<std::size_t>(grid.points.starts[++next]);
        const std::size_t descriptor = layout.descriptorOf[leaf];
        if (groups.wanted.empty()) std::fill(chosen.data() + begin, chosen.data() + end, std::uint8_t(1));
        add(wanted[descriptor], begin, end, 1);
        add(leftOut[descriptor], begin, end, 0);
    }
    cancel.update(1);
    return chosen;
}

} // namespace vdb_nns
