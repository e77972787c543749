#include "bench/studies/estimators.h"

#include "cli_options.h"
#include "numbers.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/search.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <sstream>

namespace vdb_nns::cli {
namespace {

constexpr int kBlockLog2Cells = 6;
constexpr double kFewestPairs = 1e4;

struct BlockPairs {
    double truth = 0, expected = 0, reservedBytes = 0, usedBytes = 0;
};

// The leaves of a grid stand in Morton order, so blocks are runs of them.
std::vector<BlockPairs> blocksOf(const SparseGrid& grid, const WorkEstimate& truth,
                                 const WorkEstimate& estimate, const MemoryModel& model)
{
    std::vector<BlockPairs> blocks;
    BlockPairs open;
    const auto blockOf = [&](std::uint64_t leaf) {
        const Vec3i o = grid.leaf(leaf).origin;
        return Vec3i{o[0] >> kBlockLog2Cells, o[1] >> kBlockLog2Cells, o[2] >> kBlockLog2Cells};
    };
    WorkloadNode sized;
    const auto bytesOf = [&](const Work& work, const MemoryModel& of) {
        sized.work = work;
        return static_cast<double>(blockBytes(sized, of).down);
    };
    MemoryModel exact = model;
    exact.margin = exact.auxNeighbors = 0;
    for (std::uint64_t l = 0; l < grid.leafCount(); ++l) {
        if (l > 0 && open.truth >= kFewestPairs && blockOf(l) != blockOf(l - 1)) {
            blocks.push_back(open);
            open = {};
        }
        open.truth += truth.leaves[l].expectedPairs;
        // The size of masks is known, whatever the number of pairs.
        const Work& known = model.encoding == Encoding::kMask ? truth.leaves[l] : estimate.leaves[l];
        open.expected += known.expectedPairs;
        open.reservedBytes += bytesOf(estimate.leaves[l], model);
        open.usedBytes += bytesOf(truth.leaves[l], exact);
    }
    if (open.truth > 0) blocks.push_back(open);
    return blocks;
}

void judge(const std::vector<BlockPairs>& blocks, EstimatorResult& result)
{
    std::vector<std::pair<double, double>> errors;
    double truth = 0, expected = 0, square = 0, overflows = 0, reserved = 0, used = 0;
    for (const BlockPairs& block : blocks) {
        const double error = (block.expected - block.truth) / block.truth;
        errors.emplace_back(std::fabs(error), block.truth);
        truth += block.truth;
        expected += block.expected;
        square += block.truth * error * error;
        reserved += block.reservedBytes;
        used += block.usedBytes;
        if (block.usedBytes > block.reservedBytes) overflows += block.truth;
    }
    std::sort(errors.begin(), errors.end());
    result.blocks = blocks.size();
    if (truth <= 0) return;
    result.bias = expected / truth - 1;
    result.rmse = std::sqrt(square / truth);
    result.p50 = weightedQuantile(errors, 0.5 * truth);
    result.p99 = weightedQuantile(errors, 0.99 * truth);
    result.most = errors.back().first;
    result.overflowRate = overflows / truth;
    result.reservedOverUsed = reserved / used;
    result.reservedBytes = reserved;
    result.usedBytes = used;
}

// A name and the number behind its colon.
struct Choice {
    std::string name;
    std::optional<double> number;
};

Choice choiceOf(const std::string& text)
{
    const std::size_t colon = text.find(':');
    Choice choice{text.substr(0, colon), std::nullopt};
    if (colon != std::string::npos)
        choice.number = parsePositive(text.substr(colon + 1), "--estimator " + text);
    return choice;
}

EstimateOptions optionsOf(const std::string& text, double meanNeighbors)
{
    const Choice choice = choiceOf(text);
    const std::string& name = choice.name;
    EstimateOptions options;
    if (name == "paper") {
        options.estimator = Estimator::kMonteCarlo;
        if (choice.number) options.monteCarloSamples = static_cast<std::uint64_t>(*choice.number);
    }
    if (name == "uncorrected" || name == "mask") options.correctCrowding = false;
    if (name == "sampled") {
        options.estimator = Estimator::kSampled;
        if (choice.number) options.sampleFraction = *choice.number / 100;
    }
    if (name == "counted") options.estimator = Estimator::kCounted;
    if (name == "fixed") {
        options.estimator = Estimator::kFixed;
        options.fixedNeighbors = meanNeighbors;
    }
    return options;
}

std::vector<std::uint32_t> trueNeighbors(const SparseGrid& grid)
{
    SearchOptions options;
    options.encoding = Encoding::kNone;
    return SearchEngine().search(grid, options).counts();
}

// Two passes: sums of squares about the means.
ParticleErrors compare(const SparseGrid& grid, const std::vector<float>& expected,
                       const std::vector<std::uint32_t>& truth)
{
    ParticleErrors errors;
    const Span<const std::uint32_t> numbers = grid.particleNumbers();
    const auto count = static_cast<double>(grid.particleCount());
    double expectedSum = 0, truthSum = 0;
    for (const std::uint32_t i : numbers) {
        expectedSum += static_cast<double>(expected[i]);
        truthSum += truth[i];
    }
    double expectedSquares = 0, truthSquares = 0, products = 0, errorSquares = 0;
    for (const std::uint32_t i : numbers) {
        const double e = static_cast<double>(expected[i]) - expectedSum / count,
                     t = truth[i] - truthSum / count;
        expectedSquares += e * e;
        truthSquares += t * t;
        products += e * t;
        errorSquares += std::pow(static_cast<double>(expected[i]) - truth[i], 2);
    }
    errors.bias = (expectedSum - truthSum) / count;
    errors.rmse = std::sqrt(errorSquares / count);
    const double scale = std::sqrt(expectedSquares) * std::sqrt(truthSquares);
    if (scale > 0) errors.correlation = products / scale;
    return errors;
}

std::optional<ParticleErrors> judgeParticles(const std::string& name, const SparseGrid& grid,
                                             const EstimateOptions& options,
                                             const std::vector<std::uint32_t>& truth)
{
    if (grid.empty()) return std::nullopt;
    if (name == "fixed") {
        return compare(grid, std::vector<float>(truth.size(), static_cast<float>(options.fixedNeighbors)),
                       truth);
    }
    const std::string family = choiceOf(name).name;
    if (family != "paper" && family != "uncorrected") return std::nullopt;
    return compare(grid, expectNeighbors(grid, options), truth);
}

void checkNumber(const Choice& choice, const std::string& text)
{
    const bool isPaper = choice.name == "paper", isSampled = choice.name == "sampled";
    if (isPaper && *choice.number >= 1 && *choice.number <= 1e9) return;
    if (isSampled && *choice.number <= 100) return;
    throw InvalidInput("--estimator: '" + text + "': " +
                       (isPaper     ? "samples are 1 to 1e9"
                        : isSampled ? "per cent are above 0 and up to 100"
                                    : choice.name + " takes no number"));
}

} // namespace

const std::vector<std::string>& estimatorNames()
{
    // The paper's is Monte Carlo with its S_aux; uncorrected is the expectation by quadrature as it is; fixed is given the
    // true mean, which nobody knows; mask is the exact size of membership bits.
    static const std::vector<std::string> names = {"paper",   "uncorrected", "expected", "sampled",
                                                   "counted", "fixed",       "mask"};
    return names;
}

std::vector<std::string> parseEstimators(const std::string& list)
{
    if (list.empty()) return {};
    if (list == "all") {
        return {"paper:1e3", "paper:1e4", "paper:1e5",  "paper",   "uncorrected", "expected", "sampled:0.1",
                "sampled:1", "sampled:3", "sampled:10", "counted", "fixed",       "mask"};
    }
    std::vector<std::string> names;
    std::istringstream parts(list);
    for (std::string text; std::getline(parts, text, ',');) {
        const Choice choice = choiceOf(text);
        const auto& known = estimatorNames();
        if (std::find(known.begin(), known.end(), choice.name) == known.end()) {
            std::string all;
            for (const std::string& each : known) all += (all.empty() ? "" : ", ") + each;
            throw InvalidInput("--estimator: '" + text + "' is none; there are " + all +
                               ", paper:SAMPLES, sampled:PERCENT, or all");
        }
        if (choice.number) checkNumber(choice, text);
        names.push_back(text);
    }
    return names;
}

std::vector<EstimatorResult> measureEstimators(const std::string& scene,
                                               const std::vector<std::string>& names, const SparseGrid& grid,
                                               std::uint64_t repeat, Progress* progress)
{
    if (names.empty()) return {};
    const EstimateOptions counted = optionsOf("counted", 0);
    const std::vector<std::uint32_t> neighbors = trueNeighbors(grid);
    const WorkEstimate truth = estimateWork(grid, counted);
    const double mean =
        grid.particleCount() ? truth.total.expectedPairs / static_cast<double>(grid.particleCount()) : 0;
    std::vector<EstimatorResult> results;
    std::vector<double> searchSeconds;
    for (std::uint64_t run = 0; run < repeat; ++run)
        searchSeconds.push_back(estimateWork(grid, counted).seconds);
    for (const std::string& name : names) {
        EstimateOptions options = optionsOf(name, mean);
        options.progress = progress;
        EstimatorResult result;
        result.scene = scene;
        result.estimator = name;
        result.searchSeconds = median(searchSeconds);
        WorkEstimate estimate;
        std::vector<double> seconds;
        for (std::uint64_t run = 0; run < repeat; ++run) {
            estimate = estimateWork(grid, options);
            seconds.push_back(estimate.seconds);
        }
        result.seconds = median(seconds);
        result.countedQueries = estimate.countedQueries;
        MemoryModel model = memoryModel({}, name == "mask" ? Encoding::kMask : Encoding::kIndex, estimate);
        if (choiceOf(name).name == "paper") {
            model.margin = 0;
            model.auxNeighbors = 3.7;
        }
        if (name == "fixed" || name == "counted" || name == "uncorrected") model.margin = 0;
        judge(blocksOf(grid, truth, estimate, model), result);
        result.particles = judgeParticles(name, grid, options, neighbors);
        results.push_back(result);
    }
    return results;
}

} // namespace vdb_nns::cli
