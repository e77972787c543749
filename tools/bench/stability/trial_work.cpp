#include "bench/stability/trial_work.h"

#include "bench/stability/measure_task.h"
#include "bench/stability/measured_values.h"
#include "bench/stability/trial_check.h"
#include "machine.h"
#include "numbers.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/planning/plan.h"
#include "vdb_nns/search.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstring>
#include <fstream>
#include <new>
#include <numeric>
#include <sys/resource.h>
#include <unistd.h>
#include <xmmintrin.h>

namespace vdb_nns::cli {
namespace {

constexpr std::uint64_t kMostBruteForce = 50'000; // particles: some seconds
// Of address space: the stack of a thread, and the arena of its heap.
constexpr std::uint64_t kThreadBytes = std::uint64_t(80) << 20;

std::uint64_t mappedBytes()
{
    std::uint64_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    return pages * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
}

// The soft limit alone, so that it can be lifted again.
class AddressLimit {
public:
    AddressLimit(std::uint64_t bytes, int threads)
    {
        getrlimit(RLIMIT_AS, &mBefore);
        rlimit limit = mBefore;
        limit.rlim_cur = std::min<rlim_t>(
            mBefore.rlim_max, mappedBytes() + bytes + static_cast<std::uint64_t>(threads) * kThreadBytes);
        setrlimit(RLIMIT_AS, &limit);
    }
    ~AddressLimit() { setrlimit(RLIMIT_AS, &mBefore); }
    AddressLimit(const AddressLimit&) = delete;
    AddressLimit& operator=(const AddressLimit&) = delete;

private:
    rlimit mBefore = {};
};

// Of a simulated device, for methods that have all of it.
constexpr std::uint64_t kDeviceBytes = std::uint64_t(3) << 30;

DeviceLimits simulatedDeviceOf(std::uint64_t bytes)
{
    DeviceLimits device = simulatedDevice();
    device.memoryBytes = bytes;
    return device;
}

// Of everything as one block, as an honest estimate has it.
std::uint64_t bytesAtOnce(const CaseParticles& particles, Encoding encoding, ProgressPrinter& progress)
{
    SearchEngine engine;
    const SparseGrid grid = engine.buildGrid(particles.view, particles.radius);
    DeviceOptions request;
    request.devices = {simulatedDeviceOf(~std::uint64_t(0) >> 8)};
    return makePlan(grid, request, encoding, PlanDetail::kFull, &progress).everything.total();
}

// What was allowed, and as much more as the refusal says to lack.
std::uint64_t grown(std::uint64_t allowed, const CapacityError& refusal)
{
    if (refusal.neededBytes() <= refusal.allowedBytes()) throw refusal;
    return allowed + (refusal.neededBytes() - refusal.allowedBytes());
}

constexpr std::uint64_t kLeastBytes = 1024;
constexpr int kMostRefusals = 100;

std::uint64_t bytesOfGridAlone(const CaseParticles& particles)
{
    SearchOptions options;
    options.hostMemoryBytes = kLeastBytes;
    for (int k = 0;; ++k) {
        try {
            SearchEngine().buildGrid(particles.view, particles.radius, options);
            return options.hostMemoryBytes;
        } catch (const CapacityError& refusal) {
            if (k == kMostRefusals) throw;
            options.hostMemoryBytes = grown(options.hostMemoryBytes, refusal);
        }
    }
}

std::string whySkipped(const StabilityCase& stabilityCase, const MethodSpec& spec, const CaseParticles& made)
{
    const std::size_t particles = made.view.size();
    if (made.measures) return missingMeasures(spec, searchOf(made));
    if (made.search) {
        const std::string missing = missingSearch(spec, *made.search);
        if (!missing.empty()) return missing;
    }
    if (stabilityCase.condition.isForDevices() && !spec.hasBudget()) return "has no device with a budget";
    if (stabilityCase.condition.isForHostRoom() && !spec.isExact()) return "knows no bound of host memory";
    if (spec.family == "brute-force" && particles > kMostBruteForce) {
        return "would take too long with " + std::to_string(particles) + " particles";
    }
    return {};
}

struct RunPlan {
    int threads = 0;
    std::vector<std::uint32_t> order = {}; // of the particles; empty: as they are
    std::array<bool, 3> negated = {};      // axes
    bool isOtherWay = false; // of measures: other cells, no SIMD, in a host that flushes denormals

