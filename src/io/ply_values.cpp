// Properties of a .ply as values of its points.
#include "io/array_readers.h"

#include <algorithm>
#include <initializer_list>
#include <memory>
#include <utility>

namespace vdb_nns {

namespace {

StoredValue plyValue(const AttributeInfo& property, const std::vector<AttributeInfo>& all)
{
    StoredValue value;
    value.name = property.name;
    value.type = property.type;
    const auto isOneOf = [&](std::initializer_list<const char*> types) {
        return std::find(types.begin(), types.end(), property.type) != types.end();
    };
    const auto hasName = [&](const AttributeInfo& other) { return other.name == property.name; };
    if (std::count_if(all.begin(), all.end(), hasName) > 1) {
        value.problem = "is there twice";
    } else if (isOneOf({"float", "float32"})) {
        value.readAs = AttributeType::kFloat;
    } else if (isOneOf({"double", "float64"})) {
        value.readAs = AttributeType::kDouble;
    } else if (isOneOf({"uint", "uint32"})) {
        value.readAs = AttributeType::kInt64;
    } else if (property.type.rfind("list", 0) == 0) {
        value.problem = "has type " + property.type + "; lists are not carried";
    } else {
        value.readAs = AttributeType::kInt32;
    }
    return value;
}

template <typename To>
PointAttribute narrowed(const StoredValue& which, const std::vector<double>& values)
{
    const auto owner = std::make_shared<std::vector<To>>(values.size());
    std::transform(values.begin(), values.end(), owner->begin(),
                   [](double value) { return static_cast<To>(value); });
    return {which.name, *which.readAs, values.size(), {owner, owner->data()}};
}

} // namespace

std::vector<StoredValue> listPlyProperties(const std::vector<AttributeInfo>& properties)
{
    std::vector<StoredValue> list;
    for (const AttributeInfo& property : properties) {
        if (property.name != "x" && property.name != "y" && property.name != "z")
            list.push_back(plyValue(property, properties));
    }
    return list;
}

PointAttribute readPlyAttribute(const ArrayFile& file, const StoredValue& which)
{
    std::vector<double> values = parsePlyProperty(file, which.name);
    if (*which.readAs == AttributeType::kFloat) return narrowed<float>(which, values);
    if (*which.readAs == AttributeType::kInt32) return narrowed<std::int32_t>(which, values);
    if (*which.readAs == AttributeType::kInt64) return narrowed<std::int64_t>(which, values);
    const auto owner = std::make_shared<std::vector<double>>(std::move(values));
    return {which.name, AttributeType::kDouble, owner->size(), {owner, owner->data()}};
}

} // namespace vdb_nns
