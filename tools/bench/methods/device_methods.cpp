#include "bench/methods/device_methods.h"

#include "cli_options.h"
#include "machine.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/search.h"

#include <algorithm>

namespace vdb_nns::cli {
namespace {

bool isSimulated(const DeviceOptions& request)
{
    return std::all_of(request.devices.begin(), request.devices.end(),
                       [](const DeviceLimits& device) { return device.kind == DeviceKind::kSim; });
}

// Candidate tests are exact but where a few leaves told for all that everything fits.
std::uint64_t candidateTestsOf(const SparseGrid& grid, const Plan& plan)
{
    return plan.estimator == Estimator::kProbed ? countCandidateTests(grid) : plan.total.candidateTests;
}

void fillPlan(const DeviceOptions& request, const Plan& plan, DeviceMeasures& measures)
{
    measures.kind = deviceKindName(plan.devices.front().kind);
    measures.name = plan.devices.front().name;
    measures.inCore = plan.schedule.inCore;
    measures.boundary = plan.schedule.boundary;
    for (const DeviceLimits& device : plan.devices)
        measures.modelTestsPerSecond += device.rates.testsPerSecond;
    measures.isVirtual = isSimulated(request);
    if (measures.isVirtual) {
        measures.modelCpuSeconds =
            static_cast<double>(measures.candidateTests) / request.schedule.cpuTestsPerSecond;
    }
}

void fillRun(const Plan& plan, const ScheduleRun& run, DeviceMeasures& measures)
{
    for (std::size_t d = 0; d < run.devices.size(); ++d) {
        const DeviceRun& device = run.devices[d];
        if (d == 0 || device.peakBytes > measures.peakBytes) {
            measures.peakBytes = device.peakBytes;
            measures.budgetBytes = plan.devices[d].memoryBytes;
        }
        measures.peakSumBytes += device.peakBytes;
        measures.blocks += device.blocks;
        measures.particles += device.particles;
        measures.bytesUp += device.bytesUp;
        measures.bytesDown += device.bytesDown;
        measures.uploadSeconds += device.uploadSeconds;
        measures.searchSeconds += device.busySeconds;
        measures.downloadSeconds += device.downloadSeconds;
    }
    measures.overflows = run.overflows;
    measures.retries = run.retries;
    measures.splits = run.splits;
    measures.halvings = run.halvings;
    measures.cpuParticles = run.cpuParticles;
    measures.collectSeconds = run.collectSeconds;
}

class DeviceMethod : public MethodWithResult {
public:
    DeviceMethod(const MethodSpec& spec, const SearchOptions& options, const DeviceOptions& request,
                 bool isOnlyOne)
        : mSpec(spec), mRequest(request), mIsOnlyOne(isOnlyOne)
    {
        mRun.search = options;
        mRun.search.encoding = spec.encoding;
        mRun.search.wideCells = false; // masks are sent over the link
        mRun.schedule = request.schedule;
        mRun.onFailure = DeviceFailure::kStop; // what the CPU took over would be another method
    }

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        discard();
        const double planned = span.begin + 0.2 * (span.end - span.begin);
        MethodRun result;
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(view, radius, mRun.search);
        result.gridSeconds = gridWatch.seconds();
        span.printer.begin("plan", span.begin, planned);
        const Plan plan = makePlan(grid, mRequest, mSpec.encoding, PlanDetail::kAsNeeded, &span.printer);
        requireInCore(plan);

        span.printer.begin("search", planned, span.end);
        ScheduleRun run;
        const Stopwatch searchWatch;
        const NeighborLists lists = mEngine.search(grid, plan.schedule, plan.devices, mRun, run);
        result.searchSeconds = searchWatch.seconds();
        requireBudget(plan, run);

        result.pairs = lists.pairCount();
        result.structureBytes = grid.bytes();
        result.listBytes = lists.bytes();
        mFound = std::make_unique<EngineNeighbors>(lists);
        DeviceMeasures measures;
        measures.pairs = result.pairs;
        measures.candidateTests = candidateTestsOf(grid, plan);
        measures.estimateSeconds = plan.estimateSeconds;
        measures.planSeconds = plan.planSeconds;
        fillPlan(mRequest, plan, measures);
        fillRun(plan, run, measures);
        measures.makespanSeconds = measures.isVirtual ? run.seconds : result.searchSeconds;
        result.device = measures;
        return result;
    }

private:
    void requireInCore(const Plan& plan) const
    {
        if (mSpec.place != MethodPlace::kInCore || plan.schedule.inCore) return;
        const std::uint64_t needed = plan.everything.total(), allowed = plan.devices.front().memoryBytes;
        throw CapacityError(mSpec.name + ": everything at once needs about " + std::to_string(needed) +
                                " bytes, and " + plan.devices.front().name + " has " +
                                std::to_string(allowed) + "; use a method of blocks",
                            needed, allowed);
    }

