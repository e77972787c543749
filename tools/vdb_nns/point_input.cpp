#include "point_input.h"

#include "exit_codes.h"
#include "machine.h"
#include "standard_streams.h"
#include "vdb_nns/error.h"

namespace vdb_nns::cli {
namespace {

// What a bound on the process leaves for reading.
std::uint64_t bytesForReading(std::uint64_t boundBytes)
{
    if (boundBytes == 0) return 0;
    returnFreedMemory();
    const std::uint64_t resident = residentMemoryBytes();
    return boundBytes > resident ? boundBytes - resident : 1; // 0 would be no bound
}

} // namespace

void checkReadingPeak(std::uint64_t boundBytes, const std::string& what, const std::string& instead)
{
    const std::uint64_t peak = peakMemoryBytes();
    if (boundBytes == 0 || peak < boundBytes) return;
    throw CapacityError("reading " + what + " took " + std::to_string(peak) +
                            " bytes, the program included, and " + "--host-memory allows " +
                            std::to_string(boundBytes) + ": allow more host memory" + instead,
                        peak, boundBytes);
}

PointFile readPoints(const InputFlags& input, const PointNeeds& needs, const ProgressSpan& span,
                     Session& session, SearchReport& report)
{
    span.printer.begin("read", span.begin, span.end);
    const Stopwatch watch;
    PointFileOptions options = pointFileOptions(input, bytesForReading(needs.hostMemoryBytes), &span.printer);
    options.tile = needs.tile;
    if (options.tile && !input.radius.empty()) options.tile->radius = parsePositive(input.radius, "--radius");
    PointFile file = PointFile::read(input.path, options);
    if (!needs.quiet) {
        for (const std::string& note : file.notes()) say(input.path + ": " + note);
    }
    report.seconds.read = watch.seconds();
    checkReadingPeak(needs.hostMemoryBytes);
    report.path = session.path = input.path;
    const bool needsRadius = input.radius.empty() && !needs.hasRadii;
    const bool needsInfo = needs.info || needs.failNonfinite || needsRadius;
    if (needsInfo) report.info = file.info();
    if (needs.failNonfinite && report.info->nonfinite > 0) {
        throw CheckFailed(std::to_string(report.info->nonfinite) + " of " +
                          std::to_string(report.info->points) +
                          " points have a NaN or infinite coordinate; --nonfinite skip leaves them out");
    }
    session.grid = needsInfo ? report.info->grid : input.grid;
    if (needs.hasRadii) return file;
    const std::optional<double> suggested = needsInfo ? report.info->suggestedRadius : std::nullopt;
    report.radius = chooseRadius(input.radius, suggested, input.path, needs.quiet || !needs.tellsRadius);
    if (extensionOf(input.path) == ".vdb") {
        report.radiusVoxels = radiusInVoxels(file.view().linear(), report.radius);
    }
    return file;
}

QueryInput readQuerySets(const InputFlags& inputFlags, const QueryFlags& flags, const QueryPlan& plan,
                         const PointNeeds& needs, const ProgressSpan& span, Session& session,
                         SearchReport& report)
{
    const PointFile file = readPoints(inputFlags, needs, span, session, report);
    if (plan.isPlain()) {
        QueryInput input;
        input.candidates = file;
        input.plan = plan;
        return input;
    }
    const Stopwatch watch;
    QueryInput input = readQueryInput(file, flags, plan, inputFlags, needs.hostMemoryBytes, &span.printer);
    report.seconds.read += watch.seconds();
    report.badRadii = input.badRadii;
    if (input.queries) {
        report.queries = input.queries->info();
        if (needs.failNonfinite && report.queries->nonfinite > 0) {
            throw CheckFailed(std::to_string(report.queries->nonfinite) + " of " +
                              std::to_string(report.queries->points) +
                              " queries have a NaN or infinite coordinate; --nonfinite skip leaves them out");
        }
    }
    if (needs.failNonfinite && input.badRadii > 0) {
        throw CheckFailed(
            std::to_string(input.badRadii) +
            " points have a radius that is NaN, infinite or not positive; --nonfinite skip takes them "
            "as radii that reach nobody");
    }
    return input;
}

} // namespace vdb_nns::cli
