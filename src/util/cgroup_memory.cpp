#include "util/cgroup_memory.h"

#include "util/number_file.h"

#include <algorithm>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <map>
#include <sstream>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kUnlimited = std::numeric_limits<std::uint64_t>::max();

// The names of one version's files and of their entries in memory.stat.
struct Interface {
    std::initializer_list<const char*> limits;
    const char* usage;
    std::initializer_list<const char*> reclaimable;
};

// What the kernel takes back before it kills: pages of files that were not used lately.
const Interface kVersion1 = {{"memory.limit_in_bytes"}, "memory.usage_in_bytes", {"total_inactive_file"}};
const Interface kVersion2 = {
    {"memory.max", "memory.high"}, "memory.current", {"inactive_file", "slab_reclaimable"}};

// A hierarchy: where it is mounted, which of its groups is seen there, and the group of this process.
struct Hierarchy {
    std::string mountPoint, mountRoot, group;
};

std::map<std::string, std::uint64_t> readStatistics(const std::string& path)
{
    std::map<std::string, std::uint64_t> values;
    std::ifstream file(path);
    std::string name;
    for (std::uint64_t value = 0; file >> name >> value;) values[name] = value;
    return values;
}

std::uint64_t freeBytesOf(const std::string& folder, const Interface& files)
{
    std::map<std::string, std::uint64_t> statistics = readStatistics(folder + "/memory.stat");
    std::uint64_t limit = kUnlimited;
    for (const char* name : files.limits)
        limit = std::min(limit, readNumber(folder + "/" + name, kUnlimited)); // "max" is no number
    // Version 1 tells the least limit of all groups above, of those that are not seen from a container too.
    const auto above = statistics.find("hierarchical_memory_limit");
    if (above != statistics.end()) limit = std::min(limit, above->second);
    if (limit == kUnlimited) return kUnlimited;
    std::uint64_t used = readNumber(folder + "/" + files.usage, 0);
    for (const char* name : files.reclaimable) used -= std::min(used, statistics[name]);
    return limit - std::min(limit, used);
}

// mountinfo writes blanks and the like as a backslash and three octal digits.
std::string unescaped(const std::string& text)
{
    std::string plain;
    for (std::size_t i = 0; i < text.size(); ++i) {
        if (text[i] == '\\' && i + 3 < text.size()) {
            plain += static_cast<char>(std::stoi(text.substr(i + 1, 3), nullptr, 8));
            i += 3;
        } else {
            plain += text[i];
        }
    }
    return plain;
}

bool hasWord(const std::string& list, const std::string& word)
{
    return ("," + list + ",").find("," + word + ",") != std::string::npos;
}

// Lines of proc_pid_mountinfo(5): the 4th and 5th word are root and mount point; after " - " type, source, options.
void findMounts(const std::string& path, Hierarchy& version1, Hierarchy& version2)
{
    std::ifstream file(path);
    for (std::string line; std::getline(file, line);) {
        const std::size_t dash = line.find(" - ");
        if (dash == std::string::npos) continue;
        std::istringstream before(line), after(line.substr(dash + 3));
        std::string skipped, root, point, type, source, options;
        before >> skipped >> skipped >> skipped >> root >> point;
        after >> type >> source >> options;
        const bool isVersion1 = type == "cgroup" && hasWord(options, "memory");
        if (!isVersion1 && type != "cgroup2") continue;
        Hierarchy& hierarchy = isVersion1 ? version1 : version2;
        if (!hierarchy.mountPoint.empty()) continue;
        hierarchy.mountPoint = unescaped(point);
        hierarchy.mountRoot = unescaped(root);
    }
}

// Lines of cgroups(7): number:controllers:group; version 2 has the number 0 and no controllers.
void findGroups(const std::string& path, Hierarchy& version1, Hierarchy& version2)
{
    std::ifstream file(path);
    for (std::string line; std::getline(file, line);) {
        const std::size_t first = line.find(':');
        const std::size_t second = first == std::string::npos ? first : line.find(':', first + 1);
        if (second == std::string::npos) continue;
        const std::string controllers = line.substr(first + 1, second - first - 1);
        if (controllers.empty()) version2.group = line.substr(second + 1);
        if (hasWord(controllers, "memory")) version1.group = line.substr(second + 1);
    }
}

// The group's folder below the mount point. "" stands for the mount point itself, the nearest that is seen of a group
// that is not below what is mounted (as in a container, or above the root of a namespace).
std::string folderBelowMount(const Hierarchy& hierarchy)
{
    std::string group = hierarchy.group;
    if (group.empty() || group[0] != '/' || group.find("/..") != std::string::npos) return {};
    if (hierarchy.mountRoot != "/") {
        const std::string& root = hierarchy.mountRoot;
        const bool isBelow = group.compare(0, root.size(), root) == 0 &&
                             (group.size() == root.size() || group[root.size()] == '/');
        if (!isBelow) return {};
        group.erase(0, root.size());
    }
    return group == "/" ? std::string() : group;
}

std::uint64_t freeBytes(const std::string& root, const Hierarchy& hierarchy, const Interface& files)
{
    if (hierarchy.mountPoint.empty()) return kUnlimited;
    const std::string mount = root + hierarchy.mountPoint;
    std::uint64_t least = freeBytesOf(mount, files);
    for (std::string group = folderBelowMount(hierarchy); !group.empty();) {
        least = std::min(least, freeBytesOf(mount + group, files));
        group.erase(group.find_last_of('/'));
    }
    return least;
}

} // namespace

std::uint64_t cgroupFreeBytes(const std::string& root)
{
    Hierarchy version1, version2;
    findMounts(root + "/proc/self/mountinfo", version1, version2);
    findGroups(root + "/proc/self/cgroup", version1, version2);
    return std::min(freeBytes(root, version1, kVersion1), freeBytes(root, version2, kVersion2));
}

} // namespace vdb_nns
