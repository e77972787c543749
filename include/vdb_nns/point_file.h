// Point files: grids, arrays and texts in, neighbor lists (.npz) and result attributes (.vdb) out. Points themselves are
// written by write_points.h.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/progress.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

class SearchEngine;

struct AttributeInfo {
    std::string name; ///< e.g. "P"
    std::string
        type; ///< as the file has it: OpenVDB's value type name, e.g. "vec3s"; of a .ply "float", "list uchar int"
    std::string codec; ///< of a .vdb: "null", "trnc", "fxpt16", "fxpt8", ...
};

/// What a point file says about itself. Values that a format does not have are empty.
struct PointFileInfo {
    std::string path;
    std::string format; ///< the extension in lower case: "vdb", "npy", "npz", "ply", "xyz", "txt", "csv", ...
    std::string grid;   ///< grid name; empty for arrays
    std::uint64_t points = 0;
    std::uint64_t nonfinite = 0;              ///< points with a NaN or infinite coordinate
    std::optional<Vec3d> voxelSize;           ///< world units; grids only
    std::string codec;                        ///< codec of P; for arrays "float32" or "float64"
    Matrix4 transform{};                      ///< index to world, column vectors; identity for arrays
    std::optional<std::array<Vec3d, 2>> bbox; ///< world units, of the finite points; empty if there are none
    std::vector<AttributeInfo> attributes;    ///< of a .vdb; of a .ply the properties of element `vertex`
    std::vector<std::string> groups;          ///< names of the point groups of a .vdb, sorted
    /// Where a file leaves a choice, what was taken as the positions: "columns 1, 2 and 3 of 6", "array 'positions'".
    std::string taken;
    /// What a person should look at: sentences without the file's name.
    std::vector<std::string> notes;
    std::optional<double> suggestedRadius; ///< world units, metadata `suggested_radius`
};

/// What a file holds for each point beside its position, and how PointFile::readValues() reads it.
struct StoredValue {
    std::string name;
    std::string type;                    ///< as the file has it: "vec3s", "list uchar int", "<f4 (N, 3)"
    bool isGroup = false;                ///< a point group of a .vdb, an array of bools of an .npz
    std::optional<AttributeType> readAs; ///< empty for groups, and where it cannot be read
    std::string problem; ///< why it cannot be read, as the end of a sentence that begins with it; else empty
};

/// A tile of a file (tiles.h) that is read without the others.
struct TileOfFile {
    std::uint32_t tile = 0; ///< from 1
    std::uint32_t tiles = 0;
    double radius = 0; ///< world units; 0: the one that the file suggests
};

/// Which points of a file a view has that holds a tile and all that may be within the radius of it.
struct TileNumbers {
    std::vector<std::uint32_t> numbers; ///< in the file, of each point of the view; they ascend
    std::size_t begin = 0, end = 0;     ///< of the tile's own points in the view
    std::uint64_t total = 0;            ///< points of the file
};

struct PointFileOptions {
    /// Name of the point grid of a .vdb; empty: the only one.
    std::string grid;

    /// Bytes that reading may take; 0: what is free (availableMemoryBytes()). Checked against it before the
    /// points are read: of a .vdb what the points of the chosen grid take, 14 bytes each and 20 a leaf; of other
    /// files their size, and of a text its positions too. readScalars() and readGroups() of the file may take as much
    /// again, each.
    std::uint64_t hostMemoryBytes = 0;

    /// Receives progress and may cancel; may be null.
    Progress* progress = nullptr;

    /// Numbers of the columns that are x, y and z, from 0: three different ones, of a text, of an .npy or .npz that is wider
    /// than (N, 3), or of the fields of its records. Empty: what the file says.
    std::vector<std::uint32_t> columns = {};

    /// Name of the array of an .npz that holds the positions; empty: the only one, else the one named `positions`.
    std::string array = {};

    /// Of a .vdb: reads this tile alone, and the leaves that may have a neighbor of one of its points. Numbers in the view are not
    /// those of the file: see PointFile::tileNumbers(). The file is read twice, the first time in pieces that are not kept. Values
    /// of such points cannot be read.
    std::optional<TileOfFile> tile = {};
};

