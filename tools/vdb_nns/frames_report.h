// What a search of frames did, as the JSON report and as lines on stdout.
#pragma once

#include "failure.h"
#include "report.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct FrameReport {
    int number = 0;
    std::string path;
    bool isSkipped = false;
    std::optional<SearchReport> report; ///< of a frame that was made
    std::optional<Failure> failure;
};

struct FramesReport {
    std::vector<FrameReport> frames; ///< in the order that they were asked for
    std::uint64_t peakBytes = 0;
    double seconds = 0;
};

/// The report of design 3.12: of each frame that of a single search and its number; of one that is not there, why.
std::string framesReportJson(const FramesReport& report);

/// A line for a frame that was made.
std::string frameText(const FrameReport& frame);
/// Lines of the whole, after those.
std::string framesReportText(const FramesReport& report);

} // namespace vdb_nns::cli
