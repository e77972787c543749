#include "array_points.h"

#include "file_pieces.h"
#include "point_formats.h"
#include "throw_if_cancelled.h"
#include "vdb_nns/error.h"
#include "zip_members.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <cstring>

namespace vdb_nns::cli {

namespace {

using Reader = Positions (*)(const PointInput&);

// Null for other extensions.
Reader readerOf(const std::string& path)
{
    const std::size_t dot = path.find_last_of("./");
    if (dot == std::string::npos || path[dot] != '.') return nullptr;
    std::string extension = path.substr(dot + 1);
    for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    for (const char* text : {"xyz", "txt", "csv", "pts"}) {
        if (extension == text) return readTextPoints;
    }
    if (extension == "npy") return readNpyPoints;
    if (extension == "npz") return readNpzPoints;
    if (extension == "ply") return readPlyPoints;
    if (extension == "vtk") return readVtkPoints;
    if (extension == "bgeo") return readBgeoPoints;
    return nullptr;
}

bool isSame(double a, double b)
{
    return (std::isnan(a) && std::isnan(b)) || std::memcmp(&a, &b, sizeof a) == 0;
}

std::string pointText(const double* point)
{
    char text[3 * 32];
    std::snprintf(text, sizeof text, "(%.17g, %.17g, %.17g)", point[0], point[1], point[2]);
    return text;
}

} // namespace

void PointInput::fail(const std::string& what) const
{
    throw InputError(path + ": " + what);
}

void PointInput::checkColumn(std::uint64_t column, std::uint64_t width) const
{
    if (column < width) return;
    throw InvalidInput(path + ": has no column " + std::to_string(column) + " (--columns): it has " +
                       std::to_string(width) + ", from 0");
}

void PointInput::checkCancelled() const
{
    throwIfCancelled(options.progress);
}

std::string PointInput::bytes() const
{
    const FilePieces file(path);
    std::string bytes(static_cast<std::size_t>(file.size()), '\0');
    file.read(0, bytes.data(), bytes.size());
    return bytes;
}

bool isArrayPointFile(const std::string& path)
{
    return readerOf(path) != nullptr;
}

Positions readArrayPoints(const std::string& path, const PointFileOptions& options)
{
    const Reader read = readerOf(path);
    if (!read) throw InvalidInput(path + ": is no file of an array or a text");
    return read({path, options});
}

std::optional<std::string> findDifference(const std::string& path, const ParticleView& engine,
                                          const Positions& own)
{
    const std::size_t ownSize = own.size() / 3;
    for (std::size_t i = 0; i < std::min(engine.size(), ownSize); ++i) {
        const StoredPosition position = engine.stored(i);
        const double* const point = own.data() + 3 * i;
        if (std::equal(point, point + 3, position.offset, isSame)) continue;
        return path + ": point " + std::to_string(i) + " is " + pointText(position.offset) +
               " to the engine's reader and " + pointText(point) + " to verify's own";
    }
    if (engine.size() == ownSize) return std::nullopt;
    return path + ": has " + std::to_string(engine.size()) + " points to the engine's reader and " +
           std::to_string(ownSize) + " to verify's own";
}

std::vector<std::string> listNpzArrays(const std::string& path)
{
    const std::string extension = ".npy";
    std::vector<std::string> arrays;
    for (const std::string& name : zipNames(FilePieces(path))) {
        const bool isArray = name.size() > extension.size() &&
                             name.compare(name.size() - extension.size(), extension.size(), extension) == 0;
        if (isArray) arrays.push_back(name.substr(0, name.size() - extension.size()));
    }
    return arrays;
}

PointValues readNpzValues(const std::string& path, const std::string& array, const PointFileOptions& options)
{
    return readNpzArray({path, options}, array);
}

std::vector<double> readPlyScalars(const std::string& path, const std::string& property,
                                   const PointFileOptions& options)
{
    return readPlyProperty({path, options}, property);
}

std::vector<double> readNpyNumbers(const std::string& path, const PointFileOptions& options)
{
    return readNpyList({path, options});
}

std::optional<std::string> findDifference(const std::string& path, const std::vector<double>& engine,
                                          const std::vector<double>& own)
{
    for (std::size_t i = 0; i < std::min(engine.size(), own.size()); ++i) {
        if (isSame(engine[i], own[i])) continue;
        char text[2 * 32 + 64];
        std::snprintf(text, sizeof text, "%.17g to the engine's reader and %.17g to verify's own", engine[i],
                      own[i]);
        return path + ": the value of point " + std::to_string(i) + " is " + text;
    }
    if (engine.size() == own.size()) return std::nullopt;
    return path + ": has " + std::to_string(engine.size()) + " values to the engine's reader and " +
           std::to_string(own.size()) + " to verify's own";
}

} // namespace vdb_nns::cli
