// Gives text to the readers of array formats.
#pragma once

#include "io/array_readers.h"

#include "vdb_nns/error.h"

#include <cstring>
#include <string>
#include <vector>

// The InputError of an expression says so.
#define EXPECT_ERROR(expression, part)                                                                       \
    EXPECT_NE(::vdb_nns::testing::errorOf([&] { expression; }).find(part), std::string::npos)                \
        << ::vdb_nns::testing::errorOf([&] { expression; })

namespace vdb_nns::testing {

inline FileBytes bytesOf(const std::string& text)
{
    return {reinterpret_cast<const unsigned char*>(text.data()), text.size()};
}

// read(ArrayFile) on bytes that stand for a file of that name.
template <typename Read>
auto readAs(const std::string& name, FileBytes bytes, Read&& read, const ArrayChoice& choice = {},
            std::uint64_t allowedBytes = kAnyBytes)
{
    const CancelCheck cancel(nullptr, "read");
    return read(ArrayFile{name, bytes, choice, allowedBytes, cancel});
}

// The message of the InputError that a reader throws; empty if it throws none.
template <typename F>
std::string errorOf(F&& read)
{
    try {
        read();
    } catch (const InputError& error) {
        return error.what();
    }
    return {};
}

// Values as a file holds them.
template <typename Number>
std::string rawValues(const std::vector<Number>& values, bool isBigEndian = false)
{
    std::string out;
    for (const Number value : values) {
        char raw[sizeof(Number)];
        std::memcpy(raw, &value, sizeof value);
        for (std::size_t i = 0; i < sizeof raw; ++i) out += raw[isBigEndian ? sizeof raw - 1 - i : i];
    }
    return out;
}

} // namespace vdb_nns::testing
