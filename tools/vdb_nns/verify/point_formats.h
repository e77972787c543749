// The readers behind readArrayPoints(), one a format.
#pragma once

#include "array_points.h"

#include <cstdint>

namespace vdb_nns::cli {

// Rows between two questions whether to stop.
constexpr std::uint64_t kRowsBetweenChecks = std::uint64_t(1) << 16;

struct PointInput {
    const std::string& path;
    const PointFileOptions& options;

    // Throws an InputError that begins with the path.
    [[noreturn]] void fail(const std::string& what) const;
    // Throws the InvalidInput of a chosen column that is not there.
    void checkColumn(std::uint64_t column, std::uint64_t width) const;
    void checkCancelled() const;
    // Of the whole file.
    std::string bytes() const;
};

Positions readTextPoints(const PointInput& input); // .xyz .txt .csv .pts
Positions readNpyPoints(const PointInput& input);
Positions readNpzPoints(const PointInput& input);
Positions readPlyPoints(const PointInput& input);
std::vector<double> readPlyProperty(const PointInput& input, const std::string& name);
std::vector<double> readNpyList(const PointInput& input);
PointValues readNpzArray(const PointInput& input, const std::string& name);
Positions readVtkPoints(const PointInput& input);
Positions readBgeoPoints(const PointInput& input);

} // namespace vdb_nns::cli
