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

constexpr std::uint64_t kMostBuffers = 16;
constexpr std::uint64_t kSmallestBlock = 8, kLargestBlock = 2048; // cells: a leaf, and half of an upper node
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
        device.buffers = static_cast<int>(parseRange(value, what, 1, kMostBuffers));
    } else {
        throw InvalidInput("--sim: '" + key + "' in '" + spec +
                           "' is not a key; use pcie, up, down, rate, memory, latency, slots");
    }
}

// "h200,memory=3GiB": a preset first, if any, then keys, each once.
DeviceLimits parseSim(const std::string& spec)
{
    DeviceLimits device = simulatedDevice();
    std::vector<std::string> seen;
    for (std::size_t begin = 0; begin <= spec.size();) {
        const std::size_t end = std::min(spec.find(',', begin), spec.size());
        const std::string item = spec.substr(begin, end - begin);
        const std::size_t equals = item.find('=');
        if (equals == std::string::npos) {
            if (begin > 0 || (item != "gtx780" && item != "h200")) {
                throw InvalidInput(
                    "--sim: '" + item + "' in '" + spec +
                    "' is neither key=value nor, in the first place, a device that is known; use "
                    "gtx780 or h200, e.g. --sim h200,memory=3GiB");
            }
            device = simulatedDevice(item);
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

bool isSimulated(const std::string& device)
{
    return device == "sim" || device.compare(0, 4, "sim:") == 0;
}

// The devices that --device asks for, and says which CUDA devices are left out, and why.
DeviceOptions devicesOf(const DeviceFlags& flags, int threads)
{
    try {
        std::vector<std::string> leftOut;
        DeviceOptions options = chooseDevices(flags.device, threads, &leftOut);
        for (const std::string& reason : leftOut) say("left out: " + reason);
        return options;
    } catch (const InvalidInput& error) {
        throw InvalidInput(std::string("--device: ") + error.what());
    } catch (const DeviceError& error) {
        throw DeviceError("--device " + flags.device + ": " + error.what() +
                          "; use --device cpu, or --device sim for a simulated one");
    }
}

// Flags that would do nothing: a mistake where the CPU was asked for. With `auto` they wait for a machine that has a
// device, but for --sim, which describes another one.
void checkUnused(const DeviceFlags& flags)
{
    if (!flags.sim.empty() && !isSimulated(flags.device)) {
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
    app.add_option(
           "--device", flags.device,
           "where to search: auto, cpu, cuda (all GPUs), cuda:N, sim (a simulated device) or sim:N (N of "
           "them)")
        ->type_name("DEVICE")
        ->check(notEmpty())
        ->capture_default_str();
    app.add_option(
           "--device-memory", flags.deviceMemory,
           "memory that each device may use, in the units of --host-memory; default: what the device has "
           "free")
        ->type_name("SIZE")
        ->check(notEmpty());
}

void addSimFlag(CLI::App& app, DeviceFlags& flags)
{
    app.add_option("--sim", flags.sim,
                   "the simulated device: optionally gtx780 or h200, then key=value pairs separated by "
                   "commas: pcie, up, down "
                   "(GB/s), rate (tests/s), memory, latency (us, s), slots (blocks in flight); default: "
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
           "who runs queries that reach out of their block: cpu (the paper), halo (the device, which is also "
           "sent the cells around the block) or auto (whichever is predicted to end first)")
        ->type_name("WHO")
        ->check(CLI::IsMember({"cpu", "halo", "auto"}))
        ->capture_default_str();
    app.add_option("--estimator", flags.estimator,
                   "how pairs are estimated: expected, montecarlo (the paper), sampled, counted (exact, at "
                   "the cost of a "
                   "search) or fixed (64 a particle)")
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

DeviceOptions deviceOptions(const DeviceFlags& flags, int threads)
{
    const Estimator estimator = parseEstimator(flags.estimator);
    const int blockLog2Cells = flags.blockSize.empty() ? 0 : parseBlockLog2(flags.blockSize);
    checkUnused(flags);
    DeviceOptions options = devicesOf(flags, threads);
    if (!flags.sim.empty()) options.devices.assign(options.devices.size(), parseSim(flags.sim));
    useEstimator(options, estimator);
    options.schedule.blockLog2Cells = blockLog2Cells;
    options.schedule.boundary = flags.boundary == "cpu"    ? BoundaryMode::kCpu
                                : flags.boundary == "halo" ? BoundaryMode::kHalo
                                                           : BoundaryMode::kAuto;
    if (!flags.deviceMemory.empty()) {
        const std::uint64_t bytes = parseSize(flags.deviceMemory, "--device-memory");
        for (DeviceLimits& device : options.devices) device.memoryBytes = bytes;
    }
    return options;
}

} // namespace vdb_nns::cli
