// What the child process of a stability trial does, and how it tells its parent.
#pragma once

#include "bench/stability/trial.h"

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace vdb_nns::cli {

enum class TrialPhase : int {
    kMake,  ///< particles, and what the condition asks to be known of them
    kRun,   ///< the method, under the limits
    kCheck, ///< truth and comparison
    kDone,
    kFailed ///< the case itself, in another phase than kRun
};

/// Lies in memory that child and parent share, so that what is known outlives a child that dies. Plain but for what the parent
/// reads meanwhile.
struct TrialRecord {
    std::atomic<TrialPhase> phase{TrialPhase::kMake};
    std::atomic<double> phaseBegan{0}; ///< by monotonicSeconds()

    Verdict verdict = Verdict::kExact;
    std::uint64_t missing = 0, extra = 0, duplicates = 0, asymmetric = 0, wrongValues = 0;
    bool hasAsymmetric = false;
    double seconds = 0;            ///< of the runs that came back
    std::uint64_t bytesBefore = 0; ///< resident, when the run began
    std::uint64_t peakBytes = 0;   ///< of the runs that came back
    static constexpr std::size_t kMessageBytes = 1000;
    char message[kMessageBytes] = {}; ///< cut to fit

    void enter(TrialPhase next);
    void say(const std::string& text);
};

/// Seconds of a clock that processes share.
double monotonicSeconds();

/// Everything, in the calling process, whose address space is limited meanwhile.
void doTrial(const StabilityCase& stabilityCase, const MethodSpec& spec, const TrialLimits& limits,
             const MethodMaker& make, TrialRecord& record);

} // namespace vdb_nns::cli
