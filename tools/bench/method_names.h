// From the names of methods to methods.
#pragma once

#include "bench/method.h"
#include "bench/methods/device_methods.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// The names of methods as the help has them.
std::string methodHelp();

/// @throws InvalidInput for an unknown name, or a peer that this program was built without
MethodSpec parseMethod(const std::string& name);

/// What the default depends on.
struct MethodSuits {
    std::string device;       ///< as --device has it where it names one, else empty
    std::uint64_t points = 0; ///< 0: not known yet
};

/// Names and names of groups (ours, devices, parts, approximate, peers) from a list with commas, checked. For an empty list those
/// that suit the machine and the number of points.
/// @throws InvalidInput
std::vector<MethodSpec> parseMethods(const std::string& list, const MethodSuits& suits);

/// Empty if the method has such a search, else a sentence that says what it lacks.
std::string missingSearch(const MethodSpec& spec, const SetSearch& search);

/// Empty if the method makes measures of such a search, else a sentence that says what it lacks.
std::string missingMeasures(const MethodSpec& spec, const SetSearch& search);

/// What methods need to be made.
struct MethodSetup {
    SearchOptions options;
    BenchDevices devices;
    double voxelSize = 1; ///< world edge; for codecs
};

std::unique_ptr<Method> makeMethod(const MethodSpec& spec, const MethodSetup& setup);

} // namespace vdb_nns::cli
