#include "bench/studies/scaling_study.h"

#include "numbers.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <utility>

namespace vdb_nns::cli {
namespace {

BenchPoints withPositions(const BenchPoints& points, std::vector<float> positions)
{
    BenchPoints result;
    result.scene = points.scene;
    result.voxelSize = points.voxelSize;
    result.positions = std::make_shared<const std::vector<float>>(std::move(positions));
    result.view = ParticleView::fromArray(result.positions->data(), result.positions->size() / 3);
    return result;
}

std::vector<float> positionsOf(const BenchPoints& points)
{
    std::vector<float> positions;
    positions.reserve(points.view.size() * 3);
    for (std::size_t i = 0; i < points.view.size(); ++i) {
        const Vec3d at = points.view.worldPosition(i);
        if (!std::isfinite(at[0]) || !std::isfinite(at[1]) || !std::isfinite(at[2])) continue;
        for (const double x : at) positions.push_back(static_cast<float>(x));
    }
    return positions;
}

// The lower part along the longest axis: a share of the particles, as dense as they were.
std::vector<float> lowerPart(const std::vector<float>& positions, double share)
{
    const std::size_t count = positions.size() / 3;
    std::size_t axis = 0;
    float longest = -1;
    for (std::size_t k = 0; k < 3; ++k) {
        float low = positions[k], high = positions[k];
        for (std::size_t i = 0; i < count; ++i) {
            low = std::min(low, positions[3 * i + k]);
            high = std::max(high, positions[3 * i + k]);
        }
        if (high - low > longest) {
            longest = high - low;
            axis = k;
        }
    }
    std::vector<std::uint32_t> order(count);
    std::iota(order.begin(), order.end(), 0u);
    const auto kept = static_cast<std::size_t>(share * static_cast<double>(count));
    const auto below = [&](std::uint32_t a, std::uint32_t b) {
        return std::make_pair(positions[3 * a + axis], a) < std::make_pair(positions[3 * b + axis], b);
    };
    std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(kept), order.end(), below);
    order.resize(kept);
    std::sort(order.begin(), order.end()); // in the order that they had
    std::vector<float> part;
    part.reserve(3 * kept);
    for (const std::uint32_t i : order) part.insert(part.end(), &positions[3 * i], &positions[3 * i] + 3);
    return part;
}

// Uniform in [-1, 1).
double signedUnit(std::uint64_t key)
{
    return static_cast<double>(mix64(key) >> 11) * 0x1p-52 - 1;
}

// Moves a share of the particles near to centers: other particles, one for 256 of those that are moved.
std::vector<float> clustered(std::vector<float> positions, double share, double radius)
{
    const std::uint64_t count = positions.size() / 3;
    const auto moved = static_cast<std::uint64_t>(share * static_cast<double>(count));
    const std::uint64_t centers = std::max<std::uint64_t>(1, moved / 256);
    const std::vector<float> original = positions;
    for (std::uint64_t i = 0; i < count; ++i) {
        if (mix64(2 * i) % count >= moved) continue;
        const std::uint64_t center = mix64(mix64(2 * i + 1) % centers) % count;
        for (std::uint64_t k = 0; k < 3; ++k) {
            const double at = original[3 * center + k] + radius * signedUnit(mix64(i) + k);
            positions[3 * i + k] = static_cast<float>(at);
        }
    }
    return positions;
}

class Study {
public:
    /// @param steps calls of run() and runThreads(), for progress
    Study(MethodStudyOptions options, const TruthOptions& truth, const ProgressSpan& span, std::size_t steps)
        : mOptions(std::move(options)), mTruth(truth), mSpan(span), mSteps(steps)
    {
    }

    void run(const char* vary, double value, const BenchPoints& points, double radius)
    {
        MethodStudyOptions options = mOptions;
        options.radius = radius;
        const ProgressSpan span = mSpan.part(mStep++, mSteps);
        const Truth truth = truthOf(points, radius, span);
        for (BenchResult& result : studyMethods(points, truth, options, afterTruth(span)))
            results.push_back({vary, value, std::move(result)});
    }

    void runThreads(const BenchPoints& points, double radius)
    {
        const std::vector<MethodSpec> all = mOptions.methods;
        const int most = mOptions.threads;
        mOptions.radius = radius;
        const ProgressSpan span = mSpan.part(mStep++, mSteps);
        const Truth truth = truthOf(points, radius, span);
        for (int threads = 1; threads <= most;
             threads = threads < most ? std::min(2 * threads, most) : most + 1) {
            MethodStudyOptions options = mOptions;
            for (MethodSpec& spec : options.methods) spec.threads = threads;
            for (BenchResult& result : studyMethods(points, truth, options, afterTruth(span)))
                results.push_back({"threads", static_cast<double>(threads), std::move(result)});
        }
    }

    std::vector<ScalingResult> results;

private:
    Truth truthOf(const BenchPoints& points, double radius, const ProgressSpan& span)
    {
        const ProgressSpan first = span.part(0, 10);
        first.printer.begin("truth", first.begin, first.end);
        return findTruth(points.view, radius, mTruth);
    }
    static ProgressSpan afterTruth(const ProgressSpan& span)
    {
        return {span.printer, span.part(0, 10).end, span.end};
    }

    MethodStudyOptions mOptions;
    TruthOptions mTruth;
    ProgressSpan mSpan;
    std::size_t mSteps, mStep = 0;
};

} // namespace

std::vector<ScalingResult> studyScaling(const BenchPoints& points, const MethodStudyOptions& options,
                                        const TruthOptions& truth, const ProgressSpan& span)
{
    constexpr double kShares[] = {0.125, 0.25, 0.5}, kRadii[] = {0.5, 0.75, 1.0, 1.25, 1.5},
                     kMoved[] = {0.0, 0.3, 0.6, 0.9};
    constexpr std::size_t kOfWhole = 2; // all points, threads
    Study study(options, truth, span, std::size(kShares) + kOfWhole + std::size(kRadii) + std::size(kMoved));
    const double radius = options.radius;
    const std::vector<float> positions = positionsOf(points);
    if (positions.empty()) return {};
    const BenchPoints whole = withPositions(points, positions);
    for (const double share : kShares) {
        std::vector<float> part = lowerPart(positions, share);
        if (part.empty()) continue;
        const auto count = static_cast<double>(part.size() / 3);
        study.run("points", count, withPositions(points, std::move(part)), radius);
    }
    study.run("points", static_cast<double>(whole.view.size()), whole, radius);
    study.runThreads(whole, radius);
    for (const double factor : kRadii) study.run("radius", factor * radius, whole, factor * radius);
    for (const double share : kMoved)
        study.run("clustering", share, withPositions(points, clustered(positions, share, radius)), radius);
    return std::move(study.results);
}

} // namespace vdb_nns::cli
