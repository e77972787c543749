#include "point_input.h"

#include "exit_codes.h"
#include "machine.h"

namespace vdb_nns::cli {

PointFile readPoints(const InputFlags& input, const PointNeeds& needs, const ProgressSpan& span,
                     Session& session, SearchReport& report)
{
    span.printer.begin("read", span.begin, span.end);
    const Stopwatch watch;
    PointFile file = PointFile::read(input.path, {input.grid, needs.hostMemoryBytes, &span.printer});
    report.seconds.read = watch.seconds();
    report.path = session.path = input.path;
    const bool needsInfo = needs.info || needs.failNonfinite || input.radius.empty();
    if (needsInfo) report.info = file.info();
    if (needs.failNonfinite && report.info->nonfinite > 0) {
        throw CheckFailed(std::to_string(report.info->nonfinite) + " of " +
                          std::to_string(report.info->points) +
                          " points have a NaN or infinite coordinate; --nonfinite skip leaves them out");
    }
    session.grid = needsInfo ? report.info->grid : input.grid;
    const std::optional<double> suggested = needsInfo ? report.info->suggestedRadius : std::nullopt;
    report.radius = chooseRadius(input.radius, suggested, input.path, needs.quiet);
    if (extensionOf(input.path) == ".vdb") {
        report.radiusVoxels = radiusInVoxels(file.view().linear(), report.radius);
    }
    return file;
}

} // namespace vdb_nns::cli
