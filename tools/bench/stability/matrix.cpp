#include "bench/stability/matrix.h"

#include "bench/methods/other_methods.h"
#include "progress_printer.h"

namespace vdb_nns::cli {

std::vector<MethodSpec> stabilityMethods()
{
    std::vector<MethodSpec> specs;
    for (const char* name :
         {"ours-index", "ours-mask", "ours-count", "ours-visit", "blocks-index", "blocks-mask",
          "both-auto-index", "filter-only", "world-float", "world-double", "openvdb", "nanoflann-float",
          "nanoflann-double", "treensearch", "brute-force"}) {
        if (missingPeer(name).empty()) specs.push_back(parseMethod(name));
    }
    return specs;
}

std::vector<StabilityTrial> runStability(const StabilityOptions& options)
{
    const std::vector<StabilityCase> cases = stabilityCases(options.cases);
    TrialLimits limits;
    limits.seconds = options.secondsPerTrial;
    limits.bytes = options.bytesPerTrial;
    std::vector<StabilityTrial> trials;
    const double all = static_cast<double>(cases.size() * options.methods.size());
    for (const StabilityCase& stabilityCase : cases) {
        for (const MethodSpec& spec : options.methods) {
            const double done = static_cast<double>(trials.size());
            if (options.progress) options.progress->begin("stability", done / all, (done + 1) / all);
            limits.threads = spec.threads > 0 ? spec.threads : options.threads;
            trials.push_back(runTrial(stabilityCase, spec, limits));
        }
    }
    return trials;
}

bool oursHolds(const StabilityTrial& trial)
{
    if (!trial.isExact || trial.verdict == Verdict::kSkipped) return true;
    if (trial.verdict == Verdict::kExact) return trial.right != RightOutcome::kRefusal;
    return trial.verdict == Verdict::kRefused && trial.right != RightOutcome::kAnswer && trial.isClear;
}

} // namespace vdb_nns::cli
