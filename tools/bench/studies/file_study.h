// The study of files: what a person waits for, from a point file to lists in a file, against what cannot be saved: the copying
// of the bytes, and the search.
#pragma once

#include "bench/bench_points.h"
#include "progress_printer.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// All seconds are medians of runs that took turns, with the files in the page cache and nothing flushed.
struct FileResult {
    std::string scene;
    std::uint64_t points = 0, pairs = 0, inputBytes = 0, outputBytes = 0;
    double readSeconds = 0;                    ///< of the point file
    std::optional<double> openVdbReadSeconds;  ///< the same by openvdb::io::File; for a .vdb
    double gridSeconds = 0, searchSeconds = 0; ///< of a warm engine, index lists
    double arrayGridSeconds = 0;               ///< from an array of the same positions
    double copySeconds = 0;                    ///< `cp` of input and output
    double wholeSeconds = 0;                   ///< `vdb_nns search IN -r RADIUS -o OUT.npz`, the process

    /// What the whole cannot be faster than by much.
    double floorSeconds() const { return copySeconds + gridSeconds + searchSeconds; }
};

struct FileStudyOptions {
    std::string path;                    ///< of the point file
    PointFileOptions input;              ///< how it is read
    std::vector<std::string> inputFlags; ///< the same, as flags of the program
    SearchOptions search;
    double radius = 0;
    int threads = 0;
    std::uint64_t repeat = 5;
};

/// Needs a program `cp`, and room for two copies of input and output in the folder for temporary files.
/// @throws InputError, OutputError, Cancelled
FileResult studyFiles(const std::string& scene, const FileStudyOptions& options, const ProgressSpan& span);

/// A folder of its own for temporary files, removed at the end with all that is in it.
class TemporaryFolder {
public:
    /// @throws OutputError
    TemporaryFolder();
    ~TemporaryFolder();
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;

    std::string file(const std::string& name) const { return mPath + "/" + name; }

private:
    std::string mPath;
};

} // namespace vdb_nns::cli
