// Bytes in memory where a reader expects those of a file.
#pragma once

#include "io/byte_source.h"

#include <cstring>
#include <string>

namespace vdb_nns::testing {

class MemoryBytes final : public ByteSource {
public:
    // The memory must outlive this.
    MemoryBytes(const void* data, std::size_t size, const std::string& name = "memory.vdb")
        : mData(static_cast<const char*>(data))
    {
        mName = name;
        mSize = size;
    }

    void readAt(std::uint64_t offset, void* out, std::size_t bytes) const override
    {
        std::memcpy(out, mData + offset, bytes);
    }

private:
    const char* mData;
};

} // namespace vdb_nns::testing
