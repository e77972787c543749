// Named cases at which methods for neighbors are known to fail: the rows of `bench --stability`.
#pragma once

#include "bench/method.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/types.h"

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Rows that need no search to be known.
enum class KnownRows {
    kUnknown,   ///< findTruth() finds them
    kAllOthers, ///< of each particle all the others
    kTwin,      ///< of particle i the particle i ^ 1
    kNobody
};

struct MeasureTask;

struct CaseParticles {
    ParticleView view;
    double radius = 0;
    KnownRows known = KnownRows::kUnknown;
    std::shared_ptr<const void> owner; ///< of what the view views
    /// In place of all particles of the view within the radius; null: those. Views what the owner owns.
    std::shared_ptr<const SetSearch> search = {};
    Vec3d translation{}; ///< of the transform of a point grid
    /// What is measured of the neighbors (measure_task.h), in place of looking at them; null: nothing.
    std::shared_ptr<const MeasureTask> measures = {};
};

/// What bounds the host memory of methods of the engine.
enum class HostRoom {
    kFree,      ///< what the machine has free
    kOfTrial,   ///< three quarters of what the process may map
    kAsRefused, ///< next to nothing, then as much more as each refusal asks for, until there is an answer
    kGridAlone  ///< what the grid is granted while it is made, and no more for lists
};

/// How a method runs. By default: once, as it is, on a device that needs several blocks for some thousand particles.
struct RunCondition {
    bool threadCounts = false; ///< a run for each of 1 to twice as many threads as there are cores
    bool shuffled = false;     ///< a run in order and one in random order
    bool mirrored = false;     ///< a run as it is, one with x negated and one with all three
    HostRoom hostRoom = HostRoom::kFree;
    double cellSize = 0; ///< of methods of the engine, in radii; 0: what suits the particles
    std::optional<std::uint64_t>
        addressBytes;                       ///< that the process may map, where that is less than its limit
    std::uint64_t deviceBytes = 128u << 10; ///< of a simulated device
    std::optional<double> deviceShare;      ///< the same, of what everything takes at once there
    std::optional<double> claimedNeighbors; ///< that a lying estimate takes every particle to have

    bool isForDevices() const { return deviceShare.has_value() || claimedNeighbors.has_value(); }
    bool isForHostRoom() const
    {
        return hostRoom == HostRoom::kAsRefused || hostRoom == HostRoom::kGridAlone;
    }
};

/// What a method that promises exact pairs has to do.
enum class RightOutcome { kAnswer, kAnswerOrRefusal, kRefusal };

struct StabilityCase {
    std::string group, name;
    std::string what; ///< a sentence: what it is, and who failed at it
    /// Deterministic. @throws InputError where no method can be given such particles
    std::function<CaseParticles()> make;
    RunCondition condition = {};
    std::function<RightOutcome(const MethodSpec&)> right = {}; ///< empty: an answer
    std::string refusalSays = "";                              ///< what is in every refusal that is clear

    RightOutcome rightOutcome(const MethodSpec& spec) const
    {
        return right ? right(spec) : RightOutcome::kAnswer;
    }
};

/// All of them, by group. Nothing is made yet.
const std::vector<StabilityCase>& stabilityCases();

/// Those of some names or groups; all for none.
/// @throws InvalidInput for a name that there is not
std::vector<StabilityCase> stabilityCases(const std::vector<std::string>& names);

// The parts of the table.
std::vector<StabilityCase> precisionCases(); ///< ties, far from the origin, huge and tiny scales
std::vector<StabilityCase> shapeCases();     ///< seams, sparse domains, sheets, clusters, duplicates
std::vector<StabilityCase> inputCases();     ///< few particles, radius out of scale, non-finite, bad radius
std::vector<StabilityCase> setCases();       ///< roles, radii of particles, the nearest
std::vector<StabilityCase> vdbCases();       ///< point grids: transforms, codecs, unusual grids
std::vector<StabilityCase> measureCases();   ///< measures of some of the others, and of what measures fail at
std::vector<StabilityCase> runCases();       ///< order, threads, host memory, devices, estimates that lie

} // namespace vdb_nns::cli
