#include "bench/study_flags.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <vector>

namespace vdb_nns::cli {
namespace {

struct StudyFlag {
    const char* flag;
    std::vector<const char*> studies;
};

// Flags that are not here are heeded whatever is looked at.
const std::vector<StudyFlag>& studyFlags()
{
    const std::vector<const char*> withPoints = {"methods", "estimators", "budgets", "resolution",
                                                 "scaling", "model",      "files",   "radii",
                                                 "nearest", "measures"};
    static const std::vector<StudyFlag> flags = {
        {"--method", {"methods", "stability"}},
        {"--estimator", {"estimators"}},
        {"--csv", {"methods", "radii", "nearest", "measures"}},
        {"--sample", {"methods", "scaling", "radii", "nearest", "measures"}},
        {"--device", {"methods", "budgets", "model"}},
        {"--device-memory", {"methods", "budgets", "model"}},
        {"--sim", {"methods", "budgets", "model"}},
        {"--cell-size",
         {"methods", "estimators", "budgets", "scaling", "model", "radii", "nearest", "measures"}},
        {"--repeat", withPoints},
        {"--shuffle",
         {"methods", "estimators", "budgets", "resolution", "scaling", "model", "radii", "nearest",
          "measures"}},
        {"--seed", withPoints},
        {"--points-out", withPoints},
        {"--radius", withPoints},
        {"--grid", withPoints},
        {"--host-memory", withPoints}};
    return flags;
}

} // namespace

void checkStudyFlags(const std::set<std::string>& given, const std::set<std::string>& studies)
{
    for (const StudyFlag& each : studyFlags()) {
        const bool isHeeded = std::any_of(each.studies.begin(), each.studies.end(),
                                          [&](const char* study) { return studies.count(study) > 0; });
        if (isHeeded || !given.count(each.flag)) continue;
        std::string those;
        for (const char* study : each.studies) those += (those.empty() ? "" : ", ") + std::string(study);
        throw InvalidInput(std::string(each.flag) + " would change nothing here, it is for " + those +
                           ": leave it out, or add --study " + each.studies.front());
    }
}

} // namespace vdb_nns::cli
