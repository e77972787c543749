// What a search or a plan did, as the JSON report and as the summary on stdout. Plain data and functions to text.
#pragma once

#include "vdb_nns/measure.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/planning/executor.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/search_options.h"
#include "vdb_nns/search_sets.h"
#include "vdb_nns/tiles.h"
#include "vdb_nns/types.h"
#include "vdb_nns/write_points.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// The CPU.
struct DeviceReport {
    std::string kind = "cpu", name;
    std::optional<std::uint64_t> budgetBytes;
    int threads = 0;
};

struct SecondsReport {
    double read = 0, grid = 0, total = 0, firstGrid = 0;
    std::optional<double> estimate, plan, search, firstSearch, measure, checksum,
        write; ///< empty where a step did not run
};

/// Attributes that a search made.
struct WrittenMeasures {
    struct Attribute {
        std::string name, type; ///< type: attributeTypeName()
    };
    std::vector<Attribute> attributes;
    std::vector<std::string> groups;
    std::vector<Measured::Skipped> skipped; ///< values that are not finite, of attributes that are averaged
    std::vector<Conversion::Kept> kept;     ///< values of the input in new files of its points
    std::vector<Conversion::LeftOut> leftOut;
    double voxelSize = 0, largestRounding = 0; ///< of a new .vdb; 0 without one
};

/// A search of some rows alone.
struct TileReport {
    std::uint32_t tile = 0, tiles = 0; ///< tile: from 1
    std::uint64_t rows = 0;
};

struct SearchReport {
    std::string command = "search";
    std::string path;
    std::optional<PointFileInfo> info;    ///< made only where it is asked for: it costs a pass
    std::optional<PointFileInfo> queries; ///< where they are other points than those of `path`
    std::uint64_t points = 0, nonfinite = 0;
    std::uint64_t rows = 0, lattices = 1, badRadii = 0;
    double radius = 0;                 ///< the largest, if points have radii of their own
    std::optional<Vec3d> radiusVoxels; ///< empty for arrays
    double cellSize = 0;
    int reach = 1;
    std::uint64_t leaves = 0, cells = 0, gridBytes = 0, listBytes = 0;
    DeviceReport device;
    Encoding encoding = Encoding::kIndex;
    bool straightToFile = false; ///< lists were not held: their rows went to the file as they came
    std::uint64_t candidateTests = 0, doublePairs = 0, exactPairs = 0;
    std::string simd;
    std::optional<Plan> plan;                  ///< empty where nothing was planned
    std::optional<std::uint64_t> measureBytes; ///< of a plan with measures: host memory that they take
    std::optional<ScheduleRun> run;            ///< empty where no schedule was run
    std::optional<ListStatistics> result;      ///< empty for a dry run
    std::optional<std::uint64_t> checksum;
    std::uint64_t peakBytes = 0;
    std::optional<WrittenMeasures> measures; ///< empty where none are written
    std::optional<TileReport> tile;          ///< empty where all rows are found
    std::vector<Tile> tiles;                 ///< of a plan with --tiles
    SecondsReport seconds;
    std::vector<std::string> written;
};

/// What a report says of the grid and of the machine that made it.
void fillGridReport(const SearchSets& sets, const SearchOptions& options, SearchReport& report);

/// The report of design 3.8, keys in its order; null where a step did not run.
std::string searchReportJson(const SearchReport& report);
/// Aligned lines for people.
std::string searchReportText(const SearchReport& report);
// In plan_text.cpp: of a report with a plan, and what a search that followed one adds to its summary.
std::string planReportText(const SearchReport& report);
std::string runText(const SearchReport& report);

/// How far the pairs expected in a schedule's blocks were from those found.
struct BlockErrors {
    double p50 = 0,
           p99 = 0; ///< of |expected - found| / found, weighted by pairs; blocks under 10^4 pairs pooled
};
BlockErrors blockErrors(const Schedule& schedule, const ScheduleRun& run);

/// Edge of a block in cells; of the block of everything, that of the box around the occupied leaves.
std::int64_t edgeCells(const Block& block, const Plan& plan);
/// "sim:0" for the first device, "cpu" for Block::kOnCpu.
std::string executorName(const std::vector<DeviceLimits>& devices, int executor);

/// Lines of what came along into new files, and what could not.
std::string keptText(const std::vector<Conversion::Kept>& kept,
                     const std::vector<Conversion::LeftOut>& leftOut);
/// What a person has to know who does not read the report.
void warnOfLeftOut(const std::vector<Conversion::LeftOut>& leftOut);

/// What is in a point file.
std::string infoJson(const PointFileInfo& info);
std::string infoText(const PointFileInfo& info);

/// How many voxels the radius is long along each voxel axis: radius * |row_k(M^-1)|.
Vec3d radiusInVoxels(const Matrix3& linear, double radius);

const char* encodingName(Encoding encoding);
std::string checksumText(std::uint64_t checksum); ///< 16 hex digits
std::string shortest(double value);               ///< the fewest digits that read back as the same double
std::string format(const char* pattern, ...) __attribute__((format(printf, 1, 2)));

// Lines of the summaries. A value is made printable: it may come from a file.
std::string line(const char* label, const std::string& value);
std::string step(const char* label, double seconds, double total);
std::string timeLines(const SecondsReport& seconds); ///< of every step that ran
std::string vectorText(const Vec3d& v);
std::string bytesText(std::uint64_t bytes);
std::string countText(std::uint64_t count);

/// Sends a report where --json says: nowhere, to a file, or to stdout.
/// @throws OutputExists, OutputError
void deliverJson(const std::string& target, const std::string& json, const OutputOptions& options);

} // namespace vdb_nns::cli
