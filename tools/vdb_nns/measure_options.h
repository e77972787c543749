// Flags about measures, the numbers made of neighbors that become attributes, and what they name in files.
#pragma once

#include "cli_options.h"
#include "query_options.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/point_file.h"

#include <string>
#include <vector>

namespace vdb_nns::cli {

struct MeasureFlags {
    /// Names with commas between; what stands here before addMeasureFlags() is the default.
    std::string attributes;
    std::string prefix = "nns_", kernel = "cubic", mass = "1", massAttribute, minNeighbors;
    std::string pcaAnisotropy = "0.25", pcaStretch = "1", pcaThreshold = "20", pcaAverage = "1";
    /// Those of the flags with a default value that are there, be it with that value: "--kernel", "--mass", ...
    std::vector<std::string> given;
};
/// @param without what is taken without --attributes, where that has no default
void addMeasureFlags(CLI::App& app, MeasureFlags& flags, const std::string& without = {});

/// As --kernel has it.
const char* kernelName(SmoothingKernel kernel);

/// What the flags ask for.
struct MeasurePlan {
    std::vector<std::string> names; ///< of measures
    std::string prefix;
    MeasureOptions options; ///< but for masses, attributes and search
    std::string massAttribute;
    MeasuredNames results; ///< names and types of what is made; averages are float until attributes are read

    bool isCountAlone() const { return names.size() == 1 && names[0] == "count"; }
};

/// Checks the flags, alone and together, without a look at a file. An empty list of names is taken for one that is not known
/// yet: flags are not checked against it.
/// @throws InvalidInput
MeasurePlan checkMeasureFlags(const MeasureFlags& flags, const QueryPlan& query);
/// The same with other names than those of the flags.
MeasurePlan checkMeasureFlags(const MeasureFlags& flags, const std::vector<std::string>& names,
                              const QueryPlan& query);

/// Refuses flags about other measures than those of the names.
/// @throws InvalidInput
void checkMeasureUse(const MeasureFlags& flags, const std::vector<std::string>& names);

/// Values of the candidates that measures take.
struct MeasureInput {
    std::vector<double> masses;           ///< by particle number; empty without --mass-attribute
    std::vector<PointAttribute> averaged; ///< in the order of MeasuredNames::averaged
};

/// Reads the masses and the attributes that a plan needs.
/// @param progress may be null
/// @throws InvalidInput for names that are not there; InputError for values that are no numbers or cannot be averaged, and for
///         masses that are negative, NaN or infinite; and as PointFile::readValues()
MeasureInput readMeasureInput(const PointFile& candidates, const MeasurePlan& plan, Progress* progress);

/// The options of the plan with those values, which they view: `input` must stay where it is.
MeasureOptions optionsOf(const MeasurePlan& plan, const MeasureInput& input);

} // namespace vdb_nns::cli
