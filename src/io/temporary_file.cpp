#include "io/temporary_file.h"

#include "vdb_nns/output.h"

#include <atomic>
#include <cerrno>
#include <climits>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <system_error>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

namespace vdb_nns {

// The name of a temporary file where a signal handler can read it, which may neither wait nor allocate.
struct TemporarySlot {
    enum State { kFree, kFilling, kHeld, kRemoved };
    std::atomic<int> state{kFree}; // a slot whose file a handler removed is not used again
    pid_t process = 0;             // a child of fork() inherits the table, but not the files
    char name[PATH_MAX] = {};
};

namespace {

static_assert(std::atomic<int>::is_always_lock_free, "a signal handler may only touch lock-free atomics");
TemporarySlot gSlots[64];

TemporarySlot* fillSlot(const std::string& name)
{
    if (name.size() >= sizeof TemporarySlot::name) return nullptr; // open() will not take it
    for (TemporarySlot& slot : gSlots) {
        int expected = TemporarySlot::kFree;
        if (!slot.state.compare_exchange_strong(expected, TemporarySlot::kFilling)) continue;
        slot.process = ::getpid();
        slot.name[name.copy(slot.name, name.size())] = '\0';
        slot.state.store(TemporarySlot::kHeld);
        return &slot;
    }
    return nullptr;
}

void freeSlot(TemporarySlot* slot)
{
    if (!slot) return;
    int expected = TemporarySlot::kHeld;
    slot->state.compare_exchange_strong(expected, TemporarySlot::kFree);
}

// Leaves room for the rest within the 255 bytes of a file name.
constexpr std::size_t kMaxBaseNameBytes = 200;
constexpr const char* kMark = ".vdb_nns-";
constexpr const char* kEnd = ".tmp";

// Stands for this host: its name may be long and have any character.
std::string hostMark()
{
    char name[HOST_NAME_MAX + 1] = {};
    ::gethostname(name, sizeof name - 1);
    char text[16];
    const auto bytes = static_cast<uInt>(std::strlen(name));
    std::snprintf(text, sizeof text, "%lx", crc32(0, reinterpret_cast<const Bytef*>(name), bytes));
    return text;
}

// What all temporary names of a target that this host writes begin with: a folder and the beginning of a name.
struct Stem {
    std::string folder, name; // the folder with its slash, or empty
};

Stem stemOf(const std::string& target)
{
    const std::size_t slash = target.rfind('/');
    const std::size_t begin = slash == std::string::npos ? 0 : slash + 1;
    return {target.substr(0, begin), target.substr(begin, kMaxBaseNameBytes) + kMark + hostMark() + "-"};
}

// Unique within the machine at one time: process, and a count within the process.
std::string temporaryEnding()
{
    static std::atomic<unsigned> sCount{0};
    char text[32];
    std::snprintf(text, sizeof text, "%x-%x%s", static_cast<unsigned>(::getpid()), sCount.fetch_add(1), kEnd);
    return text;
}

bool isTemporaryName(const std::string& name, const Stem& stem)
{
    if (name.compare(0, stem.name.size(), stem.name) != 0) return false;
    const char* const digits = "0123456789abcdef";
    const std::size_t process = stem.name.size();
    const std::size_t dash = name.find_first_not_of(digits, process);
    if (dash == std::string::npos || dash == process || name[dash] != '-') return false;
    const std::size_t end = name.find_first_not_of(digits, dash + 1);
    return end != std::string::npos && end > dash + 1 && name.compare(end, std::string::npos, kEnd) == 0;
}

bool isNameOf(const std::string& name, int descriptor)
{
    struct stat named {
    }, open{};
    return ::lstat(name.c_str(), &named) == 0 && ::fstat(descriptor, &open) == 0 &&
           named.st_dev == open.st_dev && named.st_ino == open.st_ino;
}

void removeUnlessHeld(const std::string& name)
{
    struct stat status {};
    if (::lstat(name.c_str(), &status) != 0 || !S_ISREG(status.st_mode) || status.st_uid != ::geteuid())
        return;
    const int flags = O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK;
    int descriptor = ::open(name.c_str(), O_RDWR | flags); // NFS locks files that may be written
    if (descriptor < 0) descriptor = ::open(name.c_str(), O_RDONLY | flags);
    if (descriptor < 0) return;
    // While it was opened, it may have been renamed to its target, and is then held no more.
    if (::flock(descriptor, LOCK_EX | LOCK_NB) == 0 && isNameOf(name, descriptor)) ::unlink(name.c_str());
    ::close(descriptor);
}

void removeLeftovers(const Stem& stem)
{
    namespace fs = std::filesystem;
    std::error_code error; // a folder that cannot be listed keeps what is in it
    fs::directory_iterator file(stem.folder.empty() ? "." : stem.folder, error);
    for (; !error && file != fs::directory_iterator(); file.increment(error)) {
        const std::string name = file->path().filename().string();
        if (isTemporaryName(name, stem)) removeUnlessHeld(stem.folder + name);
    }
}

} // namespace

TemporaryFile::TemporaryFile(const std::string& target, unsigned mode)
{
    const Stem stem = stemOf(target);
    removeLeftovers(stem);
    for (int attempt = 0; attempt < 1000; ++attempt) {
        const std::string name = stem.folder + stem.name + temporaryEnding();
        TemporarySlot* const slot = fillSlot(name); // a signal may come as soon as there is a file
        const int descriptor = ::open(name.c_str(), O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, mode);
        if (descriptor < 0) {
            const int error = errno;
            freeSlot(slot);
            if (error == EEXIST) continue;
            throw std::system_error(error, std::generic_category());
        }
        // Before it was held, another process may have taken it for left over. Some file systems have no locks; there
        // nobody can hold it, and nobody removes it.
        const bool isRefused = ::flock(descriptor, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
        if (!isRefused && isNameOf(name, descriptor)) {
            mDescriptor = descriptor;
            mName = name;
            mSlot = slot;
            return;
        }
        freeSlot(slot);
        ::close(descriptor);
    }
    throw std::system_error(EEXIST, std::generic_category());
}

TemporaryFile::~TemporaryFile()
{
    if (!mIsRenamed) ::unlink(mName.c_str());
    freeSlot(mSlot);
    ::close(mDescriptor);
}

void removeTemporaryFiles() noexcept
{
    for (TemporarySlot& slot : gSlots) {
        int expected = TemporarySlot::kHeld;
        const bool isTaken = slot.state.compare_exchange_strong(expected, TemporarySlot::kRemoved);
        if (isTaken && slot.process == ::getpid()) ::unlink(slot.name);
    }
}

} // namespace vdb_nns
