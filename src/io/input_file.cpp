#include "io/byte_source.h"

#include "vdb_nns/error.h"

#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

namespace vdb_nns {

InputFile::InputFile(const std::string& path)
{
    mName = path;
    struct stat status {};
    if (::stat(path.c_str(), &status) != 0) fail(errno);
    // A pipe or a device has no size to hold a header's numbers against, and cannot be read twice.
    if (!S_ISREG(status.st_mode)) {
        throw InputError(path + ": is not a regular file (" +
                         (S_ISFIFO(status.st_mode) ? "a pipe" : "a device or a socket") +
                         "), and is read at any place and more than once; write its content to a file first");
    }
    // A pipe that takes its place now does not make it wait.
    mDescriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (mDescriptor < 0) fail(errno);
    if (::fstat(mDescriptor, &status) != 0 || !S_ISREG(status.st_mode)) {
        ::close(mDescriptor);
        throw InputError(path + ": was replaced while it was opened; give the name of a regular file");
    }
    mSize = static_cast<std::uint64_t>(status.st_size);
    char first = 0;
    if (mSize == 0 && ::pread(mDescriptor, &first, 1, 0) > 0) {
        ::close(mDescriptor);
        throw InputError(path + ": has content but no size, as files of /proc have; copy it first");
    }
}

InputFile::~InputFile()
{
    ::close(mDescriptor);
}

void InputFile::readAt(std::uint64_t offset, void* out, std::size_t bytes) const
{
    char* next = static_cast<char*>(out);
    while (bytes > 0) {
        const ssize_t got = ::pread(mDescriptor, next, bytes, static_cast<off_t>(offset));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) fail(errno);
        if (got == 0) {
            throw InputError(mName + ": became shorter while it was read, at byte " + std::to_string(offset) +
                             " of " + std::to_string(mSize));
        }
        next += got;
        offset += static_cast<std::uint64_t>(got);
        bytes -= static_cast<std::size_t>(got);
    }
}

void InputFile::fail(int error) const
{
    const bool hasTooMany = error == EMFILE || error == ENFILE;
    throw InputError(mName + ": cannot be read: " + std::strerror(error) +
                     (hasTooMany ? "; allow the process more of them (ulimit -n)"
                                 : "; check the name and the permissions"));
}

} // namespace vdb_nns
