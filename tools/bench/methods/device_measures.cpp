#include "bench/methods/device_measures.h"

#include "numbers.h"

namespace vdb_nns::cli {
namespace {

std::optional<double> rate(double amount, double seconds)
{
    if (!(amount > 0) || !(seconds > 0)) return std::nullopt;
    return amount / seconds;
}

std::optional<double> gigabytesPerSecond(std::uint64_t bytes, double seconds)
{
    return rate(1e-9 * static_cast<double>(bytes), seconds);
}

} // namespace

std::optional<double> DeviceMeasures::upGbs() const
{
    return gigabytesPerSecond(bytesUp, uploadSeconds);
}

std::optional<double> DeviceMeasures::downGbs() const
{
    return gigabytesPerSecond(bytesDown, downloadSeconds);
}

std::optional<double> DeviceMeasures::kernelGbs() const
{
    return gigabytesPerSecond(bytesUp + bytesDown, searchSeconds);
}

std::optional<double> DeviceMeasures::neighborsPerSecond() const
{
    if (cpuParticles > 0) return std::nullopt;
    return rate(static_cast<double>(pairs), searchSeconds);
}

std::optional<double> DeviceMeasures::testsPerSecond() const
{
    if (cpuParticles > 0) return std::nullopt;
    return rate(static_cast<double>(candidateTests), searchSeconds);
}

std::optional<double> DeviceMeasures::particlesPerGib() const
{
    constexpr double kGib = 1024.0 * 1024.0 * 1024.0;
    return rate(static_cast<double>(particles + cpuParticles), static_cast<double>(peakSumBytes) / kGib);
}

std::optional<double> DeviceMeasures::overLowerBound() const
{
    if (!lowerBound) return std::nullopt;
    return rate(makespanSeconds, *lowerBound);
}

DeviceMeasures medianOf(const std::vector<DeviceMeasures>& runs)
{
    DeviceMeasures result = runs.back();
    for (double DeviceMeasures::*const seconds :
         {&DeviceMeasures::estimateSeconds, &DeviceMeasures::planSeconds, &DeviceMeasures::uploadSeconds,
          &DeviceMeasures::searchSeconds, &DeviceMeasures::downloadSeconds, &DeviceMeasures::collectSeconds,
          &DeviceMeasures::makespanSeconds}) {
        std::vector<double> values;
        for (const DeviceMeasures& run : runs) values.push_back(run.*seconds);
        result.*seconds = median(std::move(values));
    }
    return result;
}

double togetherSeconds(double cpuSeconds, double deviceSeconds)
{
    return cpuSeconds * deviceSeconds / (cpuSeconds + deviceSeconds);
}

} // namespace vdb_nns::cli
