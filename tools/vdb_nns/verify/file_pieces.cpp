#include "file_pieces.h"

#include "vdb_nns/error.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace vdb_nns::cli {

FilePieces::FilePieces(const std::string& path) : mPath(path)
{
    const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (descriptor < 0) throw InputError(path + ": cannot be opened: " + std::strerror(errno));
    struct stat status {};
    const bool isRegular = ::fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode);
    if (!isRegular || status.st_size <= 0) {
        ::close(descriptor);
        throw InputError(path + (isRegular ? ": is empty" : ": is not a regular file"));
    }
    mDescriptor = descriptor;
    mSize = static_cast<std::uint64_t>(status.st_size);
}

FilePieces::~FilePieces()
{
    ::close(mDescriptor);
}

void FilePieces::read(std::uint64_t at, void* out, std::uint64_t bytes) const
{
    char* next = static_cast<char*>(out);
    while (bytes > 0) {
        const ssize_t got = ::pread(mDescriptor, next, bytes, static_cast<off_t>(at));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) {
            throw InputError(mPath + ": cannot be read at byte " + std::to_string(at) + ": " +
                             std::strerror(errno));
        }
        if (got == 0) {
            throw InputError(mPath + ": became shorter while it was read: it had " + std::to_string(mSize) +
                             " bytes and ends before byte " + std::to_string(at) +
                             "; check it once nobody writes it any more");
        }
        next += got;
        at += static_cast<std::uint64_t>(got);
        bytes -= static_cast<std::uint64_t>(got);
    }
}

} // namespace vdb_nns::cli
