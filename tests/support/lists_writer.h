// Writes .npz files of neighbor lists for the tests of their readers, right or with a lie, by code of its own.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace vdb_nns::testing {

// The lists as the file will hold them; nothing is checked.
struct RawLists {
    std::vector<std::int64_t> offsets; // indptr
    std::vector<std::int64_t> indices;
    std::vector<float> distances;            // float32 data; empty: int8 ones
    std::optional<std::size_t> columns = {}; // none: as many as rows
};

RawLists rawLists(const std::vector<std::vector<std::uint32_t>>& rows);

using Members = std::vector<std::pair<std::string, std::string>>; // name in the archive, bytes

// A version 1.0 .npy array around `bytes`; `shape` as Python prints it, e.g. "(5,)".
std::string npyBytes(const std::string& descr, const std::string& shape, const std::string& bytes);

template <typename Stored, typename Value>
std::string bytesOf(const std::vector<Value>& values)
{
    std::string bytes;
    bytes.reserve(values.size() * sizeof(Stored));
    for (const Value value : values) {
        const auto stored = static_cast<Stored>(value);
        bytes.append(reinterpret_cast<const char*>(&stored), sizeof(Stored));
    }
    return bytes;
}

// The members of design's .npz lists: indptr int64, indices int32, data, shape, format.
Members listMembers(const RawLists& lists);

// A stored ZIP with right CRC-32s.
std::string zipBytes(const Members& members);

void writeBytes(const std::string& path, const std::string& bytes);

} // namespace vdb_nns::testing
