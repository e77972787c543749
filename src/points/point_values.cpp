#include "vdb_nns/point_values.h"

#include "points/value_check.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <set>
#include <utility>

namespace vdb_nns {

namespace {

struct TypeFacts {
    const char* name;
    std::size_t width, numberBytes;
};
// In the order of AttributeType.
constexpr TypeFacts kTypes[] = {{"float", 1, 4}, {"double", 1, 8}, {"int32", 1, 4}, {"int64", 1, 8},
                                {"vec3s", 3, 4}, {"vec3d", 3, 8},  {"mat3s", 9, 4}};

const TypeFacts& factsOf(AttributeType type)
{
    return kTypes[static_cast<std::size_t>(type)];
}

void checkOne(const std::string& text, const std::string& what, const std::string& name, bool isFirst,
              std::uint64_t count, const void* values, std::uint64_t points)
{
    if (name.empty()) throw InvalidInput(text + "a name of an " + what + " is empty");
    const std::string which = text + what + " '" + name + "' ";
    if (!isFirst) throw InvalidInput(which + "is given twice");
    if (count != points)
        throw InvalidInput(which + "has " + std::to_string(count) + " values for " + std::to_string(points) +
                           " points; give one value a point");
    if (count > 0 && !values) throw InvalidInput(which + "has no values: its pointer is null");
}

// Without an owner.
template <typename T>
std::shared_ptr<const T> viewed(const T* values)
{
    return {std::shared_ptr<const T>(), values};
}

} // namespace

const char* attributeTypeName(AttributeType type)
{
    return factsOf(type).name;
}

std::size_t attributeWidth(AttributeType type)
{
    return factsOf(type).width;
}

std::size_t attributeBytes(AttributeType type)
{
    return factsOf(type).width * factsOf(type).numberBytes;
}

PointAttribute viewAttribute(std::string name, AttributeType type, const void* values, std::uint64_t count)
{
    return {std::move(name), type, count, viewed(values)};
}

PointGroup viewGroup(std::string name, Span<const std::uint8_t> members)
{
    return {std::move(name), members.size(), viewed(members.data())};
}

void checkValues(const std::string& text, const PointValues& values, std::uint64_t points)
{
    std::set<std::string> names;
    for (const PointAttribute& attribute : values.attributes) {
        if (static_cast<std::size_t>(attribute.type) >= std::size(kTypes))
            throw InvalidInput(text + "attribute '" + attribute.name + "' has an unknown type");
        checkOne(text, "attribute", attribute.name, names.insert(attribute.name).second, attribute.count,
                 attribute.values.get(), points);
    }
    names.clear();
    for (const PointGroup& group : values.groups)
        checkOne(text, "group", group.name, names.insert(group.name).second, group.count, group.members.get(),
                 points);
}

PointAttribute countAttribute(const std::string& text, const std::string& name,
                              Span<const std::uint32_t> counts)
{
    constexpr std::uint32_t kMax = std::numeric_limits<std::int32_t>::max();
    const auto tooLarge =
        std::find_if(counts.begin(), counts.end(), [](std::uint32_t v) { return v > kMax; });
    if (tooLarge != counts.end()) {
        throw InvalidInput(text + "value " + std::to_string(*tooLarge) + " of point " +
                           std::to_string(tooLarge - counts.begin()) + " does not fit the int32 attribute '" +
                           name + "' (at most " + std::to_string(kMax) + ")");
    }
    return viewAttribute(name, AttributeType::kInt32, counts.data(), counts.size());
}

} // namespace vdb_nns
