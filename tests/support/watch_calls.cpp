// A library to load before the program (LD_PRELOAD): appends to the file that $VDB_NNS_CALLS names a line for each flush and
// each renaming, with the paths. With $VDB_NNS_NO_PROGRAMS there is no program that could be started. With
// $VDB_NNS_SLOW_FLUSH a flush takes so many seconds, whatever signals come. With $VDB_NNS_SIGNAL_AT_CREATE the process gets
// that signal while it creates a file, which is there by then.
#include <cerrno>
#include <csignal>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <string>

#include <dlfcn.h>
#include <fcntl.h>
#include <spawn.h>
#include <unistd.h>

namespace {

void log(const std::string& line)
{
    const char* const path = std::getenv("VDB_NNS_CALLS");
    if (!path) return;
    std::FILE* const file = std::fopen(path, "a");
    if (!file) return;
    std::fputs((line + "\n").c_str(), file);
    std::fclose(file);
}

std::string pathOf(int descriptor)
{
    char path[4096];
    const ssize_t length =
        ::readlink(("/proc/self/fd/" + std::to_string(descriptor)).c_str(), path, sizeof path);
    return {path, length < 0 ? 0 : static_cast<std::size_t>(length)};
}

template <typename F>
F* realCall(const char* name, F*)
{
    return reinterpret_cast<F*>(::dlsym(RTLD_NEXT, name));
}

} // namespace

extern "C" {

int open(const char* path, int flags, ...)
{
    va_list arguments;
    va_start(arguments, flags);
    const mode_t mode = flags & O_CREAT ? va_arg(arguments, mode_t) : 0;
    va_end(arguments);
    using Open = int(const char*, int, ...);
    static Open* const real = reinterpret_cast<Open*>(::dlsym(RTLD_NEXT, "open"));
    const int descriptor = real(path, flags, mode);
    if (const char* const signal = flags & O_CREAT ? std::getenv("VDB_NNS_SIGNAL_AT_CREATE") : nullptr)
        std::raise(std::atoi(signal));
    return descriptor;
}

int fsync(int descriptor)
{
    log("flush " + pathOf(descriptor));
    if (const char* const seconds = std::getenv("VDB_NNS_SLOW_FLUSH")) {
        for (unsigned left = static_cast<unsigned>(std::atoi(seconds)); left > 0;) left = ::sleep(left);
    }
    return realCall("fsync", &fsync)(descriptor);
}

int rename(const char* from, const char* to) noexcept
{
    log(std::string("rename ") + from + " " + to);
    return realCall("rename", &rename)(from, to);
}

int renameat2(int fromFolder, const char* from, int toFolder, const char* to, unsigned flags) noexcept
{
    log(std::string("rename ") + from + " " + to);
    return realCall("renameat2", &renameat2)(fromFolder, from, toFolder, to, flags);
}

int posix_spawnp(pid_t* child, const char* file, const posix_spawn_file_actions_t* actions,
                 const posix_spawnattr_t* attributes, char* const arguments[], char* const environment[])
{
    if (std::getenv("VDB_NNS_NO_PROGRAMS")) return ENOENT;
    return realCall("posix_spawnp", &posix_spawnp)(child, file, actions, attributes, arguments, environment);
}
}
