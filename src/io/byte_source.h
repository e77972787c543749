// The bytes that a reader reads: those of a file, or of memory (fuzz targets). Knows no format.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace vdb_nns {

class ByteSource {
public:
    virtual ~ByteSource() = default;

    // For messages.
    const std::string& name() const { return mName; }
    std::uint64_t size() const { return mSize; }

    // Reads bytes that lie inside of size(). Thread-safe.
    // @throws InputError
    virtual void readAt(std::uint64_t offset, void* out, std::size_t bytes) const = 0;

protected:
    std::string mName;
    std::uint64_t mSize = 0;
};

// A regular file, read with pread(): what else the process does with it does not matter.
class InputFile final : public ByteSource {
public:
    // @throws InputError where it is missing, cannot be read, or is none: a folder, a pipe or a device
    explicit InputFile(const std::string& path);
    ~InputFile() override;
    InputFile(const InputFile&) = delete;
    InputFile& operator=(const InputFile&) = delete;

    void readAt(std::uint64_t offset, void* out, std::size_t bytes) const override;

private:
    [[noreturn]] void fail(int error) const;

    int mDescriptor = -1;
};

} // namespace vdb_nns
