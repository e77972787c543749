#include "bench/stability/measure_task.h"

#include "numbers.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

namespace vdb_nns::cli {
namespace {

template <typename Number>
std::vector<Number> numbersOf(std::size_t count, const AttributeNumber& number)
{
    const auto largest = static_cast<double>(std::numeric_limits<Number>::max());
    std::vector<Number> numbers;
    for (std::size_t i = 0; i < count; ++i) numbers.push_back(static_cast<Number>(number(i, largest)));
    return numbers;
}

// Clusters are those of all pairs of one set.
bool hasClusters(const SetSearch& search)
{
    return search.isOneSet() && search.queries.chosen.empty() && search.candidates.chosen.empty() &&
           search.nearest == 0;
}

} // namespace

double ordinaryNumber(std::size_t i, double)
{
    return 1000 + static_cast<double>(mix64(i) >> 11) * 0x1p-53;
}

MeasureTask makeMeasureTask(std::size_t candidates, const AttributeNumber& number)
{
    MeasureTask task;
    task.floats = numbersOf<float>(candidates, number);
    task.doubles = numbersOf<double>(candidates, number);
    task.floatVectors = numbersOf<float>(3 * candidates, number);
    task.doubleVectors = numbersOf<double>(3 * candidates, number);
    task.integers = numbersOf<std::int32_t>(candidates, [&](std::size_t i, double largest) {
        const double value = number(i, largest);
        return std::isfinite(value) ? std::clamp(value, -largest, largest) : ordinaryNumber(i, largest);
    });
    return task;
}

SetSearch searchOf(const CaseParticles& particles)
{
    return particles.search ? *particles.search : SetSearch(particles.view, particles.radius);
}

std::vector<std::string> measuredNames(const SetSearch& search)
{
    std::vector<std::string> names;
    for (const std::string& name : measureNames()) {
        const bool isOfClusters = name == "cluster" || name == "cluster_size";
        if (isOfClusters && !hasClusters(search)) continue;
        if (name.back() != ':') {
            names.push_back(name);
            continue;
        }
        for (const char* attribute : {"f", "d", "v", "w", "i"}) names.push_back(name + attribute);
    }
    return names;
}

std::vector<MeasureOptions> measurePasses(const MeasureTask& task)
{
    const std::uint64_t count = task.floats.size();
    const auto pass = [&](SmoothingKernel kernel, const PcaOptions& pca,
                          std::optional<std::uint32_t> minNeighbors) {
        MeasureOptions options;
        options.kernel = kernel;
        options.pca = pca;
        options.minNeighbors = minNeighbors;
        options.masses = {task.masses.data(), task.masses.size()};
        options.attributes = {viewAttribute("f", AttributeType::kFloat, task.floats.data(), count),
                              viewAttribute("d", AttributeType::kDouble, task.doubles.data(), count),
                              viewAttribute("v", AttributeType::kVec3s, task.floatVectors.data(), count),
                              viewAttribute("w", AttributeType::kVec3d, task.doubleVectors.data(), count),
                              viewAttribute("i", AttributeType::kInt32, task.integers.data(), count)};
        return options;
    };
    // Of pca: anisotropy, stretch, threshold, average.
    return {pass(SmoothingKernel::kCubic, {0.25, 1, 20, 1}, std::nullopt),
            pass(SmoothingKernel::kWendland2, {0.25, 1.5, 0, 0}, 4),
            pass(SmoothingKernel::kPoly6, {0.5, 1, 20, 0}, 1),
            pass(SmoothingKernel::kTophat, {1e-3, 1, 2, 1}, std::nullopt)};
}

} // namespace vdb_nns::cli
