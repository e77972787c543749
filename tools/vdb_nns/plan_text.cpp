// The summary of a plan on stdout.
#include "report.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::cli {
namespace {

double share(double part, double whole)
{
    return whole > 0 ? part / whole : 0;
}

std::string percent(double part, double whole)
{
    return format("%.0f %%", 100 * share(part, whole));
}

std::string estimateLine(const Plan& plan)
{
    std::string text = format("%.0f pairs, %.2f a particle; ", plan.total.expectedPairs,
                              share(plan.total.expectedPairs, static_cast<double>(plan.total.particles)));
    text += estimatorName(plan.estimator);
    if (plan.countedQueries > 0) {
        text += format(", %llu queries counted", static_cast<unsigned long long>(plan.countedQueries));
        if (plan.correction != 1) text += format(", corrected by %.3f", plan.correction);
    }
    return text;
}

std::string blocksLine(const Plan& plan)
{
    const std::vector<Block>& blocks = plan.schedule.blocks;
    if (blocks.empty()) return "none";
    std::int64_t edge = 0;
    std::uint64_t least = blocks[0].work.particles, most = 0;
    for (const Block& block : blocks) {
        edge = std::max(edge, edgeCells(block, plan));
        least = std::min(least, block.work.particles);
        most = std::max(most, block.work.particles);
    }
    const double mean = static_cast<double>(plan.total.particles) / static_cast<double>(blocks.size());
    return countText(blocks.size()) + (blocks.size() == 1 && plan.schedule.inCore ? " (all at once)" : "") +
           format(", edge up to %lld cells; particles min %llu  mean %.0f  max %llu",
                  static_cast<long long>(edge), static_cast<unsigned long long>(least), mean,
                  static_cast<unsigned long long>(most));
}

std::string busyText(double busy, double end)
{
    return format("busy %.6f s (", busy) + percent(busy, end) +
           format("), idle %.6f s", std::max(0.0, end - busy));
}

std::string executorLines(const Plan& plan)
{
    const Schedule& schedule = plan.schedule;
    const double particles = static_cast<double>(plan.total.particles);
    std::uint64_t cpuBlocks = schedule.blocks.size();
    std::string text;
    for (std::size_t d = 0; d < schedule.devices.size(); ++d) {
        const DevicePlan& device = schedule.devices[d];
        const std::uint64_t memory = plan.devices[d].memoryBytes;
        text += line(executorName(plan.devices, static_cast<int>(d)).c_str(),
                     plan.devices[d].name + ", " + countText(device.blocks) + " blocks, " +
                         countText(device.particles) + " particles (" +
                         percent(static_cast<double>(device.particles), particles) + ")");
        text +=
            line("", "memory: peak " + bytesText(device.peakBytes) + " of " + bytesText(memory) + " (" +
                         percent(static_cast<double>(device.peakBytes), static_cast<double>(memory)) + ")");
        text += line("", busyText(device.busySeconds, schedule.predictedSeconds));
        cpuBlocks -= device.blocks;
    }
    text +=
        line("cpu", countText(cpuBlocks) + " blocks, " + countText(schedule.cpuParticles) + " particles (" +
                        percent(static_cast<double>(schedule.cpuParticles), particles) + "), " +
                        countText(schedule.boundaryLeaves) + " boundary leaves of devices' blocks");
    if (schedule.tooLargeQueries > 0) {
        text +=
            line("", countText(schedule.tooLargeQueries) + " particles fit no device with their candidates");
    }
    return text + line("", busyText(schedule.cpuBusySeconds, schedule.predictedSeconds));
}

// Bytes of the .npz: 8 a row, and a 4 byte number and a 1 byte value a pair.
std::uint64_t outputBytes(const SearchReport& report)
{
    return 8 * (report.points + 1) +
           static_cast<std::uint64_t>(std::llround(5 * report.plan->total.expectedPairs));
}

} // namespace

namespace {

// How even they are.
std::string tilesLine(const std::vector<Tile>& tiles)
{
    std::uint64_t fewest = tiles.front().particles, most = 0, bytes = 0;
    for (const Tile& tile : tiles) {
        fewest = std::min(fewest, tile.particles);
        most = std::max(most, tile.particles);
        bytes = std::max(bytes, tile.bytes);
    }
    return countText(tiles.size()) + " of " + countText(fewest) + " to " + countText(most) +
           " particles, at most " + bytesText(bytes) + " each beside the points";
}

} // namespace

