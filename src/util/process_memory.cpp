// What this process has resident, from /proc/self/status.
#include "vdb_nns/memory.h"

#include <fstream>
#include <string>
#ifdef __GLIBC__
#include <malloc.h>
#endif
#include <sys/resource.h>

namespace vdb_nns {

namespace {

// "key: n kB" in bytes; 0 where the system does not tell.
std::uint64_t statusBytes(const std::string& key)
{
    std::ifstream in("/proc/self/status");
    for (std::string name; in >> name;) {
        std::uint64_t kibibytes = 0;
        if (name == key) return in >> kibibytes ? kibibytes * 1024 : 0;
        std::getline(in, name);
    }
    return 0;
}

} // namespace

std::uint64_t peakMemoryBytes()
{
    // "VmHWM: n kB" can be reset, ru_maxrss cannot.
    if (const std::uint64_t bytes = statusBytes("VmHWM:")) return bytes;
    rusage usage = {};
    getrusage(RUSAGE_SELF, &usage);
    return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;
}

std::uint64_t residentMemoryBytes()
{
    const std::uint64_t bytes = statusBytes("VmRSS:");
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

} // namespace vdb_nns
