// Devices by name, and what the search takes them to be able to do.
#include "vdb_nns/error.h"
#include "vdb_nns/planning/devices.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <charconv>
#include <iterator>

namespace vdb_nns {
namespace {

constexpr int kMostSimulated = 16, kMostOrdinal = 999;

// Tests of one thread in a second, as measured on one core of an AMD EPYC: a default for predictions, not a property of
// this machine.
constexpr double kTestsPerSecondOfThread = 2.5e9;

// A model of a device. Published specifications; the rate of tests is a model, not a measurement: a tenth of the single
// precision peak, at 8 operations a test (3 subtractions, 3 products, 2 sums; the comparison is free).
constexpr double kShareOfPeak = 0.1, kFlopsPerTest = 8;
struct Model {
    const char *key, *name;
    std::uint64_t memoryBytes;
    double linkBytesPerSecond, peakFlops;
};
constexpr Model kModels[] = {
    // NVIDIA, GeForce GTX 780 specifications: 3072 MB, 2304 cores at 863 MHz (3.977 TFLOP/s), PCI Express 3.0 x16:
    // 15.75 GB/s each way, 12 of them for transfers of pinned memory.
    {"gtx780", "simulated GTX 780", std::uint64_t(3) << 30, 12e9, 3.977e12},
    // NVIDIA H200 Tensor Core GPU datasheet (SXM): 141 GB, 67 TFLOP/s FP32, PCI Express 5.0 x16: 63 GB/s each way, 55
    // of them for transfers of pinned memory.
    {"h200", "simulated H200", 141'000'000'000u, 55e9, 67e12},
};

// Of "KIND:N", the N, `least` to `most`; `none` for "KIND" alone.
int numberAfter(const std::string& name, const std::string& kind, int none, int least, int most)
{
    if (name == kind) return none;
    int number = -1;
    const char *begin = name.data() + kind.size() + 1, *end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(begin, end, number);
    if (error != std::errc() || stop != end || number < least || number > most) {
        throw InvalidInput("'" + name + "': N of " + kind + ":N is a whole number from " +
                           std::to_string(least) + " to " + std::to_string(most));
    }
    return number;
}

bool isOfKind(const std::string& name, const std::string& kind)
{
    return name == kind || name.compare(0, kind.size() + 1, kind + ":") == 0;
}

// Most machines have no CUDA device, so nothing is said of why.
std::vector<DeviceLimits> anyCudaDevices(std::vector<std::string>* leftOut)
{
    try {
        return cudaDevices(leftOut);
    } catch (const DeviceError&) {
        if (leftOut) leftOut->clear();
        return {};
    }
}

std::vector<DeviceLimits> devicesNamed(const std::string& name, std::vector<std::string>* leftOut)
{
    if (name == "cpu") return {};
    if (name == "auto") return anyCudaDevices(leftOut);
    if (isOfKind(name, "sim")) {
        const int count = numberAfter(name, "sim", 1, 1, kMostSimulated);
        return {static_cast<std::size_t>(count), simulatedDevice()};
    }
    if (isOfKind(name, "cuda")) {
        const int ordinal = numberAfter(name, "cuda", -1, 0, kMostOrdinal);
        return ordinal < 0 ? cudaDevices(leftOut) : std::vector<DeviceLimits>{cudaDevice(ordinal)};
    }
    throw InvalidInput("'" + name + "' is not a device; use auto, cpu, cuda, cuda:N, sim or sim:N");
}

} // namespace

void useEstimator(DeviceOptions& options, Estimator estimator)
{
    constexpr double kPaperNeighbors = 3.7;
    options.estimate.estimator = estimator;
    options.auxNeighbors = 0;
    options.margin.reset();
    switch (estimator) {
    case Estimator::kMonteCarlo:
        options.auxNeighbors = kPaperNeighbors;
        options.margin = 0;
        break;
    case Estimator::kCounted:
    case Estimator::kFixed:
        options.margin = 0;
        break;
    case Estimator::kExpected:
    case Estimator::kSampled:
    case Estimator::kProbed:
        break;
    }
}

DeviceOptions chooseDevices(const std::string& name, int threads, std::vector<std::string>* leftOut)
{
    DeviceOptions options;
    options.devices = devicesNamed(name, leftOut);
    if (threads == 0) threads = tbb::this_task_arena::max_concurrency();
    options.schedule.cpuTestsPerSecond = kTestsPerSecondOfThread * threads;
    if (name == "auto") options.onFailure = DeviceFailure::kUseCpu;
    return options;
}

DeviceLimits simulatedDevice(const std::string& model)
{
    DeviceLimits device;
    device.name = "simulated";
    device.memoryBytes = std::uint64_t(3) << 30;
    if (model.empty()) return device;
    const auto known =
        std::find_if(std::begin(kModels), std::end(kModels), [&](const Model& m) { return model == m.key; });
    if (known == std::end(kModels)) {
        throw InvalidInput("'" + model + "' is not a simulated device that is known; use gtx780 or h200");
    }
    device.name = known->name;
    device.memoryBytes = known->memoryBytes;
    device.rates.testsPerSecond = kShareOfPeak * known->peakFlops / kFlopsPerTest;
    device.rates.uploadBytesPerSecond = device.rates.downloadBytesPerSecond = known->linkBytesPerSecond;
    return device;
}

} // namespace vdb_nns
