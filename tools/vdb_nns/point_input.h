// Reading the points of a command, and the radius that goes with them.
#pragma once

#include "cli_options.h"
#include "command.h"
#include "progress_printer.h"
#include "query_options.h"
#include "report.h"
#include "vdb_nns/point_file.h"

namespace vdb_nns::cli {

struct PointNeeds {
    bool info;          ///< the report says what is in the file, which costs a pass
    bool failNonfinite; ///< --nonfinite fail
    bool quiet;
    std::uint64_t hostMemoryBytes;       ///< --host-memory; 0: no bound
    bool hasRadii = false;               ///< points have radii of their own, so that no other is needed
    std::optional<TileOfFile> tile = {}; ///< of IN, whose radius is filled in; all else is not read
    bool tellsRadius = true;             ///< that the file suggests, on stderr
};

/// Reads the file; fills what report and session say of it: path, info, radius, seconds.
/// @throws CapacityError where the points do not fit the bound, CheckFailed for a non-finite point where that fails, InvalidInput without a radius, and as
///         PointFile::read()
PointFile readPoints(const InputFlags& input, const PointNeeds& needs, const ProgressSpan& span,
                     Session& session, SearchReport& report);

/// Reading may have taken more than it kept.
/// @param what that was read; `instead` ends the message with what may be done besides
/// @throws CapacityError where the process has had more resident than the bound; 0: no bound
void checkReadingPeak(std::uint64_t boundBytes, const std::string& what = "the points",
                      const std::string& instead = "");

/// IN, and what the flags about queries name; fills what the report says of that too.
/// @throws as readPoints() and readQueryInput(); CheckFailed for a bad radius or query where such points fail
QueryInput readQuerySets(const InputFlags& inputFlags, const QueryFlags& flags, const QueryPlan& plan,
                         const PointNeeds& needs, const ProgressSpan& span, Session& session,
                         SearchReport& report);

} // namespace vdb_nns::cli
