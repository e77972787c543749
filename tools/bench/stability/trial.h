// One trial of `bench --stability`: a method on a case, in a process of its own that may die, hang or run out of memory.
#pragma once

#include "bench/method_names.h"
#include "bench/stability/cases.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

namespace vdb_nns::cli {

enum class Verdict {
    kExact,
    kWrong, ///< it answered, and pairs are missing, extra, listed twice, measures wrong, or both differ from run to run
    kRefused, ///< it threw an exception that says why
    kCrash,   ///< a signal killed it, it ended the program, or threw what nobody promised
    kHang,    ///< it took longer than it may
    kMemory,  ///< it took more than it may, or the system killed it for that
    kSkipped  ///< the case is not about such methods
};

/// exact, wrong, refused, crash, hang, memory, skipped.
const char* verdictName(Verdict verdict);

struct TrialLimits {
    double seconds = 120; ///< of each run, by the clock: room for a busy machine
    std::uint64_t bytes = std::uint64_t(4)
                          << 30; ///< of address space, beyond what the process has and its threads' stacks
    int threads = 0;             ///< 0: all
};

struct StabilityTrial {
    std::string caseName, group, what, method;
    Verdict verdict = Verdict::kSkipped;
    std::uint64_t missing = 0, extra = 0, duplicates = 0; ///< ordered pairs, of all runs together
    std::optional<std::uint64_t> asymmetric;    ///< of wrong pairs; empty without rows, or with rows known
    std::uint64_t wrongValues = 0;              ///< of measures, of all runs together
    double seconds = 0;                         ///< of all runs; until it died
    std::uint64_t peakBytes = 0;                ///< resident, beyond what the process had before the run
    std::string message;                        ///< of a refusal, a crash or a skip
    bool isExact = false;                       ///< the method promises exact pairs
    RightOutcome right = RightOutcome::kAnswer; ///< of such a method
    bool isClear = true;                        ///< a refusal says what it has to
};

using MethodMaker = std::function<std::unique_ptr<Method>(const MethodSpec&, const MethodSetup&)>;

/// Forks, and waits for the child. What the method prints is dropped, but for the last line of stderr where it dies.
/// @param make makeMethod(), or a double of a test
/// @throws Cancelled once SIGINT or SIGTERM came, with the child gone
/// @throws std::runtime_error where the case itself fails, and in a process that has started threads
StabilityTrial runTrial(const StabilityCase& stabilityCase, const MethodSpec& spec, const TrialLimits& limits,
                        const MethodMaker& make = makeMethod);

} // namespace vdb_nns::cli