std::string planReportText(const SearchReport& report)
{
    const Plan& plan = *report.plan;
    const Schedule& schedule = plan.schedule;
    std::string text = line("particles", countText(report.points));
    const std::string voxels =
        report.radiusVoxels ? " (" + vectorText(*report.radiusVoxels) + " voxels)" : "";
    text += line("radius", shortest(report.radius) + voxels);
    text += line("skipped", countText(report.nonfinite) + " not finite");
    text += line("cells", countText(report.cells) + " in " + countText(report.leaves) + " leaves, edge " +
                              format("%.6g", report.cellSize) + "; grid " + bytesText(report.gridBytes));
    text += line("estimate", estimateLine(plan));
    text += line("tests", countText(plan.total.candidateTests));
    text += line("needs", bytesText(plan.everything.total()) + " at once: " + bytesText(plan.everything.up) +
                              " up, " + bytesText(plan.everything.down) + " down, " +
                              encodingName(report.encoding) + " lists");
    if (report.measureBytes)
        text += line("measures", bytesText(*report.measureBytes) + " of host memory besides");
    text += line("tree", countText(plan.treeLevels) + " levels, " + countText(plan.treeNodes) + " nodes");
    text += line("blocks", blocksLine(plan));
    if (!schedule.inCore) text += line("boundary", boundaryModeName(schedule.boundary));
    text += executorLines(plan);
    if (!report.tiles.empty()) text += line("tiles", tilesLine(report.tiles));
    text += line("output", "about " + bytesText(outputBytes(report)) + " as .npz");
    text +=
        line("predicted",
             format("%.6f s, %.2f times the lower bound of %.6f s (a model, nothing was searched)",
                    schedule.predictedSeconds, share(schedule.predictedSeconds, schedule.lowerBoundSeconds),
                    schedule.lowerBoundSeconds));
    text += timeLines(report.seconds);
    for (const std::string& path : report.written) text += line("written", path);
    return text;
}

std::string runText(const SearchReport& report)
{
    const Plan& plan = *report.plan;
    const ScheduleRun& run = *report.run;
    const double particles = static_cast<double>(plan.total.particles);
    const BlockErrors errors = blockErrors(plan.schedule, run);
    std::string text = line("estimate", estimateLine(plan));
    text += line(
        "", format("off by %+.2f %% in all; a block by %.2f %% (median), %.2f %% (99th percentile)",
                   100 * (share(plan.total.expectedPairs, static_cast<double>(report.result->pairs)) - 1),
                   100 * errors.p50, 100 * errors.p99));
    text += line("blocks", blocksLine(plan));
    for (std::size_t d = 0; d < run.devices.size(); ++d) {
        const DeviceRun& device = run.devices[d];
        text += line(executorName(plan.devices, static_cast<int>(d)).c_str(),
                     plan.devices[d].name + ", " + countText(device.blocks) + " blocks, " +
                         countText(device.particles) + " particles (" +
                         percent(static_cast<double>(device.particles), particles) + "), peak " +
                         bytesText(device.peakBytes) + " of " + bytesText(plan.devices[d].memoryBytes));
        if (!device.failure.empty()) text += line("", "failed: " + device.failure);
    }
    text += line("cpu", countText(run.cpuParticles) + " particles (" +
                            percent(static_cast<double>(run.cpuParticles), particles) + ")");
    if (run.overflows + run.retries + run.splits + run.halvings > 0) {
        text +=
            line("redone", countText(run.overflows) + " blocks overflowed, " + countText(run.retries) +
                               " runs repeated, " + countText(run.splits) +
                               " blocks split before, memory halved " + countText(run.halvings) + " times");
    }
    if (run.tooLargeQueries > 0) {
        text += line("", countText(run.tooLargeQueries) + " particles fit no device with their candidates");
    }
    return text + line("model", format("%.6f s on these devices, %.2f times the lower bound of %.6f s",
                                       run.seconds, share(run.seconds, plan.schedule.lowerBoundSeconds),
                                       plan.schedule.lowerBoundSeconds));
}

} // namespace vdb_nns::cli
