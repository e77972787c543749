#include "machine.h"

#include <algorithm>
#include <fstream>
#include <sstream>
#ifdef __GLIBC__
#include <malloc.h>
#endif
#include <sys/resource.h>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

// The value after "key:" of a /proc file, or an empty string.
std::string procValue(const char* file, const std::string& key)
{
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);) {
        if (line.compare(0, key.size(), key) != 0) continue;
        const std::size_t colon = line.find(':');
        if (colon == std::string::npos) continue;
        const std::size_t begin = line.find_first_not_of(" \t", colon + 1);
        return begin == std::string::npos ? std::string() : line.substr(begin);
    }
    return {};
}

// "key: n kB" of this process in bytes; 0 where the system does not tell.
std::uint64_t statusBytes(const char* key)
{
    std::istringstream value(procValue("/proc/self/status", key));
    std::uint64_t kibibytes = 0;
    return value >> kibibytes ? kibibytes * 1024 : 0;
}

} // namespace

std::string cpuName()
{
    const std::string name = procValue("/proc/cpuinfo", "model name");
    return name.empty() ? "unknown" : name;
}

std::uint64_t machineMemoryBytes()
{
    const long pages = sysconf(_SC_PHYS_PAGES), pageBytes = sysconf(_SC_PAGESIZE);
    if (pages <= 0 || pageBytes <= 0) return 0;
    return static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(pageBytes);
}

std::uint64_t peakMemoryBytes()
{
    // "VmHWM: n kB" can be reset, ru_maxrss cannot.
    if (const std::uint64_t bytes = statusBytes("VmHWM")) return bytes;
    rusage usage = {};
    getrusage(RUSAGE_SELF, &usage);
    return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

std::uint64_t residentMemoryBytes()
{
    const std::uint64_t bytes = statusBytes("VmRSS");
    return bytes ? bytes : peakMemoryBytes();
}

void returnFreedMemory()
{
#ifdef __GLIBC__
    // By itself glibc raises this threshold to the largest block that was freed, up to 32 MiB, and keeps smaller ones.
    constexpr int kLargeBlockBytes = 1 << 20;
    mallopt(M_MMAP_THRESHOLD, kLargeBlockBytes);
    malloc_trim(0);
#endif
}

void resetPeakMemory()
{
    std::ofstream("/proc/self/clear_refs") << "5";
}

} // namespace vdb_nns::cli
