#include "device_options.h"

#include "cli_options.h"
#include "standard_streams.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kMostDevices = 16, kMostSlots = 16;
constexpr std::uint64_t kSmallestBlock = 8, kLargestBlock = 2048; // cells: a leaf, and half of an upper node
// Tests of one thread in a second, as measured on one core of an AMD EPYC: a default for predictions, not a property of
// this machine.
constexpr double kCpuTestsPerSecond = 2.5e9;

// A device under --sim. Published specifications; the rate of tests is a model, not a measurement: a tenth of the
// single precision peak, at 8 operations a test (3 subtractions, 3 products, 2 sums; the comparison is free).
constexpr double kShareOfPeak = 0.1, kFlopsPerTest = 8;
struct Preset {
    const char *key, *name;
    std::uint64_t memoryBytes;
    double linkBytesPerSecond, peakFlops;
};
constexpr Preset kPresets[] = {
    // NVIDIA, GeForce GTX 780 specifications: 3072 MB, 2304 cores at 863 MHz (3.977 TFLOP/s), PCI Express 3.0 x16:
    // 15.75 GB/s each way, 12 of them for transfers of pinned memory.
    {"gtx780", "simulated GTX 780", std::uint64_t(3) << 30, 12e9, 3.977e12},
    // NVIDIA H200 Tensor Core GPU datasheet (SXM): 141 GB, 67 TFLOP/s FP32, PCI Express 5.0 x16: 63 GB/s each way, 55
    // of them for transfers of pinned memory.
    {"h200", "simulated H200", 141'000'000'000u, 55e9, 67e12},
};

DeviceLimits presetDevice(const Preset& preset)
{
    DeviceLimits device;
    device.name = preset.name;
    device.memoryBytes = preset.memoryBytes;
    device.rates.testsPerSecond = kShareOfPeak * preset.peakFlops / kFlopsPerTest;
    device.rates.uploadBytesPerSecond = device.rates.downloadBytesPerSecond = preset.linkBytesPerSecond;
    return device;
}

// Without --sim: the defaults of Rates, and the memory of the paper's device.
DeviceLimits plainDevice()
{
    DeviceLimits device;
    device.name = "simulated";
    device.memoryBytes = std::uint64_t(3) << 30;
    return device;
}

struct Unit {
    const char* name;
    double factor;
};

// A number with one of some units, of any case; the first unit is meant where there is none.
double parseQuantity(const std::string& text, const std::string& what, const std::vector<Unit>& units,
                     double low, double high, const char* allowed)
{
    const auto fail = [&] { throw InvalidInput(what + ": '" + text + "' is not possible; give " + allowed); };
    char* end = nullptr;
    const double number = std::strtod(text.c_str(), &end);
    const bool isHex = text.find_first_of("xX") != std::string::npos;
    if (end == text.c_str() || isHex || std::isspace(static_cast<unsigned char>(text[0]))) fail();
    std::string unit(end);
    for (char& c : unit) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    const auto match =
        std::find_if(units.begin(), units.end(), [&](const Unit& u) { return unit == u.name; });
    if (!unit.empty() && match == units.end()) fail();
    const double value = number * (unit.empty() ? units.front().factor : match->factor);
    if (!(value >= low && value <= high)) fail();
    return value;
}

double parseBandwidth(const std::string& text, const std::string& what)
{
    static const std::vector<Unit> units = {{"gb/s", 1e9}, {"mb/s", 1e6}, {"tb/s", 1e12}};
    return parseQuantity(text, what, units, 1, 1e18, "GB/s above 0, e.g. 12GB/s");
}

double parseTestRate(const std::string& text, const std::string& what)
{
    static const std::vector<Unit> units = {{"tests/s", 1},    {"k", 1e3},        {"ktests/s", 1e3},
                                            {"m", 1e6},        {"mtests/s", 1e6}, {"g", 1e9},
                                            {"gtests/s", 1e9}, {"t", 1e12},       {"ttests/s", 1e12}};
    return parseQuantity(text, what, units, 1, 1e18, "tests a second above 0, e.g. 2.5Gtests/s");
}

double parseLatency(const std::string& text, const std::string& what)
{
    static const std::vector<Unit> units = {{"us", 1e-6}, {"ms", 1e-3}, {"s", 1}};
    return parseQuantity(text, what, units, 1e-9, 1e3,
                         "microseconds above 0, e.g. 20us, or seconds, e.g. 2e-5s");
}

void setSimKey(const std::string& key, const std::string& value, const std::string& spec,
               DeviceLimits& device)
{
    const std::string what = "--sim " + key;
    Rates& rates = device.rates;
    if (key == "pcie") {
        rates.uploadBytesPerSecond = rates.downloadBytesPerSecond = parseBandwidth(value, what);
    } else if (key == "up") {
        rates.uploadBytesPerSecond = parseBandwidth(value, what);
    } else if (key == "down") {
        rates.downloadBytesPerSecond = parseBandwidth(value, what);
    } else if (key == "rate") {
        rates.testsPerSecond = parseTestRate(value, what);
    } else if (key == "memory") {
        device.memoryBytes = parseSize(value, what);
    } else if (key == "latency") {
        rates.latencySeconds = parseLatency(value, what);
    } else if (key == "slots") {
        device.buffers = static_cast<int>(parseRange(value, what, 1, kMostSlots));
    } else {
        throw InvalidInput("--sim: '" + key + "' in '" + spec +
                           "' is not a key; use pcie, up, down, rate, memory, latency, slots");
    }
}

// "h200,memory=3GiB": a preset first, if any, then keys, each once.
DeviceLimits parseSim(const std::string& spec)
{
    DeviceLimits device = plainDevice();
    std::vector<std::string> seen;
    for (std::size_t begin = 0; begin <= spec.size();) {
        const std::size_t end = std::min(spec.find(',', begin), spec.size());
        const std::string item = spec.substr(begin, end - begin);
        const std::size_t equals = item.find('=');
        if (equals == std::string::npos) {
            const auto preset = std::find_if(std::begin(kPresets), std::end(kPresets),
                                             [&](const Preset& p) { return item == p.key; });
            if (preset == std::end(kPresets) || begin > 0) {
                throw InvalidInput(
                    "--sim: '" + item + "' in '" + spec +
                    "' is neither key=value nor, in the first place, a device that is known; use "
                    "gtx780 or h200, e.g. --sim h200,memory=3GiB");
            }
            device = presetDevice(*preset);
        } else {
            const std::string key = item.substr(0, equals);
            if (std::find(seen.begin(), seen.end(), key) != seen.end()) {
                throw InvalidInput("--sim: '" + spec + "' has the key " + key + " twice; give it once");
            }
            setSimKey(key, item.substr(equals + 1), spec, device);
            seen.push_back(key);
        }
        begin = end + 1;
    }
    return device;
}

// Of "NAME:N", the N; nothing for another name.
std::optional<std::string> numberAfter(const std::string& text, const std::string& name)
{
    if (text.compare(0, name.size() + 1, name + ":") != 0) return std::nullopt;
    return text.substr(name.size() + 1);
}

// Says which CUDA devices are not used, and why.
std::vector<DeviceLimits> allCudaDevices()
{
    std::vector<std::string> leftOut;
    std::vector<DeviceLimits> devices = cudaDevices(&leftOut);
    for (const std::string& reason : leftOut) say("left out: " + reason);
    return devices;
}

// The CUDA devices that `--device` asks for; throws for one that is not there.
std::vector<DeviceLimits> cudaDevicesOf(const std::string& device)
{
    const std::optional<std::string> number = numberAfter(device, "cuda");
    const std::uint64_t ordinal = number ? parseRange(*number, "--device cuda:N", 0, 999) : 0;
    try {
        return number ? std::vector<DeviceLimits>{cudaDevice(static_cast<int>(ordinal))} : allCudaDevices();
    } catch (const DeviceError& error) {
        throw DeviceError("--device " + device + ": " + error.what() +
                          "; use --device cpu, or --device sim for a simulated one");
    }
}

// What `auto` means: the CUDA devices of this machine, or none. Most machines have none, so nothing is said of why.
std::vector<DeviceLimits> anyDevices()
{
    try {
        return allCudaDevices();
    } catch (const DeviceError&) {
        return {};
    }
}

std::vector<DeviceLimits> devicesOf(const DeviceFlags& flags)
{
    if (flags.device == "cpu") return {};
    if (flags.device == "auto") return anyDevices();
    const std::optional<std::string> simCount = numberAfter(flags.device, "sim");
    if (flags.device == "sim" || simCount) {
        const std::uint64_t count = simCount ? parseRange(*simCount, "--device sim:N", 1, kMostDevices) : 1;
        return {count, flags.sim.empty() ? plainDevice() : parseSim(flags.sim)};
    }
    if (flags.device == "cuda" || numberAfter(flags.device, "cuda")) return cudaDevicesOf(flags.device);
    throw InvalidInput("--device: '" + flags.device +
                       "' is not a device; use auto, cpu, cuda, cuda:N, sim or sim:N");
}

// Flags that would do nothing: a mistake where the CPU was asked for. With `auto` they wait for a machine that has a
// device, but for --sim, which describes another one.
void checkUnused(const DeviceFlags& flags)
{
    const bool isSim = flags.device == "sim" || numberAfter(flags.device, "sim");
    if (!flags.sim.empty() && !isSim) {
        throw InvalidInput("--sim describes a simulated device, and --device is " + flags.device +
                           "; use --device sim");
    }
    if (flags.device != "cpu") return;
    const std::pair<const char*, bool> given[] = {{"--device-memory", !flags.deviceMemory.empty()},
                                                  {"--block-size", !flags.blockSize.empty()},
                                                  {"--boundary", flags.boundary != "auto"}};
    for (const auto& [flag, isGiven] : given) {
        if (!isGiven) continue;
        throw InvalidInput(
            std::string(flag) +
            " is about a device, and --device cpu has none; use --device cuda, or --device sim");
    }
}

Estimator parseEstimator(const std::string& name)
{
    for (const Estimator estimator : {Estimator::kExpected, Estimator::kMonteCarlo, Estimator::kSampled,
                                      Estimator::kCounted, Estimator::kFixed}) {
        if (name == estimatorName(estimator)) return estimator;
    }
    throw InvalidInput("--estimator: '" + name +
                       "' is not known; use expected, montecarlo, sampled, counted or fixed");
}

int parseBlockLog2(const std::string& text)
{
    const std::uint64_t cells = parseRange(text, "--block-size", kSmallestBlock, kLargestBlock);
    if ((cells & (cells - 1)) != 0) {
        throw InvalidInput("--block-size: '" + text +
                           "' is not a power of two; give 8, 16, 32, 64, 128, 256, 512, 1024 or 2048 cells");
    }
    int log2 = 0;
    while (cells >> (log2 + 1)) ++log2;
    return log2;
}

void addDeviceNameFlags(CLI::App& app, DeviceFlags& flags)
{
    app.add_option("--device", flags.device,
                   "what searches: auto, cpu, cuda, cuda:N, sim (a simulated device) or sim:N (N of them)")
        ->type_name("DEVICE")
        ->check(notEmpty())
        ->capture_default_str();
    app.add_option("--device-memory", flags.deviceMemory,
                   "memory of each device, as --host-memory has it; default: the device's own")
        ->type_name("SIZE")
        ->check(notEmpty());
}

void addSimFlag(CLI::App& app, DeviceFlags& flags)
{
    app.add_option(
           "--sim", flags.sim,
           "the simulated device: gtx780 or h200, then key=value of pcie, up, down (GB/s), rate (tests/s), "
           "memory, latency (us, s), slots, with commas; default: "
           "pcie=12GB/s,rate=2.5Gtests/s,memory=3GiB,latency=20us,slots=3")
        ->type_name("SPEC")
        ->check(notEmpty());
}

} // namespace

