#include "machine.h"

#include <fstream>
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

void resetPeakMemory()
{
    std::ofstream("/proc/self/clear_refs") << "5";
}

} // namespace vdb_nns::cli