    bool isMirrored() const { return negated[0] || negated[1] || negated[2]; }
};

// What a host sets that renders: denormals are 0.
class FlushedDenormals {
public:
    FlushedDenormals() : mBefore(_mm_getcsr()) { _mm_setcsr(mBefore | 0x8040u); }
    ~FlushedDenormals() { _mm_setcsr(mBefore); }
    FlushedDenormals(const FlushedDenormals&) = delete;
    FlushedDenormals& operator=(const FlushedDenormals&) = delete;

private:
    const unsigned mBefore;
};

std::vector<RunPlan> plansOf(const RunCondition& condition, const TrialLimits& limits,
                             const CaseParticles& made)
{
    if (made.measures) return {{limits.threads}, {1, {}, {}, true}};
    const std::size_t particles = made.view.size();
    if (condition.threadCounts) {
        const int cores = tbb::info::default_concurrency();
        std::vector<int> counts = {1, 2, 3, cores, 2 * cores};
        std::sort(counts.begin(), counts.end());
        counts.erase(std::unique(counts.begin(), counts.end()), counts.end());
        std::vector<RunPlan> plans;
        for (const int threads : counts) plans.push_back({threads, {}});
        return plans;
    }
    std::vector<RunPlan> plans = {{limits.threads, {}}};
    if (condition.shuffled) {
        std::vector<std::uint32_t> order(particles);
        std::iota(order.begin(), order.end(), 0u);
        for (std::size_t k = order.size(); k > 1; --k) std::swap(order[k - 1], order[mix64(k) % k]);
        plans.push_back({limits.threads, order});
    }
    if (condition.mirrored) {
        plans.push_back({limits.threads, {}, {true, false, false}});
        plans.push_back({limits.threads, {}, {true, true, true}});
    }
    return plans;
}

// The particles in another order or mirrored, as an array of doubles.
CaseParticles arranged(const CaseParticles& particles, const RunPlan& plan)
{
    if (plan.order.empty() && !plan.isMirrored()) return particles;
    const auto xyz = std::make_shared<std::vector<double>>();
    const std::size_t count = particles.view.size();
    for (std::size_t k = 0; k < count; ++k) {
        const Vec3d at = particles.view.worldPosition(plan.order.empty() ? k : plan.order[k]);
        for (std::size_t axis = 0; axis < 3; ++axis)
            xyz->push_back(plan.negated[axis] ? -at[axis] : at[axis]);
    }
    return {ParticleView::fromArray(xyz->data(), count), particles.radius, particles.known, xyz};
}

class TrialRunner {
public:
    TrialRunner(const StabilityCase& stabilityCase, const MethodSpec& spec, const TrialLimits& limits,
                const MethodMaker& make, TrialRecord& record)
        : mCase(stabilityCase), mSpec(spec), mLimits(limits), mMake(make), mRecord(record)
    {
    }

    void run()
    {
        const std::optional<CaseParticles> particles = makeParticles();
        if (!particles) return;
        const std::string skip = whySkipped(mCase, mSpec, *particles);
        if (!skip.empty()) return conclude(Verdict::kSkipped, skip);
        std::optional<std::uint64_t> firstSum;
        for (const RunPlan& plan : plansOf(mCase.condition, mLimits, *particles)) {
            ThreadLimit threads(plan.threads);
            const bool goesOn =
                threads.run([&] { return runOnce(*particles, plan, threads.count(), firstSum); });
            if (!goesOn) return;
        }
    }

private:
    void conclude(Verdict verdict, const std::string& message)
    {
        mRecord.verdict = verdict;
        mRecord.say(message);
    }

