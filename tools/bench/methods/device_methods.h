// Methods of `bench` that search on devices.
#pragma once

#include "bench/method.h"
#include "device_options.h"

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace vdb_nns::cli {

/// The devices of a benchmark. Methods in core have their whole memory, others --device-memory.
struct BenchDevices {
    DeviceOptions request;
    std::optional<std::uint64_t> budgetBytes;
    std::size_t methods = 0; ///< that run on them; each keeps its memory until the end
};

/// Refuses flags that contradict the methods or would do nothing. Opens nothing.
/// @throws InvalidInput
void checkDeviceFlags(const DeviceFlags& flags, const std::vector<MethodSpec>& methods);

/// The devices that the methods need, checked by checkDeviceFlags() before; none where all are of the CPU.
/// @throws InvalidInput, DeviceError
BenchDevices benchDevices(const DeviceFlags& flags, const std::vector<MethodSpec>& methods, int threads);

/// Its runs throw CapacityError where it is to be in core and is not, and where a device had less memory than its budget; and
/// what SearchEngine::search() throws.
std::unique_ptr<Method> makeDeviceMethod(const MethodSpec& spec, const SearchOptions& options,
                                         const BenchDevices& devices);

} // namespace vdb_nns::cli
