// Outputs that hold attributes of points: the points again with them, new points, or the attributes alone.
#pragma once

#include "cli_options.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/search_job.h"
#include "vdb_nns/write_points.h"

#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// What is to be written where, of the points of one file.
struct AttributeOutputs {
    std::vector<std::string> points; ///< .vdb and .ply
    std::string arrays;              ///< .npz of the attributes alone; empty: none
};

/// What the files of -o are, by their extensions.
/// @throws InvalidInput for another than .npz, .vdb and .ply
WrittenKinds writtenKinds(const std::vector<std::string>& outputs);

/// Whether a .vdb of such points is a new grid rather than a copy of theirs.
bool makesNewGrid(const PointFile& points);

/// Refuses what could not be written, before a search: names that the points have already and that would be replaced (without
/// `mayReplace`) or that a format cannot have, and voxels that are too small.
/// @param values names and types alone
/// @param grid of a new .vdb
/// @throws InvalidInput, InputError
void checkAttributeOutputs(const AttributeOutputs& outputs, const PointFile& points,
                           const PointValues& values, const NewGridOptions& grid, bool mayReplace,
                           Progress* progress);

/// Writes `path`, the points with the values.
/// @param grid of a new .vdb
/// @return of a new grid what became of the points
/// @throws as the writers of write_points.h and PointFile::writeVdb()
std::optional<WrittenPoints> writePoints(const std::string& path, const PointFile& points,
                                         const PointValues& values, const NewGridOptions& grid,
                                         const OutputOptions& output, Progress* progress);

/// Sentences about what writing changed: points that are left out, positions that were rounded.
std::vector<std::string> warningsOf(const std::string& path, const WrittenPoints& written);

} // namespace vdb_nns::cli
