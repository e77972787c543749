// Reads the parts of a .vdb file that come one after the other: numbers, texts, blocks of bytes. Every access is held
// against the end of the part before anything is read or allocated.
#pragma once

#include "io/byte_source.h"
#include "vdb_nns/types.h"

#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

namespace vdb_nns {

class VdbCursor {
public:
    // Starts at byte `begin` of the file; nothing at or past `end` is read.
    VdbCursor(const ByteSource& file, std::uint64_t begin, std::uint64_t end);

    const ByteSource& file() const { return *mFile; }
    std::uint64_t position() const { return mPosition; }
    std::uint64_t end() const { return mEnd; }
    std::uint64_t left() const { return mEnd - mPosition; }

    // What the bytes belong to, for messages: "grid 'points'".
    void setPart(std::string part) { mPart = std::move(part); }
    const std::string& part() const { return mPart; }

    // `what` names in messages what is read.
    void skip(std::uint64_t bytes, const char* what);

    // A little-endian number.
    template <typename Number>
    Number number(const char* what)
    {
        static_assert(std::is_arithmetic<Number>::value, "a plain number");
        Number value;
        std::memcpy(&value, take(sizeof value, what), sizeof value);
        return value;
    }

    // A 32-bit length, and so many characters.
    std::string text(const char* what);

    // Valid until the next call.
    const unsigned char* take(std::size_t bytes, const char* what);

    // Throws the InputError of a file that has something else than what is expected at a byte.
    [[noreturn]] void fail(const std::string& expected, std::uint64_t at) const;
    [[noreturn]] void fail(const std::string& expected) const { fail(expected, mPosition); }

private:
    void need(std::uint64_t bytes, const char* what) const;

    const ByteSource* mFile;
    std::uint64_t mPosition, mEnd;
    std::string mPart;
    std::vector<unsigned char> mWindow; // bytes of the file from mWindowBegin on
    std::uint64_t mWindowBegin = 0;
};

// The InputError of a file whose part ("grid 'points'", or empty) breaks what is expected at a byte.
[[noreturn]] void failDamaged(const std::string& file, const std::string& part, const std::string& expected,
                              std::uint64_t at);

} // namespace vdb_nns
