// What a benchmark found, as JSON, CSV and lines for people.
#pragma once

#include "bench/device_measures.h"
#include "bench/link.h"
#include "estimators.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Against the independent search, on sampled queries. Ordered pairs.
struct AccuracyReport {
    std::uint64_t checkedQueries = 0, missing = 0, extra = 0;
    std::optional<std::uint64_t> asymmetric; ///< pairs whose mirror is not in the lists; empty without lists
    double maxUlp = 0; ///< farthest wrong pair from the radius, in units in the last place of the radius
};

struct BenchResult {
    std::string scene, method;
    int threads = 0;
    std::uint64_t points = 0, pairs = 0;
    double radius = 0;
    std::uint64_t runs = 0;
    double gridSeconds = 0, searchSeconds = 0, totalSeconds = 0; ///< medians
    double minSeconds = 0, maxSeconds = 0;                       ///< of grid and search together
    double firstSeconds = 0;                                     ///< the first run, memory untouched
    std::uint64_t peakBytes = 0, structureBytes = 0, listBytes = 0;
    std::optional<std::uint64_t> checksum; ///< of all pairs; empty without lists
    AccuracyReport accuracy;
    std::optional<DeviceMeasures> device; ///< empty for a method of the CPU

    bool isExact() const
    {
        return accuracy.missing == 0 && accuracy.extra == 0 && accuracy.asymmetric.value_or(0) == 0;
    }
};

/// A method that finds other pairs than the first that has what is compared: their number, and their checksum; null if all agree.
const BenchResult* firstThatDiffers(const std::vector<BenchResult>& results);

std::string benchJson(const std::vector<BenchResult>& results, const std::optional<LinkRates>& link,
                      const std::vector<EstimatorResult>& estimators);
std::string benchCsv(const std::vector<BenchResult>& results);
std::string benchText(const std::vector<BenchResult>& results);
std::string estimatorsText(const std::vector<EstimatorResult>& estimators);

} // namespace vdb_nns::cli
