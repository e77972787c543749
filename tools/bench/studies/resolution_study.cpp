#include "bench/studies/resolution_study.h"

#include "bench/run_order.h"
#include "machine.h"
#include "numbers.h"
#include "vdb_nns/search.h"

#include <iterator>

namespace vdb_nns::cli {
namespace {

constexpr double kSizes[] = {1.0 / 3, 0.5, 1, 1.5, 2, 3, 4, 0}; // 0: auto

struct Times {
    std::vector<double> grid, search, total;
};

void runOnce(const BenchPoints& points, const ResolutionStudyOptions& options, bool isWarm,
             SearchEngine& engine, Times& times, ResolutionResult& result)
{
    SearchOptions search = options.search;
    search.encoding = result.encoding;
    search.cellSize = result.isAuto ? 0 : result.cellSize;
    const Stopwatch gridWatch;
    const SparseGrid grid = engine.buildGrid(points.view, options.radius, search);
    const double gridSeconds = gridWatch.seconds();
    const Stopwatch searchWatch;
    const NeighborLists lists = engine.search(grid, search);
    const double searchSeconds = searchWatch.seconds();
    if (isWarm) {
        times.grid.push_back(gridSeconds);
        times.search.push_back(searchSeconds);
        times.total.push_back(gridSeconds + searchSeconds);
        return;
    }
    if (result.isAuto) result.cellSize = grid.cellSize() / options.radius;
    result.reach = grid.reach();
    result.particles = grid.particleCount();
    result.cells = grid.cellCount();
    result.leaves = grid.leafCount();
    result.candidateTests = countCandidateTests(grid);
    result.structureBytes = grid.bytes();
    result.listBytes = lists.bytes();
}

} // namespace

std::vector<ResolutionResult> studyResolution(const BenchPoints& points,
                                              const ResolutionStudyOptions& options, const ProgressSpan& span)
{
    std::vector<ResolutionResult> results;
    SearchEngine engine; // one for all, so that all work in the same memory, on huge pages or not
    constexpr Encoding kEncodings[] = {Encoding::kIndex, Encoding::kMask, Encoding::kNone};
    const std::size_t steps = std::size(kEncodings) * (options.repeat + 1) * std::size(kSizes);
    std::size_t step = 0;
    for (const Encoding encoding : kEncodings) {
        std::vector<ResolutionResult> sizes;
        for (const double size : kSizes) {
            ResolutionResult result;
            result.scene = points.scene;
            result.encoding = encoding;
            result.isAuto = size == 0;
            result.cellSize = size;
            sizes.push_back(result);
        }
        std::vector<Times> times(sizes.size());
        for (std::uint64_t run = 0; run <= options.repeat; ++run) {
            for (const std::size_t k : orderOfRun(sizes.size(), run)) {
                const ProgressSpan part = span.part(step++, steps);
                part.printer.begin("resolution", part.begin, part.end);
                runOnce(points, options, run > 0, engine, times[k], sizes[k]);
            }
        }
        for (std::size_t k = 0; k < sizes.size(); ++k) {
            sizes[k].gridSeconds = median(times[k].grid);
            sizes[k].searchSeconds = median(times[k].search);
            sizes[k].totalSeconds = median(times[k].total);
        }
        results.insert(results.end(), sizes.begin(), sizes.end());
    }
    return results;
}

} // namespace vdb_nns::cli
