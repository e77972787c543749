// Running a schedule: who ran what, and where the model was wrong. Plain data; SearchEngine::search() runs it.
#pragma once

#include "vdb_nns/planning/schedule.h"
#include "vdb_nns/search_options.h"

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

/// What to do when a device fails in the middle of a run. Either way no list is wrong or short.
enum class DeviceFailure {
    kStop,  ///< throw DeviceError
    kUseCpu ///< the others, and the CPU, do its blocks; DeviceRun::failure says why
};

struct RunOptions {
    SearchOptions search;
    ScheduleOptions schedule; ///< those that the schedule was made with
    DeviceFailure onFailure = DeviceFailure::kStop;
};

struct DeviceRun {
    std::uint64_t peakBytes = 0; ///< largest sum of what was allocated on it
    std::uint64_t blocks = 0;    ///< searched and collected, parts of split blocks counted each
    std::uint64_t particles = 0; ///< queries of those
    double busySeconds = 0;      ///< searching; virtual on a simulated device
    double uploadSeconds = 0;    ///< measured by the device; 0 on a simulated one
    double downloadSeconds = 0;
    std::uint64_t bytesUp = 0, bytesDown = 0; ///< that these took
    std::string failure;                      ///< why it did no more; empty when nothing was wrong
};

/// What a run did. Without devices that are really there decisions are made in virtual time, so all of it but
/// collectSeconds is the same in every run. With them it depends on how fast they turn out to be; the lists never do.
struct ScheduleRun {
    std::vector<DeviceRun> devices; ///< in the order of the limits
    std::uint64_t cpuBlocks = 0;    ///< and parts of blocks that TBB workers ran
    std::uint64_t cpuParticles = 0; ///< queries that they ran, boundary regions included
    std::uint64_t overflows =
        0; ///< blocks whose rows found no room on a device; redone in parts, nothing lost
    std::uint64_t retries =
        0; ///< blocks, or parts of blocks, that were run again after an overflow or a failure
    std::uint64_t splits = 0;   ///< blocks split before they ran: they had become too large for what is known
    std::uint64_t halvings = 0; ///< a device's memory was refused and half of it asked for
    std::uint64_t tooLargeQueries = 0;     ///< of the CPU's: 32 of them with their candidates fit no device
    std::vector<std::uint64_t> blockPairs; ///< pairs found, by block of the schedule
    double cpuBusySeconds = 0;             ///< a worker; virtual where all devices are simulated, as the next
    double collectSeconds = 0;             ///< of all threads together, measured: rows of blocks into lists
    double seconds = 0;                    ///< when the last of all was done
};

/// The CUDA devices that this process sees and can use, in the order of the runtime, with the memory that is free now: what a
/// SearchEngine keeps for its next run is not (SearchEngine::releaseDevices()). Their rates are guesses from the number of
/// multiprocessors, replaced by what is measured once blocks have run.
/// Cost: opens every device, some tenths of a second each.
/// @param leftOut why others cannot be used: too old, not to be opened, no memory free; may be null
/// @throws DeviceError without a device that can be used, a driver or a build with CUDA
std::vector<DeviceLimits> cudaDevices(std::vector<std::string>* leftOut = nullptr);

/// One of them; no other is opened.
/// @param ordinal the runtime's number of it
/// @throws DeviceError if it is not there or cannot be used
DeviceLimits cudaDevice(int ordinal);

} // namespace vdb_nns