    // Of a point grid that no view can be made of it is the engine that refuses.
    std::optional<CaseParticles> makeParticles()
    {
        try {
            return mCase.make();
        } catch (const InputError& e) {
            mSpec.isExact() ? conclude(Verdict::kRefused, e.what())
                            : conclude(Verdict::kSkipped, "is not given such particles");
            return std::nullopt;
        }
    }

    // Whether another run makes sense.
    bool runOnce(const CaseParticles& asMade, const RunPlan& plan, int threads,
                 std::optional<std::uint64_t>& firstSum)
    {
        mRecord.enter(TrialPhase::kMake);
        const CaseParticles particles = arranged(asMade, plan);
        MethodSetup setup = setupFor(particles);
        if (plan.isOtherWay) {
            setup.options.cellSize = 0.5;
            setup.options.simd = SimdLevel::kScalar;
        }
        const std::unique_ptr<Method> method = runLimited(particles, setup, plan, threads);
        if (!method) return false;
        mRecord.enter(TrialPhase::kCheck);
        if (particles.measures && firstSum == hashOfMeasured(mMeasured)) return true; // checked already
        const TrialCheck check = particles.measures ? checkMeasured(particles, mMeasured)
                                                    : checkFound(method->found(), particles, plan.order);
        mRecord.missing += check.missing;
        mRecord.extra += check.extra;
        mRecord.duplicates += check.duplicates;
        mRecord.wrongValues += check.wrongValues;
        mRecord.hasAsymmetric = check.asymmetric.has_value();
        mRecord.asymmetric += check.asymmetric.value_or(0);
        if (check.wrong() > 0) conclude(Verdict::kWrong, check.message);
        if (check.hasStrangers) return false;
        const bool isOther = firstSum && *firstSum != check.pairSum;
        if (isOther) conclude(Verdict::kWrong, describe(plan, threads));
        firstSum = firstSum.value_or(check.pairSum);
        return true;
    }

    std::uint64_t mappableBytes() const
    {
        return std::min(mLimits.bytes, mCase.condition.addressBytes.value_or(mLimits.bytes));
    }

    std::string describe(const RunPlan& plan, int threads) const
    {
        if (plan.isOtherWay)
            return "other measures on 1 thread, in other cells, without SIMD, with denormals flushed";
        if (plan.isMirrored()) return "other pairs with the particles mirrored";
        return plan.order.empty() ? "other pairs with " + std::to_string(threads) + " threads"
                                  : "other pairs with particles in another order";
    }

    MethodSetup setupFor(const CaseParticles& particles)
    {
        const RunCondition& condition = mCase.condition;
        MethodSetup setup;
        setup.options.cellSize = condition.cellSize;
        if (condition.hostRoom == HostRoom::kOfTrial) setup.options.hostMemoryBytes = mappableBytes() / 4 * 3;
        if (condition.hostRoom == HostRoom::kGridAlone) {
            setup.options.hostMemoryBytes = bytesOfGridAlone(particles);
        }
        if (condition.hostRoom == HostRoom::kAsRefused) setup.options.hostMemoryBytes = kLeastBytes;
        std::uint64_t bytes = condition.deviceBytes;
        if (condition.deviceShare) {
            bytes = static_cast<std::uint64_t>(
                *condition.deviceShare *
                static_cast<double>(bytesAtOnce(particles, mSpec.encoding, mProgress)));
        }
        setup.devices.request.devices = {simulatedDeviceOf(kDeviceBytes)};
        setup.devices.budgetBytes = std::max<std::uint64_t>(bytes, 1);
        setup.devices.methods = 1;
        if (condition.claimedNeighbors) {
            setup.devices.request.estimate.estimator = Estimator::kFixed;
            setup.devices.request.estimate.fixedNeighbors = *condition.claimedNeighbors;
            setup.devices.request.margin = 0;
        }
        return setup;
    }

