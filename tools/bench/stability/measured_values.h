// Whether the measures that a stability trial made are right.
#pragma once

#include "bench/stability/cases.h"
#include "bench/stability/trial_check.h"
#include "vdb_nns/measure.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Measures made with some options; `options.search` is not read.
struct MeasuredPass {
    std::vector<std::string> names;
    MeasureOptions options;
    Measured made;
};

/// All values of all passes: within the range that each measure has (value_ranges.h), and against the independent check of
/// `verify`. Sets wrongValues, and a message about the first.
/// @param particles of a case with measures
TrialCheck checkMeasured(const CaseParticles& particles, const std::vector<MeasuredPass>& passes);

/// Of all bytes: equal for equal measures.
std::uint64_t hashOfMeasured(const std::vector<MeasuredPass>& passes);

} // namespace vdb_nns::cli