/// A point file in memory. Copies share it. Safe to use from several threads and from inside TBB tasks,
/// writeVdb() included.
class PointFile {
public:
    /// Reads a point file. The extension tells the format, in any case: .vdb; .npy .npz; .ply; .vtk (legacy); .bgeo
    /// (classic); texts .xyz .txt .csv .pts. docs/formats.md says what of each is read.
    /// @throws InvalidInput for an unknown extension; for a grid, array or column that the file does not have; for several
    ///         point grids or arrays and no name (the message lists them); and for a choice that the format does not offer
    /// @throws InputError if the file is missing, unreadable, truncated, damaged or not supported (frustum
    ///         transform, singular matrix, a P that is not vec3s with codec null, trnc, fxpt16 or fxpt8)
    /// @throws CapacityError if the points do not fit the memory
    /// @throws Cancelled
    static PointFile read(const std::string& path, const PointFileOptions& options = {});

    /// The positions. The view keeps the file's memory alive.
    const ParticleView& view() const;

    /// What a view of a tile alone has; null where all points were read.
    const TileNumbers* tileNumbers() const;

    /// PointFileInfo::grid and PointFileInfo::taken, without the pass over the positions that info() makes.
    const std::string& grid() const;
    const std::string& taken() const;

    /// PointFileInfo::notes, without the pass over the positions that info() makes.
    const std::vector<std::string>& notes() const;

    /// Describes the file; valid while a copy lives. Cost: the first call makes one pass over the positions
    /// for bbox and nonfinite, and so does each thread that calls it meanwhile.
    const PointFileInfo& info() const;

    /// One value of each point, in the order of their numbers: a float or double attribute of a .vdb, or a property of
    /// element `vertex` of a .ply, of any type of number. All are exact as doubles. Points of a leaf that lacks an
    /// attribute which others have get 0.
    /// Cost: reads that part of the file again (of a .ply all of it). Memory: the result, and as much again of a .vdb, or
    /// the file of a .ply.
    /// @throws InvalidInput if the file has no attribute or property of that name (the message lists those that it has), and
    ///         for formats without named values
    /// @throws InputError if it is not one real number a point (vectors, integers, texts and groups of a .vdb, lists of a
    ///         .ply), and if the file is not readable any more or has changed since it was read
    /// @throws CapacityError, Cancelled
    std::vector<double> readScalars(const std::string& name, Progress* progress = nullptr) const;

    /// What the file holds for each point, in its order: attributes and groups of a .vdb, properties of element `vertex` of a
    /// .ply, arrays of an .npz. Not the positions themselves. Empty for other formats, whose further values are not read.
    /// Cost: a walk over the leaves of a .vdb; the headers of an .npz.
    /// @throws InputError if the file is not readable any more or has changed since it was read
    /// @throws CapacityError, Cancelled
    std::vector<StoredValue> listValues(Progress* progress = nullptr) const;

    /// Reads values that listValues() gave, and that have no problem. Small integers and bools become int32, unsigned ones of
    /// 32 bits or more int64, halves floats. Points of a leaf that lacks an attribute which others have get 0.
    /// Memory: the result, and as much again for one of them, or the file of a .ply or .npz.
    /// @throws InvalidInput for values that the file does not have or that cannot be read
    /// @throws InputError for damage, for an integer beyond 2^63-1, and if the file has changed since it was read
    /// @throws CapacityError, Cancelled
    PointValues readValues(const std::vector<StoredValue>& which, Progress* progress = nullptr) const;

    /// Which points are in some point groups of a .vdb: 1 or 0 of each, in the order of their numbers.
    /// @param list names with commas between: the points of any of them (of all points if there is none) but for those of
    ///        any group whose name stands behind a `^`, in any order: "fluid,spray,^boundary". Blanks around names do not
    ///        count.
    /// Cost: reads those groups from the file. Memory: the result, and as much again for each eight groups.
    /// @throws InvalidInput for an empty name, a group that the file does not have (the message lists those that it has), and
    ///         for other formats
    /// @throws InputError if the file is not readable any more or has changed since it was read
    /// @throws CapacityError, Cancelled
    std::vector<std::uint8_t> readGroups(const std::string& list, Progress* progress = nullptr) const;

