// A method of `bench`: one way to find all neighbors, ours or another's, behind one interface.
#pragma once

#include "bench/found_neighbors.h"
#include "bench/methods/device_measures.h"
#include "bench/set_search.h"
#include "progress_printer.h"
#include "vdb_nns/measure.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Whose method it is, and what may be wrong with its pairs.
enum class MethodKind {
    kEngine,   ///< the engine on the CPU: exact
    kDevice,   ///< the engine on devices: exact
    kAblation, ///< the engine's way with a part left out or exchanged, to see what that part costs and gains
    kApproximate, ///< loses pairs on purpose
    kPeer         ///< another's library
};

/// Who searches, and where the particles and the lists are meanwhile.
enum class MethodPlace {
    kCpu,
    kInCore,      ///< a device that has everything in its memory at once
    kMapped,      ///< a CUDA device that reads and writes pinned host memory through the link
    kBlocks,      ///< devices, block by block through a budget of memory
    kCpuAndDevice ///< the same, and the CPU beside them
};

/// A method by its name: FAMILY, FAMILY-ENCODING or FAMILY with a number, and @THREADS where it is not to have all.
struct MethodSpec {
    std::string name;   ///< as asked for, e.g. blocks32-mask, nearest32, ours-index@1
    std::string family; ///< e.g. blocks32, nearest, ours
    MethodKind kind = MethodKind::kEngine;
    int threads = 0;     ///< 0: all of the bench
    double number = 0;   ///< nearest: neighbors kept; sampled: percent of the candidates tested
    bool visits = false; ///< ours-visit: rows are handed out and not kept
    Encoding encoding = Encoding::kIndex; ///< kEngine and kDevice
    MethodPlace place = MethodPlace::kCpu;
    BoundaryMode boundary = BoundaryMode::kHalo;
    int blockLog2Cells = 0; ///< as ScheduleOptions has it

    bool onDevice() const { return kind == MethodKind::kDevice; }
    /// Whether a wrong pair is a fault of ours.
    bool isExact() const { return kind == MethodKind::kEngine || kind == MethodKind::kDevice; }
    /// Whether --device-memory is for it.
    bool hasBudget() const { return place == MethodPlace::kBlocks || place == MethodPlace::kCpuAndDevice; }
};

struct MethodRun {
    double gridSeconds = 0;   ///< making the structure: grid, tree, reordered positions
    double searchSeconds = 0; ///< what remains once it is planned
    std::uint64_t pairs = 0, structureBytes = 0, listBytes = 0;
    std::optional<DeviceMeasures> device;

    double totalSeconds() const
    {
        return gridSeconds + searchSeconds + (device ? device->estimateSeconds + device->planSeconds : 0);
    }
};

/// Keeps its buffers from run to run.
class Method {
public:
    virtual ~Method() = default;

    /// Structure and neighbors anew, in the TBB arena of the caller. The result stays until the next run or discard().
    /// Particles that are not finite are handed over as they are.
    /// @throws Cancelled, CapacityError, and InvalidInput for a request that it refuses
    virtual MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) = 0;

    /// The same for two sets; result and throws as run().
    /// @throws std::logic_error for a search that missingSearch() says that the method has not
    virtual MethodRun runSets(const SetSearch& search, const ProgressSpan& span);

    /// Measures of the queries' neighbors. There is no result to find() then.
    /// @param options `search` is not read
    /// @throws std::logic_error for a method that missingMeasures() says has none; else as SearchEngine::measure()
    virtual Measured measure(const SetSearch& search, const std::vector<std::string>& names,
                             const MeasureOptions& options, const ProgressSpan& span);

    /// Drops the result, so that its memory can be used again.
    virtual void discard() = 0;

    /// The result of the last run. @throws std::logic_error without one
    virtual const FoundNeighbors& found() const = 0;
};

inline MethodRun Method::runSets(const SetSearch&, const ProgressSpan&)
{
    throw std::logic_error("a method of bench was asked for a search of sets that it has not");
}

inline Measured Method::measure(const SetSearch&, const std::vector<std::string>&, const MeasureOptions&,
                                const ProgressSpan&)
{
    throw std::logic_error("a method of bench was asked for measures that it has not");
}

/// A method whose result is made anew by each run.
class MethodWithResult : public Method {
public:
    void discard() override { mFound.reset(); }

    const FoundNeighbors& found() const override
    {
        if (!mFound) throw std::logic_error("a method of bench was asked for a result that it has not");
        return *mFound;
    }

protected:
    std::unique_ptr<FoundNeighbors> mFound;
};

} // namespace vdb_nns::cli
