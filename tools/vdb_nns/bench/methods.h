// The methods that `bench` puts side by side, behind one interface.
#pragma once

#include "bench/device_measures.h"
#include "progress_printer.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/schedule.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Who searches, and where the particles and the lists are meanwhile.
enum class MethodPlace {
    kCpu,
    kInCore,      ///< a device that has everything in its memory at once
    kMapped,      ///< a CUDA device that reads and writes pinned host memory through the link
    kBlocks,      ///< devices, block by block through a budget of memory
    kCpuAndDevice ///< the same, and the CPU beside them
};

/// A method by its name: FAMILY-ENCODING, e.g. blocks32-mask.
struct MethodSpec {
    std::string name;
    MethodPlace place = MethodPlace::kCpu;
    Encoding encoding = Encoding::kIndex;
    BoundaryMode boundary = BoundaryMode::kHalo;
    int blockLog2Cells = 0; ///< as ScheduleOptions has it

    bool onDevice() const { return place != MethodPlace::kCpu; }
    /// Whether --device-memory is for it.
    bool hasBudget() const { return place == MethodPlace::kBlocks || place == MethodPlace::kCpuAndDevice; }
};

struct MethodRun {
    double gridSeconds = 0, searchSeconds = 0; ///< search: what remains once it is planned
    std::uint64_t pairs = 0, structureBytes = 0, listBytes = 0;
    std::optional<DeviceMeasures> device;

    double totalSeconds() const
    {
        return gridSeconds + searchSeconds + (device ? device->estimateSeconds + device->planSeconds : 0);
    }
};

/// A way to find all neighbors. Keeps its buffers from run to run.
class Method {
public:
    virtual ~Method() = default;

    /// Structure and lists anew. The result stays until the next run or discard().
    virtual MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) = 0;

    /// Drops the result, so that its memory can be used again.
    void discard() { mLists = NeighborLists(); }
    const NeighborLists& lists() const { return mLists; }

protected:
    NeighborLists mLists;
};

/// The families of methods as the help has them.
std::string methodHelp();

/// @throws InvalidInput for an unknown name
MethodSpec parseMethod(const std::string& name);

/// Names from a list with commas, checked. For an empty list all that make sense: those of the CPU, and with `device` (as
/// --device has it, empty for none) lists of both encodings by each family.
/// @throws InvalidInput
std::vector<MethodSpec> parseMethods(const std::string& list, const std::string& device);

/// A method of the CPU alone.
std::unique_ptr<Method> makeCpuMethod(const MethodSpec& spec, const SearchOptions& options);

} // namespace vdb_nns::cli
