// What the header of a .ply file says, and its reader: the elements of the file and the properties of each. A
// header of its own for the sake of its length; ply_reader.cpp is its only user. Lines end with LF or CR LF;
// where the first one ends with a lone CR, all do. Comments may stand anywhere behind the first line.
#pragma once

#include "io/array_readers.h"
#include "io/number_type.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <string_view>
#include <utility>

namespace vdb_nns {

enum class PlyFormat { kAscii, kLittleEndian, kBigEndian };

struct PlyTypeName {
    const char* name;
    NumberType type;
};

// The names of the first description and those that came into use later.
constexpr PlyTypeName kPlyTypeNames[] = {
    {"char", NumberType::kInt8},     {"int8", NumberType::kInt8},     {"uchar", NumberType::kUInt8},
    {"uint8", NumberType::kUInt8},   {"short", NumberType::kInt16},   {"int16", NumberType::kInt16},
    {"ushort", NumberType::kUInt16}, {"uint16", NumberType::kUInt16}, {"int", NumberType::kInt32},
    {"int32", NumberType::kInt32},   {"uint", NumberType::kUInt32},   {"uint32", NumberType::kUInt32},
    {"float", NumberType::kFloat},   {"float32", NumberType::kFloat}, {"double", NumberType::kDouble},
    {"float64", NumberType::kDouble}};

struct PlyProperty {
    std::string name;
    NumberType type; // of the value, or of a list's values
    bool isList = false;
    NumberType countType = NumberType::kUInt8; // of a list's length
    std::string declared;                      // type as the header has it: "float", "list uchar int"
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
    char lineEnd = '\n';   // or '\r'; an '\r' before '\n' is dropped
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
        findLineEnds();
        readLine();
        if (mWords.size() != 1 || mWords[0] != "ply") {
            throw InputError(mPath + ": is not a .ply file: its first line is not 'ply' but '" +
                             shownText(mWords.empty() ? std::string_view() : mWords[0]) + "'");
        }
        bool hasFormat = false;
        for (readLine(); mWords.empty() || mWords[0] != "end_header"; readLine()) {
            if (mWords.empty() || mWords[0] == "comment" || mWords[0] == "obj_info") continue;
            if (!hasFormat) {
                readFormat();
                hasFormat = true;
            } else if (mWords[0] == "element") {
                readElement();
            } else if (mWords[0] == "property") {
                readProperty();
            } else {
                fail("header line '" + shownText(mWords[0]) + "' is unknown");
            }
        }
        if (!hasFormat) fail("there is no line 'format NAME 1.0'");
        mHeader.bytes = mNext;
        return std::move(mHeader);
    }

private:
    [[noreturn]] void fail(const std::string& what) const { failAt(mPath, mLineStart, what); }

    void findLineEnds()
    {
        const unsigned char* const first =
            std::find_if(mBytes.data(), mBytes.data() + mBytes.size(),
                         [](unsigned char c) { return c == '\n' || c == '\r'; });
        const std::size_t at = static_cast<std::size_t>(first - mBytes.data());
        if (at + 1 < mBytes.size() && *first == '\r' && first[1] != '\n') mHeader.lineEnd = '\r';
    }

    void readLine()
    {
        mLineStart = mNext;
        const char* const text = reinterpret_cast<const char*>(mBytes.data());
        const void* const found = mNext < mBytes.size()
                                      ? std::memchr(text + mNext, mHeader.lineEnd, mBytes.size() - mNext)
                                      : nullptr;
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
        if (mWords.size() != 3 || mWords[0] != "format")
            fail("expected the line 'format NAME 1.0', found '" + shownText(mWords[0]) + "'");
        if (mWords[2] != "1.0") fail("version '" + shownText(mWords[2]) + "' is not 1.0");
        if (mWords[1] == "ascii") {
            mHeader.format = PlyFormat::kAscii;
        } else if (mWords[1] == "binary_little_endian") {
            mHeader.format = PlyFormat::kLittleEndian;
        } else if (mWords[1] == "binary_big_endian") {
            mHeader.format = PlyFormat::kBigEndian;
        } else {
            fail("format '" + shownText(mWords[1]) +
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
            fail("the count '" + shownText(mWords[2]) + "' is not a number from 0 to 2^64-1");
        }
        for (const PlyElement& other : mHeader.elements) {
            if (other.name == element.name) fail("element '" + shownText(element.name) + "' is there twice");
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
        for (std::size_t i = 1; i + 1 < mWords.size(); ++i)
            property.declared += (i > 1 ? " " : "") + std::string(mWords[i]);
        mHeader.elements.back().properties.push_back(std::move(property));
    }

    NumberType typeOf(std::string_view name) const
    {
        for (const PlyTypeName& known : kPlyTypeNames) {
            if (name == known.name) return known.type;
        }
        fail("type '" + shownText(name) + "' is unknown");
    }

    const std::string& mPath;
    FileBytes mBytes;
    std::size_t mNext = 0, mLineStart = 0;
    std::vector<std::string_view> mWords;
    PlyHeader mHeader;
};

} // namespace vdb_nns
