#include "util/memory.h"

#include "util/cgroup_memory.h"
#include "util/number_file.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <limits>
#include <string>

#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

namespace vdb_nns {

namespace {

constexpr std::size_t kHugePage = std::size_t(2) << 20;

// What a limit on the address space (ulimit -v) leaves.
std::uint64_t addressSpaceBytes()
{
    constexpr std::uint64_t none = std::numeric_limits<std::uint64_t>::max();
    rlimit limit = {};
    if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return none;
    const std::uint64_t used =
        readNumber("/proc/self/statm", 0) * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
    return limit.rlim_cur > used ? limit.rlim_cur - used : 0;
}

} // namespace

PageBlock::PageBlock(std::size_t bytes)
{
    if (bytes == 0) return;
    // Small blocks from huge pages would cost 2 MiB each when touched; they take plain pages.
    const bool huge = bytes >= kHugePage;
    const std::size_t unit = huge ? kHugePage : 4096;
    mBytes = (bytes + unit - 1) / unit * unit;
    const std::size_t mapped = mBytes + (huge ? kHugePage : 0);
    void* raw =
        mmap(nullptr, mapped, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (raw == MAP_FAILED) {
        mBytes = 0;
        const std::uint64_t allowed = availableMemoryBytes();
        throw CapacityError("the system refused " + std::to_string(bytes) + " bytes of memory, and " +
                                std::to_string(allowed) +
                                " are free: use mask lists or counts, a smaller radius, or bound the memory",
                            bytes, allowed);
    }
    mData = raw;
    if (!huge) return;
    const auto address = reinterpret_cast<std::uintptr_t>(raw);
    const std::uintptr_t aligned = (address + kHugePage - 1) / kHugePage * kHugePage;
    if (aligned > address) munmap(raw, aligned - address);
    const std::size_t tail = address + mapped - (aligned + mBytes);
    if (tail > 0) munmap(reinterpret_cast<void*>(aligned + mBytes), tail);
    mData = reinterpret_cast<void*>(aligned);
    madvise(mData, mBytes, MADV_HUGEPAGE); // advice: where it is refused, 4 KiB pages serve
}

void adviseHugePages(void* data, std::size_t bytes)
{
    const auto address = reinterpret_cast<std::uintptr_t>(data);
    const std::uintptr_t begin = (address + kHugePage - 1) / kHugePage * kHugePage;
    const std::uintptr_t end = (address + bytes) / kHugePage * kHugePage;
    if (begin < end) madvise(reinterpret_cast<void*>(begin), end - begin, MADV_HUGEPAGE);
}

PageBlock::~PageBlock()
{
    if (mData) munmap(mData, mBytes);
}

std::uint64_t availableMemoryBytes()
{
    std::uint64_t available = std::numeric_limits<std::uint64_t>::max();
    std::ifstream file("/proc/meminfo");
    std::string name, unit;
    std::uint64_t kilobytes = 0;
    while (file >> name >> kilobytes) {
        if (name == "MemAvailable:") {
            available = kilobytes * 1024;
            break;
        }
        std::getline(file, unit);
    }
    available = std::min({available, cgroupFreeBytes(), addressSpaceBytes()});
    return available - available / 16;
}

} // namespace vdb_nns
