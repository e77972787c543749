#include "text_file.h"

#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

// Owns a temporary file until it is renamed to its target.
class TemporaryFile {
public:
    explicit TemporaryFile(const std::string& target)
        : mTarget(target), mName(target + ".tmp" + std::to_string(getpid()))
    {
        mDescriptor = ::open(mName.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        if (mDescriptor < 0) fail("create");
    }
    ~TemporaryFile()
    {
        if (mDescriptor >= 0) ::close(mDescriptor);
        if (!mRenamed) ::unlink(mName.c_str());
    }
    TemporaryFile(const TemporaryFile&) = delete;
    TemporaryFile& operator=(const TemporaryFile&) = delete;

    void write(const char* data, std::size_t bytes)
    {
        while (bytes > 0) {
            const ssize_t written = ::write(mDescriptor, data, bytes);
            if (written < 0 && errno == EINTR) continue;
            if (written < 0) fail("write");
            data += written;
            bytes -= static_cast<std::size_t>(written);
        }
    }

    void rename()
    {
        const int descriptor = mDescriptor;
        mDescriptor = -1;
        if (::close(descriptor) != 0) fail("close");
        if (std::rename(mName.c_str(), mTarget.c_str()) != 0) fail("rename to");
        mRenamed = true;
    }

private:
    [[noreturn]] void fail(const char* what) const
    {
        throw OutputError(mTarget + ": cannot " + what + " the file: " + std::strerror(errno));
    }

    std::string mTarget, mName;
    int mDescriptor = -1;
    bool mRenamed = false;
};

} // namespace

bool openStandardStreams()
{
    for (int descriptor = 0; descriptor <= 2; ++descriptor) {
        if (::fcntl(descriptor, F_GETFD) >= 0) continue;
        if (::open("/dev/null", O_RDWR) == descriptor) continue; // the lowest number that is free
        std::perror("vdb_nns: error: /dev/null");
        return false;
    }
    return true;
}

void writeWholeFile(const std::string& path, const void* data, std::size_t bytes, bool overwrite)
{
    checkOutput(path, overwrite);
    TemporaryFile file(path);
    file.write(static_cast<const char*>(data), bytes);
    checkOutput(path, overwrite); // it may have appeared meanwhile
    file.rename();
}

void writeStdout(const std::string& text)
{
    const bool written = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
    if (!written || std::fflush(stdout) != 0) {
        throw OutputError(std::string("standard output: cannot write: ") + std::strerror(errno));
    }
}

} // namespace vdb_nns::cli
