#include "bench/stability/matrix.h"

#include "bench/methods/other_methods.h"
#include "progress_printer.h"

namespace vdb_nns::cli {

std::vector<MethodSpec> stabilityMethods()
{
    std::vector<MethodSpec> specs;
    for (const char* name : {"ours-index", "ours-mask", "ours-count", "ours-visit", "blocks-index",
                             "blocks-mask", "both-auto-index", "filter-only", "world-float", "world-double",
                             "openvdb", "nanoflann-float", "nanoflann-double", "brute-force"}) {
        if (missingPeer(name).empty()) specs.push_back(parseMethod(name));
    }
    return specs;
}

std::vector<StabilityCell> runStability(const StabilityOptions& options)
{
    const std::vector<StabilityCase> cases = stabilityCases(options.cases);
    CellLimits limits;
    limits.seconds = options.secondsPerCell;
    limits.bytes = options.bytesPerCell;
    std::vector<StabilityCell> cells;
    const double all = static_cast<double>(cases.size() * options.methods.size());
    for (const StabilityCase& stabilityCase : cases) {
        for (const MethodSpec& spec : options.methods) {
            const double done = static_cast<double>(cells.size());
            if (options.progress) options.progress->begin("stability", done / all, (done + 1) / all);
            limits.threads = spec.threads > 0 ? spec.threads : options.threads;
            cells.push_back(runCell(stabilityCase, spec, limits));
        }
    }
    return cells;
}

bool oursHolds(const StabilityCell& cell)
{
    if (!cell.isExact || cell.verdict == Verdict::kSkipped) return true;
    if (cell.verdict == Verdict::kExact) return cell.right != RightOutcome::kRefusal;
    return cell.verdict == Verdict::kRefused && cell.right != RightOutcome::kAnswer && cell.isClear;
}

} // namespace vdb_nns::cli
