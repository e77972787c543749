#include "bench/stability/cases.h"

#include "bench/stability/case_points.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <iterator>

namespace vdb_nns::cli {
namespace {

CaseParticles block()
{
    return asFloats(blockPoints(16));
}

CaseParticles clusters()
{
    return asFloats(scenePoints("clusters", 5000));
}

// Counts need no room beyond what the grid had while it was made; lists do, and so do devices for what they stage.
RightOutcome answerOfCounts(const MethodSpec& spec)
{
    const bool countsOnly = spec.encoding == Encoding::kNone || spec.visits;
    return countsOnly && !spec.onDevice() ? RightOutcome::kAnswer : RightOutcome::kRefusal;
}

void addOrder(std::vector<StabilityCase>& cases)
{
    RunCondition shuffled;
    shuffled.shuffled = true;
    cases.push_back({"order", "shuffled",
                     "a block in order and in random order: nvalchemi #135, other rows from run to run",
                     block, shuffled});
    cases.push_back({"order", "shuffled-clusters",
                     "clusters, the same: PointNet++ #209 keeps the first by number", clusters, shuffled});
    RunCondition threads;
    threads.threadCounts = true;
    cases.push_back({"threads", "threads",
                     "a block on 1 thread to twice as many as cores: AMReX #4644, quokka #1125", block,
                     threads});
    cases.push_back({"threads", "threads-clusters", "clusters, the same: FLAMEGPU2 #417", clusters, threads});
}

void addHostMemory(std::vector<StabilityCase>& cases)
{
    RunCondition condition;
    condition.hostRoom = HostRoom::kAsRefused;
    cases.push_back({"memory", "host-as-asked",
                     "host memory grown by what each refusal asks for: nvalchemi #164 says how much", block,
                     condition});
    condition.hostRoom = HostRoom::kGridAlone;
    cases.push_back({"memory", "host-grid-alone",
                     "host memory for the grid and none for lists: cuNSearch #10 just crashes",
                     [] {
                         CasePoints points = blockPoints(16);
                         points.radius = 4;
                         return asFloats(points);
                     },
                     condition, answerOfCounts, "more host memory"});
    condition.hostRoom = HostRoom::kFree;
    condition.addressBytes = std::uint64_t(512) << 20;
    condition.deviceBytes = 64u << 20;
    // 4e8 pairs: index lists of 1.6 GB. Nobody told the engine, which asks the machine what is free.
    cases.push_back({"memory", "address-space",
                     "20 000 coincident particles where 512 MiB may be mapped: LAMMPS #3743",
                     [] {
                         CasePoints points;
                         points.at.assign(20000, {1, 2, 3});
                         points.known = KnownRows::kAllOthers;
                         return asFloats(points);
                     },
                     condition,
                     [](const MethodSpec& spec) {
                         return spec.encoding == Encoding::kIndex && !spec.visits ? RightOutcome::kRefusal
                                                                                  : RightOutcome::kAnswer;
                     },
                     ": "}); // what broke, and the next step
}

void addDevices(std::vector<StabilityCase>& cases)
{
    const auto add = [&cases](const char* name, const char* what, CaseParticles (*make)(),
                              std::optional<double> share, std::optional<double> neighbors) {
        RunCondition condition;
        condition.deviceShare = share;
        condition.claimedNeighbors = neighbors;
        cases.push_back({"devices", name, what, make, condition});
    };
    add("budget-100", "device memory for all at once, to the byte of the estimate", block, 1.0, {});
    add("budget-50", "half of that: cuML #2163, batches", block, 0.5, {});
    add("budget-10", "a tenth: Open3D #7311 ends without a word", block, 0.1, {});
    add("budget-1", "a hundredth, less than a leaf: jax-md #290", block, 0.01, {});
    add("budget-none", "a millionth, no room for one query: the CPU has to do it", block, 1e-6, {});
    add("budget-clusters", "a tenth, on clusters that the mean underestimates: Cabana in ESPResSo #5144",
        clusters, 0.1, {});
    add("estimate-low", "an estimate of 0.01 neighbors a particle: OpenMM #1499 repeats with more", clusters,
        0.25, 0.01);
    add("estimate-high", "an estimate of 1e4 neighbors a particle: room that nothing needs", clusters, 0.25,
        1e4);
}

// Groups in the order in which they first come.
std::vector<StabilityCase> byGroup(const std::vector<StabilityCase>& cases)
{
    std::vector<StabilityCase> sorted;
    const auto has = [&sorted](const std::string& group) {
        return std::any_of(sorted.begin(), sorted.end(),
                           [&](const StabilityCase& c) { return c.group == group; });
    };
    for (const StabilityCase& first : cases) {
        if (has(first.group)) continue;
        std::copy_if(cases.begin(), cases.end(), std::back_inserter(sorted),
                     [&](const StabilityCase& c) { return c.group == first.group; });
    }
    return sorted;
}

} // namespace

std::vector<StabilityCase> runCases()
{
    std::vector<StabilityCase> cases;
    addOrder(cases);
    addHostMemory(cases);
    addDevices(cases);
    return cases;
}

const std::vector<StabilityCase>& stabilityCases()
{
    static const std::vector<StabilityCase> all = [] {
        std::vector<StabilityCase> cases;
        for (const auto part :
             {precisionCases, shapeCases, inputCases, setCases, vdbCases, measureCases, runCases}) {
            const std::vector<StabilityCase> more = part();
            cases.insert(cases.end(), more.begin(), more.end());
        }
        return byGroup(cases);
    }();
    return all;
}

std::vector<StabilityCase> stabilityCases(const std::vector<std::string>& names)
{
    const std::vector<StabilityCase>& all = stabilityCases();
    if (names.empty()) return all;
    const auto isMeant = [](const StabilityCase& c, const std::string& name) {
        return c.name == name || c.group == name;
    };
    for (const std::string& name : names) {
        if (std::any_of(all.begin(), all.end(), [&](const StabilityCase& c) { return isMeant(c, name); }))
            continue;
        std::string known;
        for (const StabilityCase& c : all) known += (known.empty() ? "" : ", ") + c.name;
        throw InvalidInput("'" + name + "' is no case of --stability; there are " + known);
    }
    std::vector<StabilityCase> some;
    for (const StabilityCase& c : all) {
        if (std::any_of(names.begin(), names.end(),
                        [&](const std::string& name) { return isMeant(c, name); }))
            some.push_back(c);
    }
    return some;
}

} // namespace vdb_nns::cli
