// Outputs that hold attributes of points: the points again with them, new points, or the attributes alone.
#pragma once

#include "cli_options.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/search_job.h"
#include "vdb_nns/write_points.h"

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// What is to be written where, of the points of one file.
struct AttributeOutputs {
    std::vector<std::string> points; ///< .vdb and .ply
    std::string arrays;              ///< .npz of the attributes alone; empty: none
};

/// What the files of -o are, by their extensions, with the points of `rows`.
/// @throws InvalidInput for another than .npz, .vdb and .ply
WrittenKinds writtenKinds(const std::vector<std::string>& outputs, const std::string& rows);

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

/// Values of the points that come along into new files of them.
struct KeptOutputs {
    std::map<std::string, PointValues> byPath;
    std::vector<Conversion::LeftOut> leftOut; ///< of any of the files

    /// Those of one file, then the measures.
    PointValues before(const std::string& path, const PointValues& measures) const;
    std::vector<Conversion::Kept> kept() const; ///< in any of the files
    std::uint64_t bytesEach() const;            ///< of a point, in the file where that is most
};

/// Chooses and reads them.
/// @param keep ConvertOptions::keep
/// @param measures that the files get besides: names and types alone
/// @param mayReplace measures take the place of what is kept
/// @throws as chooseKeptValues() and PointFile::readValues()
KeptOutputs readKept(const AttributeOutputs& outputs, const PointFile& points, const std::string& keep,
                     const PointValues& measures, bool mayReplace, Progress* progress);

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