    /// Writes the same .vdb file with result attributes added. Other grids and the file's metadata are
    /// copied; name, transform, metadata, codecs and attributes stay untouched; P is not encoded again.
    /// Memory: the attribute. If several calls run at once, all but one read the grid from the file again and
    /// hold it.
    /// @param counts one value a point, written as the int32 attribute `prefix + "count"`.
    /// @param options `overwrite` applies to an attribute of that name too.
    /// @throws InvalidInput if this is not a .vdb file, counts has the wrong size, or the attribute exists
    /// @throws OutputExists, OutputError, Cancelled
    void writeVdb(const std::string& path, Span<const std::uint32_t> counts, const std::string& prefix,
                  const OutputOptions& options = {}, Progress* progress = nullptr) const;

    /// The same with attributes and groups of any kind, with the names that they have.
    /// @param options `overwrite` applies to attributes and groups that exist, too; P is never replaced.
    /// @throws InvalidInput if this is not a .vdb file, the numbers of values and points differ, or a name is not valid, is
    ///         given twice, or exists
    /// @throws OutputExists, OutputError, Cancelled
    void writeVdb(const std::string& path, const PointValues& values, const OutputOptions& options = {},
                  Progress* progress = nullptr) const;

    struct Data;

private:
    std::shared_ptr<Data> mData;
};

/// Reads one number a particle from an .npy file of shape (N,) or (N, 1) with floats of 4 or 8 bytes: radii.
/// @param count of particles, which N has to be.
/// @throws InputError for another shape, type or length, and if the file is missing, unreadable or damaged
/// @throws CapacityError, Cancelled
std::vector<double> readRadiusFile(const std::string& path, std::uint64_t count,
                                   Progress* progress = nullptr);

/// What the `data` array of a written list holds.
enum class ListValues {
    kConnectivity, ///< int8 ones
    kDistance      ///< float32 world distances
};

/// How the numbers of a written row are ordered.
enum class RowOrder {
    kNumber,  ///< ascending
    kDistance ///< the nearest first, decided in real arithmetic; those as far by number
};

/// What a written list is like.
struct ListForm {
    ListValues values = ListValues::kConnectivity;
    RowOrder order = RowOrder::kNumber;

    ListForm() = default;
    ListForm(ListValues listValues, RowOrder rowOrder = RowOrder::kNumber) // NOLINT: values alone say enough
        : values(listValues), order(rowOrder)
    {
    }
};

/// Writes lists as a SciPy CSR matrix of a row for each particle of the queries' view and a column for each of the
/// candidates': an uncompressed ZIP with the members indptr (int64), indices (int32, or int64 past 2^31-1 columns),
/// data, shape (int64[2]) and format (|S3), each of which starts on a 64-byte boundary. Memory does not grow with the lists. The same lists give the same
/// bytes.
/// @throws InvalidInput for counts alone; OutputExists, OutputError (before anything is written, if the disk
///         does not have the room), Cancelled
void writeNpz(const std::string& path, const NeighborLists& lists, const ListForm& form,
              const OutputOptions& options = {}, Progress* progress = nullptr);

/// Writes the file that writeNpz() would write, but no memory has to hold the lists: their rows are made
/// again (SearchEngine::visitRows) and go to their place in the file as they come.
/// Cost: the search and the writing. Memory: what the search takes without lists, 4.5 bytes a particle,
/// bufferBytes, and 1 MB a thread; or the longest row, if that is more than a thread's share of the buffers.
/// Rows with consecutive numbers that come together are written together. So particles should be numbered
/// along space, as those of a .vdb are, or the buffers should be large.
/// @param engine must not be running a search.
/// @param counts lists of the grid that is searched again, from engine.search(); counts alone
///         (Encoding::kNone) are enough.
/// @param bufferBytes rows that the threads of the caller's arena collect, together, before they write; 0: 64
///         MiB each.
/// @param options of the search; `encoding` and `hostMemoryBytes` are not read.
/// @throws OutputExists, OutputError (the latter also before anything is written, if the disk does not have
///         the room), Cancelled, and whatever SearchEngine::visitRows() throws
void streamNpz(const std::string& path, SearchEngine& engine, const NeighborLists& counts,
               const ListForm& form, const OutputOptions& output = {}, std::uint64_t bufferBytes = 0,
               const SearchOptions& options = {});

} // namespace vdb_nns
