// Points out: a new .vdb, .ply, .npz or .npy of any positions, with attributes and groups; and from one file to another.
#pragma once

#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

/// What became of positions that were written.
struct WrittenPoints {
    std::uint64_t points = 0;  ///< in the file
    std::uint64_t skipped = 0; ///< not in it: their position is NaN or infinite
    bool isDouble = false;     ///< whether coordinates have 8 bytes; in a .vdb never: P has floats
    double voxelSize = 0;      ///< world units; 0 where there are no voxels
    /// World units: the farthest that a position in the file is from the one given. Two points that are closer to the radius
    /// than twice that may be neighbors before and not after, or the other way round.
    double largestRounding = 0;
};

struct NewGridOptions {
    /// World units. 0: chosen so that an occupied voxel has 8 points on average, in three decimal digits; larger, if the
    /// extent asks for it. If it is a power of two, float positions are not rounded.
    double voxelSize = 0;
    std::string name = "points"; ///< of the grid
    std::string id = "id";       ///< attribute that gets each point's number in the input; empty: none
    std::optional<double> suggestedRadius = {}; ///< metadata `suggested_radius`, world units
};

/// Writes a .vdb of one point grid with a linear transform, P as floats with codec null, and attributes and groups. Points
/// that are not finite are left out. The order of the points is that of OpenVDB's leaves, and within a voxel that of the
/// input; `id` is an int32, or an int64 where the input has more than 2^31-1 points. The same input gives the same
/// bytes, but for the UUID that OpenVDB draws.
/// @param values one a point of the view.
/// @throws InvalidInput for a voxel size that is not positive and finite, and for values whose number is not that of the
///         points, or whose name is not valid, is given twice, or is `P` or `id`
/// @throws InputError where a voxel's coordinate would pass 2^31-4096; OutputExists, OutputError, Cancelled
WrittenPoints writeNewVdb(const std::string& path, const ParticleView& positions, const PointValues& values,
                          const NewGridOptions& options = {}, const OutputOptions& output = {},
                          Progress* progress = nullptr);

/// Fails early where writeNewVdb() could not write the positions. Cost: a pass over them.
/// @throws as that
void checkNewVdb(const std::string& path, const ParticleView& positions, const NewGridOptions& options = {},
                 Progress* progress = nullptr);

/// Fails early where a file could not have values of these names and types: a .vdb, a .ply, or an .npz of arrays without
/// positions, by the extension of `path`. The values themselves are not looked at.
/// @param id of a new .vdb: NewGridOptions::id; empty for values that are added to one
/// @throws InvalidInput for such a name, with the reason, and for another extension
void checkValueNames(const std::string& path, const PointValues& values, const std::string& id = {});

/// Names of the properties that an attribute of a .ply becomes: NAME; NAME_x NAME_y NAME_z; NAME_xx, NAME_xy, ... NAME_zz,
/// row by row; nx ny nz for the vector `normal`.
std::vector<std::string> plyProperties(const std::string& name, AttributeType type);

/// Writes a binary little-endian .ply: x y z (float if every coordinate is one exactly, else double), then the attributes
/// (64-bit integers as double) and the groups (uchar, 1 or 0). All points are written in their order, those that are not
/// finite too.
/// @throws InvalidInput for values whose number is not that of the points, and for names that are empty, have blanks or
///         control characters, or would be there twice
/// @throws InputError for an integer beyond 2^53, which no double holds; OutputExists, OutputError, Cancelled
WrittenPoints writePly(const std::string& path, const ParticleView& positions, const PointValues& values,
                       const OutputOptions& output = {}, Progress* progress = nullptr);

/// Writes an uncompressed .npz: `positions` (N, 3), float32 if every coordinate is a float exactly, else float64; then a
/// member for each attribute, (N,), (N, 3) or (N, 3, 3), and each group, (N,) of bools. All points are written in their
/// order, those that are not finite too. The same input gives the same bytes.
/// @throws InvalidInput for values whose number is not that of the points, and for names that are empty, have a '/' or
///         control characters, or would be there twice
/// @throws OutputExists, OutputError, Cancelled
WrittenPoints writePointsNpz(const std::string& path, const ParticleView& positions,
                             const PointValues& values, const OutputOptions& output = {},
                             Progress* progress = nullptr);

/// The same without positions, which need not be those of any points.
/// @throws as writePointsNpz()
void writeArraysNpz(const std::string& path, const PointValues& values, const OutputOptions& output = {},
                    Progress* progress = nullptr);

/// Writes the positions alone as an .npy of shape (N, 3): float32 if every coordinate is a float exactly, else float64.
/// @throws OutputExists, OutputError, Cancelled
WrittenPoints writePointsNpy(const std::string& path, const ParticleView& positions,
                             const OutputOptions& output = {}, Progress* progress = nullptr);

// ------------------------------------------------------------------------------------------------ conversion

struct ConvertOptions {
    /// Names of what comes along (PointFile::listValues()), with commas between; or "all": what can; or "none".
    std::string keep = "all";
    /// NewGridOptions::voxelSize; for a .vdb alone.
    double voxelSize = 0;
};

/// What a conversion did.
struct Conversion {
    std::string format; ///< of the file written: "vdb", "ply", "npz" or "npy"
    WrittenPoints written;
    bool hasId = false; ///< whether the attribute `id` was added
    struct Kept {
        std::string name, type; ///< type: attributeTypeName(), or "group"
    };
    std::vector<Kept> kept;
    struct LeftOut {
        std::string name, why; ///< why: the end of a sentence that begins with the name
    };
    std::vector<LeftOut> leftOut;
};

/// What of a file's values comes along into a new one.
struct KeptValues {
    std::vector<StoredValue> values; ///< for PointFile::readValues()
    std::vector<Conversion::LeftOut> leftOut;
};

/// Chooses them by name, before any is read.
/// @param path of the new file, by whose extension they must suit: .vdb, .ply, .npz or .npy
/// @param keep ConvertOptions::keep
/// @param others that the new file gets besides, by names and types alone. A value of the file that would stand where one of them
///        does is refused, or, with `mayReplace`, replaced by it.
/// @throws InvalidInput for such a value, for another extension, and for a name to be kept that the file does not have (the
///         message has the nearest one) or that the new file cannot have
/// @throws InputError for a value to be kept of a kind that cannot be carried; and as PointFile::listValues()
KeptValues chooseKeptValues(const PointFile& file, const std::string& path, const std::string& keep,
                            const PointValues& others = {}, bool mayReplace = false,
                            Progress* progress = nullptr);

/// Writes the points of a file into another one, whose extension is .vdb, .ply, .npz or .npy.
/// @throws InvalidInput for another extension, for a voxel size without voxels, for a name to be kept that the file does not
///         have (the message has the nearest one) or that the new file cannot have
/// @throws InputError for a value to be kept of a kind that cannot be carried
/// @throws as the writers above and PointFile::readValues()
Conversion convertPoints(const PointFile& file, const std::string& path, const ConvertOptions& options = {},
                         const OutputOptions& output = {}, Progress* progress = nullptr);

/// Fails early where convertPoints() could not write: another extension, or a voxel size without voxels.
/// @throws InvalidInput
void checkConversion(const std::string& path, const ConvertOptions& options);

} // namespace vdb_nns