void addDeviceTargetFlags(CLI::App& app, DeviceFlags& flags)
{
    addDeviceNameFlags(app, flags);
    addSimFlag(app, flags);
}

void addDeviceFlags(CLI::App& app, DeviceFlags& flags)
{
    addDeviceNameFlags(app, flags);
    app.add_option(
           "--boundary", flags.boundary,
           "who runs queries that reach out of their block: cpu (the paper), halo (the device, which is "
           "sent the cells around the block too), or auto: what is predicted to end first")
        ->type_name("WHO")
        ->check(CLI::IsMember({"cpu", "halo", "auto"}))
        ->capture_default_str();
    app.add_option(
           "--estimator", flags.estimator,
           "how pairs are estimated: expected, montecarlo (the paper), sampled, counted (exact, and as dear "
           "as a search) or fixed (64 a particle)")
        ->type_name("NAME")
        ->check(CLI::IsMember({"expected", "montecarlo", "sampled", "counted", "fixed"}))
        ->capture_default_str();
    app.add_option(
           "--block-size", flags.blockSize,
           "blocks of at most N cells along an edge, a power of two from 8 to 2048 (the paper: 16, 32, 64); "
           "default: the largest that fit")
        ->type_name("N")
        ->check(notEmpty());
    addSimFlag(app, flags);
}