    // With half the buffers it is another method than the one asked for, and in core not even that.
    void requireBudget(const Plan& plan, const ScheduleRun& run) const
    {
        if (run.halvings == 0) return;
        std::uint64_t asked = 0, taken = 0;
        for (const DeviceLimits& limits : plan.devices) asked = std::max(asked, limits.memoryBytes);
        for (const DeviceRun& device : run.devices) taken = std::max(taken, device.peakBytes);
        const std::string others = mIsOnlyOne ? "" : "other methods of this bench, or ";
        throw CapacityError(mSpec.name + ": " + plan.devices.front().name +
                                " refused memory within the budget of " + std::to_string(asked) +
                                " bytes: " + others +
                                "other programs hold device memory; use fewer methods at a time, or a "
                                "smaller --device-memory",
                            asked, taken);
    }

    const MethodSpec mSpec;
    const DeviceOptions mRequest;
    const bool mIsOnlyOne; // of this bench on devices
    RunOptions mRun;
    SearchEngine mEngine;
};

const MethodSpec* firstOf(const std::vector<MethodSpec>& methods, bool (*wanted)(const MethodSpec&))
{
    const auto found = std::find_if(methods.begin(), methods.end(), wanted);
    return found == methods.end() ? nullptr : &*found;
}

} // namespace

void checkDeviceFlags(const DeviceFlags& flags, const std::vector<MethodSpec>& methods)
{
    const MethodSpec* const onDevice = firstOf(methods, [](const MethodSpec& m) { return m.onDevice(); });
    const MethodSpec* const withBudget = firstOf(methods, [](const MethodSpec& m) { return m.hasBudget(); });
    const MethodSpec* const mapped =
        firstOf(methods, [](const MethodSpec& m) { return m.place == MethodPlace::kMapped; });
    if (!onDevice && flags.device != "auto" && flags.device != "cpu") {
        throw InvalidInput("--device " + flags.device +
                           ": no method of --method runs on a device; add one, e.g. blocks-mask");
    }
    if (onDevice && flags.device == "cpu") {
        throw InvalidInput(
            "--method: " + onDevice->name +
            " runs on a device, and --device cpu has none; use --device cuda, or --device sim");
    }
    if (!withBudget && !flags.deviceMemory.empty()) {
        throw InvalidInput("--device-memory is for methods of blocks, with the CPU or without, and --method "
                           "has none; methods "
                           "in core and mapped ones have all of the device's own");
    }
    if (!onDevice && !flags.sim.empty()) {
        throw InvalidInput("--sim describes a simulated device, and no method runs on one; add --device sim");
    }
    if (mapped && flags.device.compare(0, 3, "sim") == 0) {
        throw InvalidInput(
            "--method: " + mapped->name +
            " reads host memory through the link of a CUDA device, and a simulated one has none; use "
            "--device cuda");
    }
    if (!flags.deviceMemory.empty()) parseSize(flags.deviceMemory, "--device-memory");
}

BenchDevices benchDevices(const DeviceFlags& flags, const std::vector<MethodSpec>& methods, int threads)
{
    BenchDevices devices;
    const MethodSpec* const onDevice = firstOf(methods, [](const MethodSpec& m) { return m.onDevice(); });
    if (!onDevice) return devices;
    DeviceFlags whole = flags;
    whole.deviceMemory.clear();
    devices.request = deviceOptions(whole, threads);
    if (devices.request.devices.empty()) {
        throw DeviceError(
            "--method: " + onDevice->name +
            " runs on a device, and this machine has none; use --device sim for a simulated one");
    }
    if (!flags.deviceMemory.empty()) devices.budgetBytes = parseSize(flags.deviceMemory, "--device-memory");
    devices.methods = static_cast<std::size_t>(
        std::count_if(methods.begin(), methods.end(), [](const MethodSpec& m) { return m.onDevice(); }));
    return devices;
}

std::unique_ptr<Method> makeDeviceMethod(const MethodSpec& spec, const SearchOptions& options,
                                         const BenchDevices& devices)
{
    DeviceOptions request = devices.request;
    request.schedule.boundary = spec.boundary;
    request.schedule.blockLog2Cells = spec.blockLog2Cells;
    request.schedule.useCpu = spec.place == MethodPlace::kCpuAndDevice;
    if (!spec.hasBudget()) {
        request.devices.resize(1);
        request.schedule.oneBlock = true;
    }
    for (DeviceLimits& device : request.devices) {
        device.mapped = spec.place == MethodPlace::kMapped;
        if (spec.hasBudget() && devices.budgetBytes) device.memoryBytes = *devices.budgetBytes;
    }
    return std::make_unique<DeviceMethod>(spec, options, request, devices.methods == 1);
}

} // namespace vdb_nns::cli
