// Point files: .vdb, .npy, .ply and .xyz in, neighbor lists (.npz) and result attributes (.vdb) out.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/output.h"
#include "vdb_nns/particle_view.h"
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
    std::string name;  ///< e.g. "P"
    std::string type;  ///< OpenVDB's value type name, e.g. "vec3s"
    std::string codec; ///< "null", "trnc", "fxpt16", "fxpt8", ...
};

/// What a point file says about itself. Values that the format has not are empty.
struct PointFileInfo {
    std::string path;
    std::string format; ///< "vdb", "npy", "ply" or "xyz"
    std::string grid;   ///< grid name; empty for arrays
    std::uint64_t points = 0;
    std::uint64_t nonfinite = 0;              ///< points with a NaN or infinite coordinate
    std::optional<Vec3d> voxelSize;           ///< world units; grids only
    std::string codec;                        ///< codec of P; for arrays "float32" or "float64"
    Matrix4 transform{};                      ///< index to world, column vectors; identity for arrays
    std::optional<std::array<Vec3d, 2>> bbox; ///< world units, of the finite points; empty without any
    std::vector<AttributeInfo> attributes;
    std::optional<double> suggestedRadius; ///< world units, metadata `suggested_radius`
};

struct PointFileOptions {
    /// Name of the point grid of a .vdb; empty: the only one.
    std::string grid;

    /// Bytes that reading may take; 0: what is free (availableMemoryBytes()). Held against the size of the file
    /// before it is read, and of a text against its positions too. Of a .vdb the chosen grid's part counts, or
    /// the whole file where it was written as a stream; reading may take more, as it is mostly compressed.
    std::uint64_t hostMemoryBytes = 0;

    /// Told how far reading is, and asked whether to stop; may be null.
    Progress* progress = nullptr;
};

/// A point file in memory. Copies share it. Safe to use from several threads and from inside of TBB tasks,
/// writeVdb() included.
class PointFile {
public:
    /// Reads a point file; the format is told by the extension (.vdb .npy .ply .xyz, any case).
    /// @throws InvalidInput for an unknown extension, an unknown grid name, several point grids and no name
    ///         (the message lists them), or a grid name given with an array file
    /// @throws InputError when the file is missing, unreadable, truncated, damaged or not supported (frustum
    ///         transform, singular matrix, a P that is not vec3s with codec null, trnc, fxpt16 or fxpt8)
    /// @throws CapacityError when the points do not fit the memory
    /// @throws Cancelled
    static PointFile read(const std::string& path, const PointFileOptions& options = {});

    /// The positions. Keeps the file's memory alive.
    const ParticleView& view() const;

    /// Describes the file; valid for as long as a copy lives. Cost: one pass over the positions for bbox and
    /// nonfinite, made at the first call, and by each thread that calls it meanwhile.
    const PointFileInfo& info() const;

    /// Writes the same .vdb file with result attributes added: other grids and the file's metadata are
    /// copied, name, transform, metadata, codecs and attributes stay untouched, P is not encoded again.
    /// @param counts one value a point, written as int32 attribute `prefix + "count"`.
    /// @param options `overwrite` goes for an attribute of that name too.
    /// Memory: the attribute. Of several calls at once all but one read the grid from the file again, and
    /// hold it.
    /// @throws InvalidInput if this is not a .vdb file, counts has the wrong size, or the attribute exists
    /// @throws OutputExists, OutputError, Cancelled
    void writeVdb(const std::string& path, Span<const std::uint32_t> counts, const std::string& prefix,
                  const OutputOptions& options = {}, Progress* progress = nullptr) const;

    struct Data;

private:
    std::shared_ptr<Data> mData;
};

/// What the `data` array of a written list holds.
enum class ListValues {
    kConnectivity, ///< int8 ones
    kDistance      ///< float32 world distances
};

/// Writes lists as a SciPy CSR matrix: a stored ZIP whose members indptr (int64), indices (int32, or int64
/// past 2^31-1 particles; ascending in each row), data, shape (int64[2]) and format (|S3) start on 64-byte
/// boundaries. Streams: memory does not grow with the lists. The same lists give the same bytes.
/// @throws OutputExists, OutputError (before anything is written, where the disk has not the room), Cancelled
void writeNpz(const std::string& path, const NeighborLists& lists, ListValues values,
              const OutputOptions& options = {}, Progress* progress = nullptr);

/// Writes the file that writeNpz() would write, of lists that no memory has to hold: the rows are made once
/// more (SearchEngine::visitRows) and go to their place in the file as they come.
/// Memory: what the search takes without lists, 4.5 bytes a particle, bufferBytes, 1 MB a thread; or the
/// longest row, where that is more than a thread's share of the buffers. Cost: the search and the writing.
/// Rows whose numbers follow each other and that come together are written together: particles should be
/// numbered along space, as those of a .vdb are, or the buffers be large.
/// @param engine a search on this engine must not be running.
/// @param counts lists of the grid that is searched again, from engine.search(); counts alone
///        (Encoding::kNone) are enough.
/// @param bufferBytes rows that the threads of the caller's arena collect, together, before they write;
///        0: 64 MiB each.
/// @param options of the search; `encoding` and `hostMemoryBytes` are not read.
/// @throws OutputExists, OutputError (also before anything is written, where the disk has not the room),
///         Cancelled, and what SearchEngine::visitRows() throws
void streamNpz(const std::string& path, SearchEngine& engine, const NeighborLists& counts, ListValues values,
               const OutputOptions& output = {}, std::uint64_t bufferBytes = 0,
               const SearchOptions& options = {});

} // namespace vdb_nns
