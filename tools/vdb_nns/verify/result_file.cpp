#include "result_file.h"

#include "array_points.h"
#include "vdb_nns/error.h"
#include "vdb_nns/write_points.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstring>
#include <iterator>
#include <memory>
#include <utility>

namespace vdb_nns::cli {

namespace {

constexpr std::uint32_t kNowhere = ~std::uint32_t(0); // a view has fewer points

bool hasExtension(const std::string& path, const std::string& extension)
{
    if (path.size() < extension.size()) return false;
    return std::equal(extension.begin(), extension.end(),
                      path.end() - static_cast<std::ptrdiff_t>(extension.size()),
                      [](char a, char b) { return a == std::tolower(static_cast<unsigned char>(b)); });
}

template <typename Value>
bool contains(const std::vector<Value>& values, const Value& value)
{
    return std::find(values.begin(), values.end(), value) != values.end();
}

std::int64_t integerAt(const PointAttribute& attribute, std::uint64_t i)
{
    if (attribute.type == AttributeType::kInt64)
        return static_cast<const std::int64_t*>(attribute.values.get())[i];
    return static_cast<const std::int32_t*>(attribute.values.get())[i];
}

// ---- whether points are the same ------------------------------------------------------------------------------------

bool isSameNumber(double a, double b)
{
    return a == b || (std::isnan(a) && std::isnan(b));
}

bool isSameStored(const ParticleView& a, std::uint64_t i, const ParticleView& b, std::uint64_t j)
{
    const StoredPosition p = a.stored(i), q = b.stored(j);
    for (int k = 0; k < 3; ++k) {
        if (p.voxel[k] != q.voxel[k] || !isSameNumber(p.offset[k], q.offset[k])) return false;
    }
    return true;
}

double largest(const Vec3d& v)
{
    return std::max({std::fabs(v[0]), std::fabs(v[1]), std::fabs(v[2])});
}

bool isFinite(const Vec3d& v)
{
    return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
}

// Of world positions, one of which has gone through a file: apart from roundings of doubles by no more than `rounding`.
bool isSamePlace(const Vec3d& a, const Vec3d& b, double translation, double rounding)
{
    if (!isFinite(a) || !isFinite(b)) return isFinite(a) == isFinite(b);
    const double most = rounding + 1e-12 * (largest(a) + translation);
    return std::fabs(a[0] - b[0]) <= most && std::fabs(a[1] - b[1]) <= most && std::fabs(a[2] - b[2]) <= most;
}

double translationOf(const PointFileInfo& info)
{
    return largest({info.transform[0][3], info.transform[1][3], info.transform[2][3]});
}

[[noreturn]] void failOther(const std::string& path, const PointFile& queries, const std::string& what)
{
    throw InputError(path + ": " + what + "; are these the points of " + queries.info().path + "?");
}

} // namespace

bool ResultFile::holdsValues(const std::string& path)
{
    if (hasExtension(path, ".vdb") || hasExtension(path, ".ply")) return true;
    if (!hasExtension(path, ".npz")) return false;
    std::vector<std::string> arrays;
    try {
        arrays = listNpzArrays(path);
    } catch (const InputError&) {
        return false; // whoever reads lists says what is wrong
    }
    const auto isOfLists = [&](const char* name) { return contains(arrays, std::string(name)); };
    return !arrays.empty() && !isOfLists("indptr") && !isOfLists("indices") && !isOfLists("shape") &&
           !isOfLists("format");
}

ResultFile::ResultFile(const std::string& path, const std::string& grid, Progress* progress) : mPath(path)
{
    if (hasExtension(path, ".npz")) {
        mArrays = listNpzArrays(path);
        return;
    }
    PointFileOptions options;
    options.grid = hasExtension(path, ".vdb") ? grid : std::string();
    options.progress = progress;
    mPoints = PointFile::read(path, options);
    mList = mPoints->listValues(progress);
}

bool ResultFile::isPly() const
{
    return hasExtension(mPath, ".ply");
}

const StoredValue* ResultFile::find(const std::string& name, bool isGroup) const
{
    for (const StoredValue& value : mList) {
        if (value.name == name && value.isGroup == isGroup) return &value;
    }
    return nullptr;
}

bool ResultFile::hasAttribute(const std::string& name, AttributeType type) const
{
    if (!mPoints) return contains(mArrays, name);
    if (!isPly()) return find(name, false) != nullptr;
    const std::vector<std::string> properties = plyProperties(name, type);
    return std::all_of(properties.begin(), properties.end(),
                       [&](const std::string& property) { return find(property, false); });
}

bool ResultFile::hasGroup(const std::string& name) const
{
    return mPoints ? find(name, !isPly()) != nullptr : contains(mArrays, name);
}

bool ResultFile::hasAny(const MeasuredNames& names) const
{
    return std::any_of(
               names.attributes.begin(), names.attributes.end(),
               [&](const MeasuredNames::Value& value) { return hasAttribute(value.name, value.type); }) ||
           std::any_of(names.groups.begin(), names.groups.end(),
                       [&](const std::string& group) { return hasGroup(group); });
}

std::vector<std::string> ResultFile::namesBehind(const std::string& prefix,
                                                 const std::vector<std::string>& known) const
{
    std::vector<std::string> all = mArrays, result;
    for (const StoredValue& value : mList) all.push_back(value.name);
    for (const std::string& name : all) {
        if (name.compare(0, prefix.size(), prefix) != 0) continue;
        std::string rest = name.substr(prefix.size());
        const bool hasComponent = rest.size() > 2 && rest[rest.size() - 2] == '_';
        if (isPly() && !contains(known, rest) && hasComponent) rest.resize(rest.size() - 2);
        if (!contains(result, rest)) result.push_back(rest);
    }
    return result;
}

PointValues ResultFile::read(const MeasuredNames& names, Progress* progress) const
{
    PointValues values;
    if (!mPoints) {
        PointFileOptions options;
        options.progress = progress;
        std::vector<std::string> wanted = names.groups;
        for (const MeasuredNames::Value& value : names.attributes) wanted.push_back(value.name);
        for (const std::string& name : wanted) {
            if (!contains(mArrays, name)) continue;
            PointValues one = readNpzValues(mPath, name, options);
            std::move(one.attributes.begin(), one.attributes.end(), std::back_inserter(values.attributes));
            std::move(one.groups.begin(), one.groups.end(), std::back_inserter(values.groups));
        }
        return values;
    }
    if (isPly()) {
        readPly(names, progress, values);
        return values;
    }
    std::vector<StoredValue> wanted;
    for (const MeasuredNames::Value& value : names.attributes) {
        const StoredValue* const found = find(value.name, false);
        if (!found) continue;
        if (!found->readAs) throw InputError(mPath + ": '" + found->name + "' " + found->problem);
        wanted.push_back(*found);
    }
    for (const std::string& name : names.groups) {
        if (const StoredValue* const found = find(name, true)) wanted.push_back(*found);
    }
    return mPoints->readValues(wanted, progress);
}

namespace {

// A .ply has properties of one number, no int64 and no groups: vectors are put together again, integers in doubles become
// int64, and bytes members.
template <typename To, typename From>
std::shared_ptr<std::vector<To>> together(const std::vector<PointAttribute>& parts, std::uint64_t count)
{
    const auto result = std::make_shared<std::vector<To>>(count * parts.size());
    for (std::size_t k = 0; k < parts.size(); ++k) {
        const From* const from = static_cast<const From*>(parts[k].values.get());
        for (std::size_t i = 0; i < count; ++i) (*result)[i * parts.size() + k] = static_cast<To>(from[i]);
    }
    return result;
}

template <typename To, typename From>
PointAttribute joined(const MeasuredNames::Value& value, const std::vector<PointAttribute>& parts)
{
    const std::uint64_t count = parts[0].count;
    const auto numbers = together<To, From>(parts, count);
    return {value.name, value.type, count, std::shared_ptr<const void>(numbers, numbers->data())};
}

// The type that a property of it has.
AttributeType propertyType(AttributeType type)
{
    switch (type) {
    case AttributeType::kInt32:
        return AttributeType::kInt32;
    case AttributeType::kFloat:
    case AttributeType::kVec3s:
    case AttributeType::kMat3s:
        return AttributeType::kFloat;
    default:
        return AttributeType::kDouble;
    }
}

} // namespace

void ResultFile::readPly(const MeasuredNames& names, Progress* progress, PointValues& values) const
{
    for (const MeasuredNames::Value& value : names.attributes) {
        if (!hasAttribute(value.name, value.type)) continue;
        std::vector<StoredValue> properties;
        const AttributeType expected = propertyType(value.type);
        for (const std::string& property : plyProperties(value.name, value.type)) {
            const StoredValue& found = *find(property, false);
            if (found.readAs != expected)
                throw InputError(mPath + ": property '" + property + "' has type " + found.type +
                                 "; expected is " + attributeTypeName(expected));
            properties.push_back(found);
        }
        const std::vector<PointAttribute> parts = mPoints->readValues(properties, progress).attributes;
        if (value.type == AttributeType::kInt64) {
            values.attributes.push_back(joined<std::int64_t, double>(value, parts));
        } else if (expected == AttributeType::kInt32) {
            values.attributes.push_back(joined<std::int32_t, std::int32_t>(value, parts));
        } else if (expected == AttributeType::kFloat) {
            values.attributes.push_back(joined<float, float>(value, parts));
        } else {
            values.attributes.push_back(joined<double, double>(value, parts));
        }
    }
    for (const std::string& name : names.groups) {
        const StoredValue* const found = find(name, false);
        if (!found) continue;
        if (found->readAs != AttributeType::kInt32)
            throw InputError(mPath + ": property '" + name + "' has type " + found->type +
                             "; expected is uchar, 1 in the group and 0 outside");
        const std::vector<PointAttribute> parts = mPoints->readValues({*found}, progress).attributes;
        const auto members = together<std::uint8_t, std::int32_t>(parts, parts[0].count);
        values.groups.push_back({name, parts[0].count, {members, members->data()}});
    }
}

std::vector<std::uint32_t> ResultFile::placesOf(const PointFile& queries, Progress* progress) const
{
    if (!mPoints) return {};
    const PointFileInfo &own = mPoints->info(), &other = queries.info();
    const ParticleView &points = mPoints->view(), &asked = queries.view();
    const bool isGrid = own.format == "vdb", isOfGrid = other.format == "vdb";
    std::vector<std::uint32_t> places;
    if (isGrid && !isOfGrid) {
        const StoredValue* const id = find("id", false);
        const bool isNumber =
            id && (id->readAs == AttributeType::kInt32 || id->readAs == AttributeType::kInt64);
        if (!isNumber) failOther(mPath, queries, "has no attribute 'id' that tells the points' numbers");
        const PointAttribute numbers = mPoints->readValues({*id}, progress).attributes.at(0);
        places.assign(asked.size(), kNowhere);
        for (std::uint32_t k = 0; k < points.size(); ++k) {
            const std::int64_t i = integerAt(numbers, k);
            const bool isNew = i >= 0 && i < static_cast<std::int64_t>(asked.size()) && places[i] == kNowhere;
            if (!isNew)
                failOther(mPath, queries,
                          "the id " + std::to_string(i) + " of point " + std::to_string(k) +
                              " is that of no point, or of two");
            places[i] = k;
        }
        if (points.size() != other.points - other.nonfinite)
            failOther(mPath, queries,
                      "has " + std::to_string(points.size()) + " points, but there are " +
                          std::to_string(other.points - other.nonfinite) + " finite ones");
    } else if (points.size() != asked.size()) {
        failOther(mPath, queries,
                  "has " + std::to_string(points.size()) + " points, but there are " +
                      std::to_string(asked.size()));
    }
    const bool isCopy = isGrid && isOfGrid;
    if (isCopy && (points.linear() != asked.linear() || own.transform != other.transform))
        failOther(mPath, queries, "has another transform");
    // P of a new grid is rounded to floats of voxels.
    const double rounding = places.empty() ? 0 : 0x1p-23 * largest(own.voxelSize.value_or(Vec3d{}));
    const double translation = std::max(translationOf(own), translationOf(other));
    for (std::uint32_t i = 0; i < asked.size(); ++i) {
        const std::uint32_t k = places.empty() ? i : places[i];
        if (k == kNowhere) continue;
        const bool isSame =
            isCopy ? isSameStored(points, k, asked, i)
                   : isSamePlace(points.worldPosition(k), asked.worldPosition(i), translation, rounding);
        if (!isSame)
            failOther(mPath, queries,
                      "point " + std::to_string(k) + " is not where point " + std::to_string(i) + " is");
    }
    return places;
}

PointValues placedValues(const PointValues& values, const std::vector<std::uint32_t>& places)
{
    PointValues result;
    const auto place = [&](const void* from, std::size_t bytes) {
        const auto owner = std::make_shared<std::vector<std::uint64_t>>((places.size() * bytes + 7) / 8);
        auto* const to = reinterpret_cast<char*>(owner->data());
        for (std::size_t i = 0; i < places.size(); ++i) {
            if (places[i] != kNowhere)
                std::memcpy(to + i * bytes, static_cast<const char*>(from) + places[i] * bytes, bytes);
        }
        return std::shared_ptr<const void>(owner, to);
    };
    for (const PointAttribute& attribute : values.attributes) {
        result.attributes.push_back({attribute.name, attribute.type, places.size(),
                                     place(attribute.values.get(), attributeBytes(attribute.type))});
    }
    for (const PointGroup& group : values.groups) {
        result.groups.push_back(
            {group.name, places.size(),
             std::static_pointer_cast<const std::uint8_t>(place(group.members.get(), 1))});
    }
    return result;
}

} // namespace vdb_nns::cli
