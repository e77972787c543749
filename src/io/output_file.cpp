// Creates, writes and renames output files with the system's own calls, so that every failure has its errno.
#include "io/output_file.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

namespace vdb_nns {

namespace {

// A write call beyond 2 GiB is cut by the kernel; 1 GiB keeps clear of that.
constexpr std::size_t kMaxWriteBytes = std::size_t(1) << 30;
// OpenVDB writes many values of a few bytes.
constexpr std::size_t kStreamBufferBytes = std::size_t(4) << 20;
// It compresses each leaf for the two bytes of its size, so that a whole tree may be less than a buffer.
constexpr std::uint64_t kPiecesPerCall = 1024;

std::string nextStep(int error)
{
    switch (error) {
    case ENOSPC:
    case EDQUOT:
        return "; free space there or write to another disk";
    case EFBIG:
        return "; raise the file size limit (ulimit -f) or write to another file system";
    case EACCES:
    case EPERM:
    case EROFS:
        return "; choose a folder that you may write to";
    case ENOENT:
    case ENOTDIR:
        return "; create the folder first";
    default:
        return {};
    }
}

[[noreturn]] void failOutput(const std::string& path, const std::string& what, int error)
{
    throw OutputError(path + ": " + what + ": " + std::strerror(error) + nextStep(error));
}

struct Target {
    std::string path;             // after symbolic links
    std::optional<unsigned> mode; // permissions of the file to be replaced
};

std::string folderOf(const std::string& path)
{
    const std::size_t slash = path.rfind('/');
    if (slash == std::string::npos) return ".";
    return slash == 0 ? "/" : path.substr(0, slash);
}

// What a path may be written to, or the reason why not.
Target resolveTarget(const std::string& path, bool overwrite)
{
    if (path.empty()) throw OutputError("the name of an output file is empty");
    struct stat status {};
    if (::lstat(path.c_str(), &status) != 0) {
        if (errno != ENOENT) failOutput(path, "cannot be written", errno);
        if (path.back() == '/') failOutput(path, "cannot be written", EISDIR);
        struct stat folder {};
        if (::stat(folderOf(path).c_str(), &folder) != 0)
            failOutput(path, "its folder cannot be used", errno);
        if (!S_ISDIR(folder.st_mode)) failOutput(path, "its folder cannot be used", ENOTDIR);
        return {path, std::nullopt};
    }
    std::string resolved = path;
    if (S_ISLNK(status.st_mode)) {
        const std::unique_ptr<char, void (*)(void*)> real(::realpath(path.c_str(), nullptr), &std::free);
        if (!real || ::stat(path.c_str(), &status) != 0) {
            throw OutputExists(
                path + ": is a symbolic link that leads to no file; remove it or choose another name");
        }
        resolved = real.get();
    }
    if (!S_ISREG(status.st_mode)) {
        throw OutputExists(path +
                           ": exists and is not a regular file; it is never replaced, choose another name");
    }
    if (!overwrite) {
        throw OutputExists(path + ": exists already; allow overwriting (--force) or choose another name");
    }
    return {resolved, static_cast<unsigned>(status.st_mode & 07777)};
}

// Closed at the end.
class Descriptor {
public:
    explicit Descriptor(int number) : mNumber(number) {}
    ~Descriptor()
    {
        if (mNumber >= 0) ::close(mNumber);
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;

    int number() const { return mNumber; }

private:
    int mNumber;
};

} // namespace

void checkOutput(const std::string& path, bool overwrite)
{
    const std::string folder = folderOf(resolveTarget(path, overwrite).path);
    if (::access(folder.c_str(), W_OK | X_OK) != 0)
        failOutput(path, "its folder cannot be written to", errno);
}

OutputFile::OutputFile(const std::string& path, const OutputOptions& options) : mPath(path), mOptions(options)
{
    const Target target = resolveTarget(path, options.overwrite);
    mTarget = target.path;
    try {
        mTemporary.emplace(mTarget, target.mode.value_or(0666));
    } catch (const std::system_error& error) {
        failOutput(mPath, "cannot be created", error.code().value());
    }
    // A new file takes the process's umask, a replaced one keeps the permissions it had, as far as that is
    // allowed.
    if (target.mode && ::fchmod(mTemporary->descriptor(), *target.mode) != 0 && errno != EPERM)
        failOutput(mPath, "permissions cannot be set", errno);
}

void OutputFile::writeAt(std::uint64_t offset, const void* data, std::size_t bytes)
{
    const char* next = static_cast<const char*>(data);
    while (bytes > 0) {
        const ssize_t written = ::pwrite(mTemporary->descriptor(), next, std::min(bytes, kMaxWriteBytes),
                                         static_cast<off_t>(offset));
        if (written < 0) {
            if (errno == EINTR) continue;
            failOutput(mPath, "writing failed at byte " + std::to_string(offset), errno);
        }
        if (written == 0) failOutput(mPath, "writing failed at byte " + std::to_string(offset), ENOSPC);
        next += written;
        offset += static_cast<std::uint64_t>(written);
        bytes -= static_cast<std::size_t>(written);
    }
}

void OutputFile::reserve(std::uint64_t begin, std::uint64_t end)
{
    if (begin >= end) return;
    const std::optional<std::uint64_t> free = freeBytes();
    if (free && end - begin > *free) return;
    const int descriptor = mTemporary->descriptor();
    if (::fallocate(descriptor, FALLOC_FL_KEEP_SIZE, static_cast<off_t>(begin),
                    static_cast<off_t>(end - begin)) == 0) {
        mReservedEnd = std::max(mReservedEnd, end);
        return;
    }
    // Some file systems keep what they allocated before they failed.
    struct stat status {};
    if (::fstat(descriptor, &status) == 0 && ::ftruncate(descriptor, status.st_size) == 0) mReservedEnd = 0;
}

void OutputFile::returnReserve() const
{
    struct stat status {};
    const int descriptor = mTemporary->descriptor();
    if (::fstat(descriptor, &status) != 0) failOutput(mPath, "cannot be looked at", errno);
    if (mReservedEnd <= static_cast<std::uint64_t>(status.st_size)) return;
    if (::ftruncate(descriptor, status.st_size) != 0) failOutput(mPath, "cannot be cut to its size", errno);
}

std::optional<std::uint64_t> OutputFile::freeBytes() const
{
    struct statvfs status {};
    // Some file systems do not know their size: the disk is full there when a write says so.
    if (::fstatvfs(mTemporary->descriptor(), &status) != 0 || status.f_blocks == 0 || status.f_frsize == 0)
        return std::nullopt;
    return std::uint64_t(status.f_bavail) * status.f_frsize;
}

void OutputFile::requireRoom(std::uint64_t bytes) const
{
    const std::optional<std::uint64_t> free = freeBytes();
    if (!free || bytes <= *free) return;
    throw OutputError(mPath + ": needs " + std::to_string(bytes) + " bytes, and its disk has " +
                      std::to_string(*free) + " bytes free" + nextStep(ENOSPC));
}

void OutputFile::commit()
{
    returnReserve();
    // Network file systems tell at a close what could not be written. The temporary itself stays open: it is held until it
    // has its name.
    const int copy = ::fcntl(mTemporary->descriptor(), F_DUPFD_CLOEXEC, 0);
    if (copy < 0 || (::close(copy) != 0 && errno != EINTR)) failOutput(mPath, "closing failed", errno);
    if (!mOptions.sync) return replaceTarget();
    const Descriptor folder(::open(folderOf(mTarget).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder.number() < 0) failOutput(mPath, "its folder cannot be opened to flush it to the disk", errno);
    flush(mTemporary->descriptor(), "flushing it to the disk failed");
    replaceTarget();
    flush(folder.number(), "flushing its folder to the disk failed");
}

void OutputFile::flush(int descriptor, const char* what) const
{
    if (::fsync(descriptor) != 0) failOutput(mPath, what, errno);
}

void OutputFile::replaceTarget()
{
    const char* const from = mTemporary->name().c_str();
    bool isRenamed = false;
    if (!mOptions.overwrite) {
        isRenamed = ::renameat2(AT_FDCWD, from, AT_FDCWD, mTarget.c_str(), RENAME_NOREPLACE) == 0;
        if (!isRenamed && errno == EEXIST) {
            throw OutputExists(mPath + ": came into being while it was written; choose another name");
        }
        // Some network file systems know no such flag.
        if (!isRenamed && errno != EINVAL && errno != ENOSYS)
            failOutput(mPath, "renaming the finished file failed", errno);
    }
    if (!isRenamed && ::rename(from, mTarget.c_str()) != 0)
        failOutput(mPath, "renaming the finished file failed", errno);
    mTemporary->setRenamed();
}

void writeFile(const std::string& path, const void* data, std::size_t bytes, const OutputOptions& options)
{
    OutputFile file(path, options);
    file.writeAt(0, data, bytes);
    file.commit();
}

OutputStreamBuffer::OutputStreamBuffer(OutputFile& file, std::function<void(std::uint64_t)> onWrite)
    : mFile(file), mOnWrite(std::move(onWrite)), mBuffer(kStreamBufferBytes)
{
    setp(mBuffer.data(), mBuffer.data() + mBuffer.size());
}

void OutputStreamBuffer::flushBuffer()
{
    writeThrough(pbase(), static_cast<std::size_t>(pptr() - pbase()));
    setp(mBuffer.data(), mBuffer.data() + mBuffer.size());
}

void OutputStreamBuffer::writeThrough(const char* data, std::size_t bytes)
{
    mFile.writeAt(mStart, data, bytes);
    mStart += bytes;
    mEnd = std::max(mEnd, mStart);
    mOnWrite(mEnd);
}

OutputStreamBuffer::int_type OutputStreamBuffer::overflow(int_type character)
{
    flushBuffer();
    if (traits_type::eq_int_type(character, traits_type::eof())) return traits_type::not_eof(character);
    *pptr() = traits_type::to_char_type(character);
    pbump(1);
    return character;
}

std::streamsize OutputStreamBuffer::xsputn(const char* data, std::streamsize bytes)
{
    if (++mPieces % kPiecesPerCall == 0) mOnWrite(mEnd);
    if (bytes > epptr() - pptr()) flushBuffer();
    if (bytes > epptr() - pptr()) { // larger than the whole buffer
        writeThrough(data, static_cast<std::size_t>(bytes));
        return bytes;
    }
    std::memcpy(pptr(), data, static_cast<std::size_t>(bytes));
    pbump(static_cast<int>(bytes));
    return bytes;
}

int OutputStreamBuffer::sync()
{
    flushBuffer();
    return 0;
}

OutputStreamBuffer::pos_type OutputStreamBuffer::seekoff(off_type offset, std::ios_base::seekdir way,
                                                         std::ios_base::openmode which)
{
    const std::uint64_t here = mStart + static_cast<std::uint64_t>(pptr() - pbase());
    if (way == std::ios_base::cur && offset == 0) return pos_type(static_cast<off_type>(here)); // tellp()
    off_type base = 0;
    if (way == std::ios_base::cur) base = static_cast<off_type>(here);
    if (way == std::ios_base::end) base = static_cast<off_type>(std::max(mEnd, here));
    return seekpos(pos_type(base + offset), which);
}

OutputStreamBuffer::pos_type OutputStreamBuffer::seekpos(pos_type position, std::ios_base::openmode which)
{
    if (!(which & std::ios_base::out) || off_type(position) < 0) return pos_type(off_type(-1));
    flushBuffer();
    mStart = static_cast<std::uint64_t>(off_type(position));
    return position;
}

} // namespace vdb_nns
