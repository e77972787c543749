#include "io/value_names.h"

#include "util/shown_text.h"
#include "vdb_nns/error.h"
#include "vdb_nns/write_points.h"

#include <algorithm>
#include <vector>

namespace vdb_nns {

namespace {

bool isLetterOrDigit(char c)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
}

bool hasControlCharacter(const std::string& name)
{
    return std::any_of(name.begin(), name.end(), [](char c) {
        const auto code = static_cast<unsigned char>(c);
        return code < 32 || code == 127;
    });
}

constexpr const char* kIsThereTwice = "would be there twice";

} // namespace

std::vector<std::string> plyProperties(const std::string& name, AttributeType type)
{
    const std::size_t width = attributeWidth(type);
    if (width == 1) return {name};
    if (width == 3 && name == "normal") return {"nx", "ny", "nz"};
    std::vector<std::string> names;
    for (const char row : {'x', 'y', 'z'}) {
        if (width == 3) names.push_back(name + "_" + row);
        for (const char column : {'x', 'y', 'z'}) {
            if (width == 9) names.push_back(name + "_" + row + column);
        }
    }
    return names;
}

ValueNames::ValueNames(PointFormat format, const std::string& id, bool hasPositions)
    : mFormat(format), mId(id)
{
    if (format == PointFormat::kVdb) mTaken = {"P"};
    if (format == PointFormat::kVdb && !id.empty()) mTaken.insert(id);
    if (format == PointFormat::kPly) mTaken = {"x", "y", "z"};
    if (format == PointFormat::kNpz && hasPositions) mTaken = {"positions"};
}

std::string ValueNames::add(const std::string& name, const std::optional<AttributeType>& type)
{
    if (name.empty()) return "is an empty name";
    switch (mFormat) {
    case PointFormat::kVdb:
        return addToVdb(name, !type);
    case PointFormat::kPly:
        return addToPly(name, type.value_or(AttributeType::kInt32));
    case PointFormat::kNpz:
        return addToNpz(name);
    case PointFormat::kNpy:
        return "has no place in an .npy file, which holds positions alone; write .npz";
    }
    return {};
}

std::string ValueNames::addToVdb(const std::string& name, bool isGroup)
{
    const bool isValid = std::all_of(name.begin(), name.end(), [](char c) {
        return isLetterOrDigit(c) || c == '_' || c == '|' || c == ':';
    });
    if (!isValid) return "is a name that OpenVDB does not take; it takes letters, digits and _ | :";
    if (!isGroup && name == mId) return "is the name of the attribute with the points' numbers in the input";
    if (!isGroup && name == "P") return "is the name of the positions";
    // Attributes and groups of one name are told apart.
    if (!mTaken.insert(isGroup ? "group " + name : name).second) return kIsThereTwice;
    return {};
}

std::string ValueNames::addToPly(const std::string& name, AttributeType type)
{
    if (hasControlCharacter(name) || name.find(' ') != std::string::npos)
        return "is a name with a blank or a control character, which a .ply cannot have";
    const std::vector<std::string> properties = plyProperties(name, type);
    for (const std::string& property : properties) {
        if (mTaken.count(property) > 0)
            return "becomes the property '" + shownText(property) + "', which is there already";
    }
    mTaken.insert(properties.begin(), properties.end());
    return {};
}

std::string ValueNames::addToNpz(const std::string& name)
{
    if (hasControlCharacter(name) || name.find('/') != std::string::npos)
        return "is a name with a slash or a control character, which an array of an .npz cannot have";
    if (mTaken.count(name) > 0 && name == "positions") return "is the name of the positions";
    if (!mTaken.insert(name).second) return kIsThereTwice;
    return {};
}

void ValueNames::addAll(const std::string& path, const PointValues& values)
{
    const auto check = [&](const char* what, const std::string& name,
                           const std::optional<AttributeType>& type) {
        const std::string problem = add(name, type);
        if (!problem.empty())
            throw InvalidInput(path + ": the " + what + " '" + shownText(name) + "' " + problem);
    };
    for (const PointAttribute& attribute : values.attributes)
        check("attribute", attribute.name, attribute.type);
    for (const PointGroup& group : values.groups) check("group", group.name, std::nullopt);
}

} // namespace vdb_nns