    // With its result; null where there is none.
    std::unique_ptr<Method> runLimited(const CaseParticles& particles, const MethodSetup& setup,
                                       const RunPlan& plan, int threads)
    {
        const AddressLimit limit(mappableBytes(), threads);
        returnFreedMemory();
        resetPeakMemory();
        mRecord.bytesBefore = residentMemoryBytes();
        mRecord.enter(TrialPhase::kRun);
        std::unique_ptr<Method> method;
        try {
            method = particles.measures ? measured(particles, setup, plan) : answered(particles, setup);
        } catch (const Error& e) {
            conclude(Verdict::kRefused, e.what());
        } catch (const std::bad_alloc&) {
            conclude(Verdict::kMemory, "asked for more memory than there is, std::bad_alloc");
        } catch (const std::exception& e) {
            conclude(mSpec.isExact() ? Verdict::kCrash : Verdict::kRefused, e.what());
        } catch (...) {
            conclude(Verdict::kCrash, "threw what is no std::exception");
        }
        mRecord.seconds += monotonicSeconds() - mRecord.phaseBegan;
        const std::uint64_t peak = peakMemoryBytes();
        mRecord.peakBytes = std::max(mRecord.peakBytes, peak - std::min(peak, mRecord.bytesBefore));
        mRecord.enter(TrialPhase::kCheck);
        return method;
    }

    std::unique_ptr<Method> answered(const CaseParticles& particles, MethodSetup setup)
    {
        for (int k = 0;; ++k) {
            std::unique_ptr<Method> method = mMake(mSpec, setup);
            try {
                const ProgressSpan span{mProgress, 0, 1};
                particles.search ? method->runSets(*particles.search, span)
                                 : method->run(particles.view, particles.radius, span);
                return method;
            } catch (const CapacityError& refusal) {
                if (mCase.condition.hostRoom != HostRoom::kAsRefused || k == kMostRefusals) throw;
                setup.options.hostMemoryBytes = grown(setup.options.hostMemoryBytes, refusal);
            }
        }
    }

    std::unique_ptr<Method> measured(const CaseParticles& particles, const MethodSetup& setup,
                                     const RunPlan& plan)
    {
        std::unique_ptr<Method> method = mMake(mSpec, setup);
        const SetSearch search = searchOf(particles);
        const std::vector<std::string> names = measuredNames(search);
        const auto measureAll = [&] {
            mMeasured.clear();
            for (const MeasureOptions& options : measurePasses(*particles.measures))
                mMeasured.push_back(
                    {names, options, method->measure(search, names, options, {mProgress, 0, 1})});
        };
        if (plan.isOtherWay) {
            const FlushedDenormals mode;
            tbb::task_arena(1).execute(measureAll); // an arena has what was set when it was made
        } else {
            measureAll();
        }
        return method;
    }

    const StabilityCase& mCase;
    const MethodSpec& mSpec;
    const TrialLimits& mLimits;
    const MethodMaker& mMake;
    TrialRecord& mRecord;
    std::vector<MeasuredPass> mMeasured; // by the last run
    ProgressPrinter mProgress{ProgressMode::kNever};
};

} // namespace

void TrialRecord::enter(TrialPhase next)
{
    phaseBegan = monotonicSeconds();
    phase = next;
}

void TrialRecord::say(const std::string& text)
{
    const std::size_t length = std::min(text.size(), kMessageBytes - 1);
    std::memcpy(message, text.data(), length);
    message[length] = 0;
}

double monotonicSeconds()
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void doTrial(const StabilityCase& stabilityCase, const MethodSpec& spec, const TrialLimits& limits,
             const MethodMaker& make, TrialRecord& record)
{
    TrialRunner(stabilityCase, spec, limits, make, record).run();
}

} // namespace vdb_nns::cli
