// What the header of a .ply file says, and its reader: the elements of the file and the properties of each. A
// header of its own for the sake of its length; ply_reader.cpp is its only user.
#pragma once

#include "io/array_readers.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <string_view>
#include <utility>

namespace vdb_nns {

enum class PlyFormat { kAscii, kLittleEndian, kBigEndian };

enum class PlyType { kInt8, kUInt8, kInt16, kUInt16, kInt32, kUInt32, kFloat, kDouble };

struct PlyTypeName {
    const char* name;
    PlyType type;
};

// The names of the first description and those that came into use later.
constexpr PlyTypeName kPlyTypeNames[] = {
    {"char", PlyType::kInt8},     {"int8", PlyType::kInt8},     {"uchar", PlyType::kUInt8},
    {"uint8", PlyType::kUInt8},   {"short", PlyType::kInt16},   {"int16", PlyType::kInt16},
    {"ushort", PlyType::kUInt16}, {"uint16", PlyType::kUInt16}, {"int", PlyType::kInt32},
    {"int32", PlyType::kInt32},   {"uint", PlyType::kUInt32},   {"uint32", PlyType::kUInt32},
    {"float", PlyType::kFloat},   {"float32", PlyType::kFloat}, {"double", PlyType::kDouble},
    {"float64", PlyType::kDouble}};

inline std::size_t sizeOf(PlyType type)
{
    switch (type) {
    case PlyType::kInt8:
    case PlyType::kUInt8:
        return 1;
    case PlyType::kInt16:
    case PlyType::kUInt16:
        return 2;
    case PlyType::kDouble:
        return 8;
    default:
        return 4;
    }
}

inline bool isReal(PlyType type)
{
    return type == PlyType::kFloat || type == PlyType::kDouble;
}

struct PlyProperty {
    std::string name;
    PlyType type; // of the value, or of a list's values
    bool isList = false;
    PlyType countType = PlyType::kUInt8; // of a list's length
};

struct PlyElement {
    std::string name;
    std::uint64_t count = 0;
    std::vector<PlyProperty> properties;

    // The least that a row can take in the file: lists may be empty; text has a digit and a separator a
    // value.
    std::uint64_t minRowBytes(PlyFormat format) const
    {
        std::uint64_t bytes = 0;
        for (const PlyProperty& property : properties) {
            bytes += format == PlyFormat::kAscii
                         ? 2
                         : sizeOf(property.isList ? property.countType : property.type);
        }
        return bytes;
    }

    bool hasLists() const
    {
        return std::any_of(properties.begin(), properties.end(),
                           [](const PlyProperty& p) { return p.isList; });
    }
};

struct PlyHeader {
    PlyFormat format = PlyFormat::kAscii;
    std::vector<PlyElement> elements;
    std::size_t bytes = 0; // of the header
};

[[noreturn]] inline void failAt(const std::string& path, std::size_t byte, const std::string& what)
{
    throw InputError(path + ": damaged or unsupported .ply at byte " + std::to_string(byte) + ": " + what);
}

class PlyHeaderReader {
public:
    PlyHeaderReader(const std::string& path, FileBytes bytes) : mPath(path), mBytes(bytes) {}

    PlyHeader read()
    {
        readLine();
        if (mWords.size() != 1 || mWords[0] != "ply") {
            throw InputError(mPath + ": is not a .ply file: its first line is not 'ply'");
        }
        readLine();
        readFormat();
        for (readLine(); mWords.empty() || mWords[0] != "end_header"; readLine()) {
            if (mWords.empty() || mWords[0] == "comment" || mWords[0] == "obj_info") continue;
            if (mWords[0] == "element") {
                readElement();
            } else if (mWords[0] == "property") {
                readProperty();
            } else {
                fail("header line '" + std::string(mWords[0].substr(0, 40)) + "' is unknown");
            }
        }
        mHeader.bytes = mNext;
        return std::move(mHeader);
    }

private:
    [[noreturn]] void fail(const std::string& what) const { failAt(mPath, mLineStart, what); }

    void readLine()
    {
        mLineStart = mNext;
        const char* const text = reinterpret_cast<const char*>(mBytes.data());
        const void* const found =
            mNext < mBytes.size() ? std::memchr(text + mNext, '\n', mBytes.size() - mNext) : nullptr;
        if (!found) fail("the header has no 'end_header'; the file is truncated or no .ply");
        const std::size_t end = static_cast<std::size_t>(static_cast<const char*>(found) - text);
        std::string_view line(text + mNext, end - mNext);
        mNext = end + 1;
        mWords.clear();
        while (true) {
            const std::size_t first = line.find_first_not_of(" \t\r");
            if (first == std::string_view::npos) return;
            const std::size_t last = std::min(line.find_first_of(" \t\r", first), line.size());
            mWords.push_back(line.substr(first, last - first));
            line.remove_prefix(last);
        }
    }

    void readFormat()
    {
        if (mWords.size() != 3 || mWords[0] != "format") fail("the second line is not 'format NAME 1.0'");
        if (mWords[2] != "1.0") fail("version '" + std::string(mWords[2].substr(0, 40)) + "' is not 1.0");
        if (mWords[1] == "ascii") {
            mHeader.format = PlyFormat::kAscii;
        } else if (mWords[1] == "binary_little_endian") {
            mHeader.format = PlyFormat::kLittleEndian;
        } else if (mWords[1] == "binary_big_endian") {
            mHeader.format = PlyFormat::kBigEndian;
        } else {
            fail("format '" + std::string(mWords[1].substr(0, 40)) +
                 "' is not ascii, binary_little_endian or binary_big_endian");
        }
    }

    void readElement()
    {
        if (mWords.size() != 3) fail("expected 'element NAME COUNT'");
        PlyElement element;
        element.name = mWords[1];
        const char* const last = mWords[2].data() + mWords[2].size();
        const std::from_chars_result result = std::from_chars(mWords[2].data(), last, element.count);
        if (result.ec != std::errc() || result.ptr != last) {
            fail("the count '" + std::string(mWords[2].substr(0, 40)) + "' is not a number from 0 to 2^64-1");
        }
        for (const PlyElement& other : mHeader.elements) {
            if (other.name == element.name)
                fail("element '" + element.name.substr(0, 40) + "' is there twice");
        }
        mHeader.elements.push_back(std::move(element));
    }

    void readProperty()
    {
        if (mHeader.elements.empty()) fail("a property stands before any element");
        PlyProperty property;
        if (mWords.size() == 5 && mWords[1] == "list") {
            property.isList = true;
            property.countType = typeOf(mWords[2]);
            if (isReal(property.countType)) fail("the length of a list cannot be a real number");
            property.type = typeOf(mWords[3]);
        } else if (mWords.size() == 3) {
            property.type = typeOf(mWords[1]);
        } else {
            fail("expected 'property TYPE NAME' or 'property list TYPE TYPE NAME'");
        }
        property.name = mWords.back();
        mHeader.elements.back().properties.push_back(std::move(property));
    }

    PlyType typeOf(std::string_view name) const
    {
        for (const PlyTypeName& known : kPlyTypeNames) {
            if (name == known.name) return known.type;
        }
        fail("type '" + std::string(name.substr(0, 40)) + "' is unknown");
    }

    const std::string& mPath;
    FileBytes mBytes;
    std::size_t mNext = 0, mLineStart = 0;
    std::vector<std::string_view> mWords;
    PlyHeader mHeader;
};

} // namespace vdb_nns
