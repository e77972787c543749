// Running a schedule: who ran what, and where the model was wrong. Plain data; SearchEngine::search() runs
// it.
#pragma once

#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

/// What to do if a device fails in the middle of a run. Either way no list is wrong or cut.
enum class DeviceFailure {
    kStop,  ///< throw DeviceError
    kUseCpu ///< other devices and the CPU run its blocks; DeviceRun::failure says why
};

struct RunOptions {
    SearchOptions search;
    ScheduleOptions schedule; ///< those that the schedule was made with
    DeviceFailure onFailure = DeviceFailure::kStop;
};

/// What one device did.
struct DeviceRun {
    std::uint64_t peakBytes = 0;              ///< most bytes that were allocated on it at once
    std::uint64_t blocks = 0;                 ///< searched and collected; each part of a split block counts
    std::uint64_t particles = 0;              ///< queries of those blocks
    double busySeconds = 0;                   ///< spent searching; virtual on a simulated device
    double uploadSeconds = 0;                 ///< measured by the device; 0 on a simulated one
    double downloadSeconds = 0;               ///< likewise
    std::uint64_t bytesUp = 0, bytesDown = 0; ///< moved in these times
    std::string failure;                      ///< why it stopped early; empty if nothing was wrong
};

/// What a run did. If all devices are simulated, decisions are made in virtual time, and everything but
/// collectSeconds is the same in every run. With real devices it depends on how fast they are; the lists
/// never do.
struct ScheduleRun {
    std::vector<DeviceRun> devices;    ///< in the order of the limits
    std::uint64_t cpuBlocks = 0;       ///< blocks, and parts of blocks, that TBB workers ran
    std::uint64_t cpuParticles = 0;    ///< queries that TBB workers ran, boundary regions included
    std::uint64_t overflows = 0;       ///< blocks whose rows did not fit on a device; redone in parts
    std::uint64_t retries = 0;         ///< blocks, or parts, run again after an overflow or a failure
    std::uint64_t splits = 0;          ///< blocks split before they ran: too large by what is known by then
    std::uint64_t halvings = 0;        ///< times that a device refused memory and half of it was asked for
    std::uint64_t tooLargeQueries = 0; ///< see Schedule::tooLargeQueries
    std::vector<std::uint64_t> blockPairs; ///< pairs found, by block of the schedule
    double cpuBusySeconds = 0;             ///< of a TBB worker; virtual if all devices are simulated
    double collectSeconds = 0;             ///< measured, of all threads together: rows of blocks into lists
    double seconds = 0;                    ///< when everything was done; virtual if all devices are simulated
};

/// The CUDA devices that this process sees and can use, in the order of the runtime. Their memory is what is
/// free now, without what a SearchEngine keeps for its next run (SearchEngine::releaseDevices()). Their rates
/// are guesses from the number of multiprocessors, until blocks have run and measured ones replace them.
/// Cost: opens every device, some tenths of a second each.
/// @param leftOut why other devices cannot be used: too old, cannot be opened, no memory free; may be null
/// @throws DeviceError if there is no device that can be used, no driver, or no CUDA in this build
std::vector<DeviceLimits> cudaDevices(std::vector<std::string>* leftOut = nullptr);

/// One of these devices; no other is opened.
/// @param ordinal its number in the runtime
/// @throws DeviceError if it is not there or cannot be used
DeviceLimits cudaDevice(int ordinal);

} // namespace vdb_nns
