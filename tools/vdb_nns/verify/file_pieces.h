// A regular file that is read piece by piece, from any place. It is not mapped: touching a page of a mapped file that has
// been cut off meanwhile kills the process.
#pragma once

#include <cstdint>
#include <string>

namespace vdb_nns::cli {

class FilePieces {
public:
    // @throws InputError: no such file, not a regular one, or empty
    explicit FilePieces(const std::string& path);
    ~FilePieces();
    FilePieces(const FilePieces&) = delete;
    FilePieces& operator=(const FilePieces&) = delete;

    const std::string& path() const { return mPath; }
    std::uint64_t size() const { return mSize; } // when it was opened

    // Safe to call from several threads.
    // @throws InputError where the file cannot be read, or has become shorter
    void read(std::uint64_t at, void* out, std::uint64_t bytes) const;

private:
    std::string mPath;
    int mDescriptor = -1;
    std::uint64_t mSize = 0;
};

} // namespace vdb_nns::cli
