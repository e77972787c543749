// What a search did, as the JSON report and as the summary on stdout. Plain data and two functions to text.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct DeviceReport {
    std::string kind = "cpu", name;
    std::optional<std::uint64_t> budgetBytes;
    int threads = 0;
};

struct SecondsReport {
    double read = 0, grid = 0, search = 0, total = 0;
    double firstGrid = 0, firstSearch = 0;
    std::optional<double> checksum, write;
};

struct SearchReport {
    std::string path;
    std::optional<PointFileInfo> info; ///< made only where it is asked for: it costs a pass
    std::uint64_t points = 0, nonfinite = 0;
    double radius = 0;
    std::optional<Vec3d> radiusVoxels; ///< empty for arrays
    double cellSize = 0;
    int reach = 1;
    std::uint64_t leaves = 0, cells = 0, gridBytes = 0, listBytes = 0;
    DeviceReport device;
    Encoding encoding = Encoding::kIndex;
    std::uint64_t candidateTests = 0, doublePairs = 0, exactPairs = 0;
    std::string simd;
    ListStatistics result;
    std::optional<std::uint64_t> checksum;
    std::uint64_t peakBytes = 0;
    SecondsReport seconds;
    std::vector<std::string> written;
};

/// The report of design 3.8, keys in its order; null where a step did not run.
std::string searchReportJson(const SearchReport& report);
/// Aligned lines for people.
std::string searchReportText(const SearchReport& report);

/// What is in a point file.
std::string infoJson(const PointFileInfo& info);
std::string infoText(const PointFileInfo& info);

/// How many voxels the radius is long along each voxel axis: radius * |row_k(M^-1)|.
Vec3d radiusInVoxels(const Matrix3& linear, double radius);

const char* encodingName(Encoding encoding);
std::string checksumText(std::uint64_t checksum); ///< 16 hex digits
std::string shortest(double value);               ///< the fewest digits that read back as the same double
std::string format(const char* pattern, ...) __attribute__((format(printf, 1, 2)));

/// Sends a report where --json says: nowhere, to a file, or to stdout.
/// @throws OutputExists, OutputError
void deliverJson(const std::string& target, const std::string& json, bool overwrite);

} // namespace vdb_nns::cli