DeviceRequest deviceRequest(const DeviceFlags& flags, int threads)
{
    DeviceRequest request;
    request.estimate.estimator = parseEstimator(flags.estimator);
    // The paper's S_aux goes with the paper's estimate. A count is exact, and a fixed number is room by itself.
    constexpr double kPaperNeighbors = 3.7;
    switch (request.estimate.estimator) {
    case Estimator::kMonteCarlo:
        request.auxNeighbors = kPaperNeighbors;
        request.margin = 0;
        break;
    case Estimator::kCounted:
    case Estimator::kFixed:
        request.margin = 0;
        break;
    case Estimator::kExpected:
    case Estimator::kSampled:
    case Estimator::kProbed:
        break;
    }
    request.schedule.boundary = flags.boundary == "cpu"    ? BoundaryMode::kCpu
                                : flags.boundary == "halo" ? BoundaryMode::kHalo
                                                           : BoundaryMode::kAuto;
    if (!flags.blockSize.empty()) request.schedule.blockLog2Cells = parseBlockLog2(flags.blockSize);
    request.schedule.cpuTestsPerSecond = kCpuTestsPerSecond * threads;
    checkUnused(flags);
    request.devices = devicesOf(flags);
    if (!flags.deviceMemory.empty()) {
        const std::uint64_t bytes = parseSize(flags.deviceMemory, "--device-memory");
        for (DeviceLimits& device : request.devices) device.memoryBytes = bytes;
    }
    if (flags.device == "auto") request.onFailure = DeviceFailure::kUseCpu;
    return request;
}

MemoryModel memoryModel(const DeviceRequest& request, Encoding encoding, const WorkEstimate& estimate)
{
    // Twice the spread holds 95 % of blocks if errors are normal; below 2 % the sample cannot tell.
    constexpr double kSpreads = 2, kLeastMargin = 0.02;
    MemoryModel model;
    model.encoding = encoding;
    if (estimate.estimator == Estimator::kProbed) {
        model.margin = estimate.margin;
        model.masksAreExact = false;
        return model;
    }
    model.auxNeighbors = request.auxNeighbors;
    model.margin = request.margin ? *request.margin : std::max(kLeastMargin, kSpreads * estimate.margin);
    return model;
}

} // namespace vdb_nns::cli
