// A file that appears whole or not at all: written under a temporary name beside its target, renamed when it
// is done. Knows nothing of formats, lists or OpenVDB.
//
// A process that may run into a file size limit must ignore SIGXFSZ (the command line program does): the
// write then fails with EFBIG and becomes an OutputError. The library changes no signal dispositions. On
// SIGINT and SIGTERM a caller lets its Progress ask to stop; `Cancelled` unwinds through here and the
// temporary is removed. Before a signal ends the process, its handler calls removeTemporaryFiles().
#pragma once

#include "io/temporary_file.h"
#include "vdb_nns/output.h"

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <streambuf>
#include <string>
#include <vector>

namespace vdb_nns {

class OutputFile {
public:
    // Checks the target as checkOutput() does and creates the temporary. A symbolic link to a regular file is
    // followed: the file it leads to is replaced, the link stays.
    // @throws OutputExists, OutputError
    OutputFile(const std::string& path, const OutputOptions& options);

    // Writes at a place of the file, past its end too. Thread-safe.
    // @throws OutputError
    void writeAt(std::uint64_t offset, const void* data, std::size_t bytes);

    // Allocates the blocks of these bytes, as far as they have none. Those past the end of the file are given
    // back by commit(). Writes into allocated blocks are cheaper. Renaming is, too: where ext4 allocates
    // blocks only when it flushes them, it flushes a file before the rename that replaces another one.
    // Advice: nothing is reserved, and no error reported, where the file system refuses or has less free; a
    // write then reports a full disk. No other thread may write to the file meanwhile.
    void reserve(std::uint64_t begin, std::uint64_t end);

    // Throws OutputError unless the disk has room for a file of so many bytes. To be called before anything
    // is written or reserved, which would count twice. Other programs may take the room all the same.
    void requireRoom(std::uint64_t bytes) const;

    // Of the disk, for this user; empty where the file system does not know.
    std::optional<std::uint64_t> freeBytes() const;

    // Renames the temporary to the target. Without it the temporary is removed at the end.
    // @throws OutputError, OutputExists when the target came into being meanwhile and may not be overwritten
    void commit();

    const std::string& path() const { return mPath; }
    const std::string& temporaryPath() const { return mTemporary->name(); }

private:
    void returnReserve() const;
    void replaceTarget();
    void flush(int descriptor, const char* what) const;

    std::string mPath;   // as the caller gave it, for messages
    std::string mTarget; // after symbolic links
    OutputOptions mOptions;
    std::optional<TemporaryFile> mTemporary;
    std::uint64_t mReservedEnd = 0;
};

// Buffers an OutputFile for writers that want a seekable std::ostream. Errors leave as OutputError through a
// stream whose exceptions() hold badbit, and so does what `onWrite` throws. It is told the bytes that were written so
// far, with each buffer and with each thousand of pieces.
class OutputStreamBuffer final : public std::streambuf {
public:
    OutputStreamBuffer(OutputFile& file, std::function<void(std::uint64_t)> onWrite);

protected:
    int_type overflow(int_type character) override;
    std::streamsize xsputn(const char* data, std::streamsize bytes) override;
    int sync() override;
    pos_type seekoff(off_type offset, std::ios_base::seekdir way, std::ios_base::openmode which) override;
    pos_type seekpos(pos_type position, std::ios_base::openmode which) override;

private:
    void flushBuffer();
    void writeThrough(const char* data, std::size_t bytes);

    OutputFile& mFile;
    std::function<void(std::uint64_t)> mOnWrite;
    std::vector<char> mBuffer;
    std::uint64_t mPieces = 0;
    std::uint64_t mStart = 0; // place in the file of the buffer's first byte
    std::uint64_t mEnd = 0;   // bytes of the file so far, less what the buffer holds
};

} // namespace vdb_nns
