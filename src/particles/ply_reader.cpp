// The .ply reader. A header names elements and their properties; the rows follow as text or as packed binary values.
#include "particles/array_readers.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <string_view>

namespace vdb_nns {

namespace {

enum class PlyFormat { kAscii, kLittleEndian, kBigEndian };

enum class PlyType { kInt8, kUInt8, kInt16, kUInt16, kInt32, kUInt32, kFloat, kDouble };

struct PlyTypeName {
    const char* name;
    PlyType type;
};

// The names of the first description and those that came into use later.
constexpr PlyTypeName kTypeNames[] = {
    {"char", PlyType::kInt8},     {"int8", PlyType::kInt8},     {"uchar", PlyType::kUInt8},
    {"uint8", PlyType::kUInt8},   {"short", PlyType::kInt16},   {"int16", PlyType::kInt16},
    {"ushort", PlyType::kUInt16}, {"uint16", PlyType::kUInt16}, {"int", PlyType::kInt32},
    {"int32", PlyType::kInt32},   {"uint", PlyType::kUInt32},   {"uint32", PlyType::kUInt32},
    {"float", PlyType::kFloat},   {"float32", PlyType::kFloat}, {"double", PlyType::kDouble},
    {"float64", PlyType::kDouble}};

std::size_t sizeOf(PlyType type)
{
    switch (type) {
    case PlyType::kInt8:
    case PlyType::kUInt8: return 1;
    case PlyType::kInt16:
    case PlyType::kUInt16: return 2;
    case PlyType::kDouble: return 8;
    default: return 4;
    }
}

bool isReal(PlyType type)
{
    return type == PlyType::kFloat || type == PlyType::kDouble;
}

struct PlyProperty {
    std::string name;
    PlyType type;      // of the value, or of a list's values
    bool isList = false;
    PlyType countType = PlyType::kUInt8; // of a list's length
};

struct PlyElement {
    std::string name;
    std::uint64_t count = 0;
    std::vector<PlyProperty> properties;

    // The least that a row can take in the file: lists may be empty; text has a digit and a separator a value.
    std::uint64_t minRowBytes(PlyFormat format) const
    {
        std::uint64_t bytes = 0;
        for (const PlyProperty& property : properties) {
            bytes += format == PlyFormat::kAscii ? 2 : sizeOf(property.isList ? property.countType : property.type);
        }
        return bytes;
    }

    bool hasLists() const
    {
        return std::any_of(properties.begin(), properties.end(), [](const PlyProperty& p) { return p.isList; });
    }
};

struct PlyHeader {
    PlyFormat format = PlyFormat::kAscii;
    std::vector<PlyElement> elements;
    std::size_t bytes = 0; // of the header
};

[[noreturn]] void failAt(const std::string& path, std::size_t byte, const std::string& what)
{
    throw InputError(path + ": damaged or unsupported .ply at byte " + std::to_string(byte) + ": " + what);
}

// ------------------------------------------------------------------------------------------------ header

class HeaderReader {
public:
    HeaderReader(const std::string& path, FileBytes bytes) : mPath(path), mBytes(bytes) {}

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
            if (other.name == element.name) fail("element '" + element.name.substr(0, 40) + "' is there twice");
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
        for (const PlyTypeName& known : kTypeNames) {
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

// Which properties of `vertex` are x, y and z.
struct VertexLayout {
    std::size_t property[3];
    bool isDouble; // any of the three
};

VertexLayout findPosition(const std::string& path, const PlyElement& vertex)
{
    VertexLayout layout{{0, 0, 0}, false};
    for (int k = 0; k < 3; ++k) {
        const std::string name(1, "xyz"[k]);
        std::size_t found = vertex.properties.size();
        for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
            if (vertex.properties[i].name != name) continue;
            if (found != vertex.properties.size()) throw InputError(path + ": .ply property '" + name + "' is there twice");
            found = i;
        }
        if (found == vertex.properties.size()) {
            throw InputError(path + ": the .ply element 'vertex' has no property '" + name + "'");
        }
        const PlyProperty& property = vertex.properties[found];
        if (property.isList || !isReal(property.type)) {
            throw InputError(path + ": .ply property '" + name + "' is neither float nor double; convert it");
        }
        layout.property[k] = found;
        layout.isDouble = layout.isDouble || property.type == PlyType::kDouble;
    }
    return layout;
}

// ------------------------------------------------------------------------------------------------ rows

// Values of a text body, one after the other; where lines end does not matter.
class TextValues {
public:
    TextValues(const std::string& path, FileBytes bytes, std::size_t next) : mPath(path), mBytes(bytes), mNext(next) {}

    std::size_t byte() const { return mNext; }

    template <typename Real>
    Real real(PlyType type)
    {
        if (type == PlyType::kFloat) return static_cast<Real>(number<float>());
        return static_cast<Real>(number<double>());
    }

    void skip(PlyType) { token(); }

    std::uint64_t length(PlyType)
    {
        const std::string_view text = token();
        std::uint64_t value = 0;
        const std::from_chars_result result = std::from_chars(text.data(), text.data() + text.size(), value);
        if (result.ec != std::errc() || result.ptr != text.data() + text.size()) {
            fail("the length of a list is '" + std::string(text.substr(0, 40)) + "'");
        }
        return value;
    }

    void skipList(PlyType type, std::uint64_t length)
    {
        while (length-- > 0) skip(type); // token() ends it at the end of the file
    }

private:
    [[noreturn]] void fail(const std::string& what) const { failAt(mPath, mTokenStart, what); }

    static bool isSpace(unsigned char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

    std::string_view token()
    {
        while (mNext < mBytes.size() && isSpace(mBytes[mNext])) ++mNext;
        mTokenStart = mNext;
        while (mNext < mBytes.size() && !isSpace(mBytes[mNext])) ++mNext;
        if (mTokenStart == mNext) fail("the file ends before the rows that its header promises; it is truncated");
        return {reinterpret_cast<const char*>(mBytes.data()) + mTokenStart, mNext - mTokenStart};
    }

    template <typename Real>
    Real number()
    {
        std::string_view text = token();
        if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
        Real value = 0;
        const char* const last = text.data() + text.size();
        const std::from_chars_result result = std::from_chars(text.data(), last, value);
        if (result.ptr != last || result.ec == std::errc::invalid_argument) {
            fail("'" + std::string(text.substr(0, 40)) + "' is not a number");
        }
        if (result.ec == std::errc::result_out_of_range) { // too small is rounded, too large is refused
            const double nearest = std::strtod(std::string(text).c_str(), nullptr);
            if (nearest > 1 || nearest < -1) fail("'" + std::string(text.substr(0, 40)) + "' is beyond its type's range");
            value = static_cast<Real>(nearest);
        }
        return value;
    }

    const std::string& mPath;
    FileBytes mBytes;
    std::size_t mNext, mTokenStart = 0;
};

// Values of a binary body.
class BinaryValues {
public:
    BinaryValues(const std::string& path, FileBytes bytes, std::size_t next, bool isBigEndian)
        : mPath(path), mBytes(bytes), mNext(next), mIsBigEndian(isBigEndian)
    {
    }

    std::size_t byte() const { return mNext; }

    template <typename Real>
    Real real(PlyType type)
    {
        const std::uint64_t bits = unsignedValue(sizeOf(type));
        if (type == PlyType::kDouble) {
            double value;
            std::memcpy(&value, &bits, sizeof value);
            return static_cast<Real>(value);
        }
        const std::uint32_t low = static_cast<std::uint32_t>(bits);
        float value;
        std::memcpy(&value, &low, sizeof value);
        return static_cast<Real>(value);
    }

    void skip(PlyType type) { skipBytes(sizeOf(type)); }

    std::uint64_t length(PlyType type)
    {
        const std::size_t start = mNext;
        const std::uint64_t value = unsignedValue(sizeOf(type));
        const bool isSigned = type == PlyType::kInt8 || type == PlyType::kInt16 || type == PlyType::kInt32;
        if (isSigned && value >> (8 * sizeOf(type) - 1)) failAt(mPath, start, "the length of a list is negative");
        return value;
    }

    void skipList(PlyType type, std::uint64_t length) { skipBytes(length * sizeOf(type)); } // length < 2^32

    void skipBytes(std::uint64_t count)
    {
        if (count > mBytes.size() - mNext) {
            failAt(mPath, mNext, "the file ends before the rows that its header promises; it is truncated");
        }
        mNext += static_cast<std::size_t>(count);
    }

private:
    std::uint64_t unsignedValue(std::size_t count)
    {
        const unsigned char* const first = mBytes.data() + mNext;
        skipBytes(count);
        std::uint64_t value = 0;
        for (std::size_t i = 0; i < count; ++i) {
            value |= std::uint64_t(first[mIsBigEndian ? count - 1 - i : i]) << (8 * i);
        }
        return value;
    }

    const std::string& mPath;
    FileBytes mBytes;
    std::size_t mNext;
    bool mIsBigEndian;
};

// ------------------------------------------------------------------------------------------------ body

template <typename Values>
void skipProperty(Values& values, const PlyProperty& property)
{
    if (property.isList) {
        values.skipList(property.type, values.length(property.countType));
    } else {
        values.skip(property.type);
    }
}

template <typename Real, typename Values>
void readVertices(Values& values, const PlyElement& vertex, const VertexLayout& layout, std::vector<Real>& out)
{
    // Which coordinate a property is; 3 for none.
    std::vector<int> coordinate(vertex.properties.size(), 3);
    for (int k = 0; k < 3; ++k) coordinate[layout.property[k]] = k;

    out.resize(static_cast<std::size_t>(vertex.count) * 3);
    for (Real* row = out.data(); row != out.data() + out.size(); row += 3) {
        for (std::size_t i = 0; i < coordinate.size(); ++i) {
            if (coordinate[i] < 3) {
                row[coordinate[i]] = values.template real<Real>(vertex.properties[i].type);
            } else {
                skipProperty(values, vertex.properties[i]);
            }
        }
    }
}

void skipElement(TextValues& values, const PlyElement& element)
{
    if (element.properties.empty()) return;
    for (std::uint64_t row = 0; row < element.count; ++row) {
        for (const PlyProperty& property : element.properties) skipProperty(values, property);
    }
}

void skipElement(BinaryValues& values, const PlyElement& element)
{
    if (!element.hasLists()) {
        values.skipBytes(element.count * element.minRowBytes(PlyFormat::kLittleEndian)); // held against the size before
        return;
    }
    for (std::uint64_t row = 0; row < element.count; ++row) {
        for (const PlyProperty& property : element.properties) skipProperty(values, property);
    }
}

template <typename Values>
PositionArray readBody(Values& values, const PlyHeader& header, const PlyElement& vertex, const VertexLayout& layout)
{
    PositionArray result;
    for (const PlyElement& element : header.elements) {
        if (&element != &vertex) {
            skipElement(values, element);
        } else if (layout.isDouble) {
            readVertices(values, element, layout, result.doubles);
        } else {
            readVertices(values, element, layout, result.floats);
        }
    }
    return result;
}

// No count may promise more rows than the file has room for, so that no later product or allocation can be too large.
void checkCounts(const std::string& path, const PlyHeader& header, std::size_t fileBytes)
{
    // The last value of a text needs no separator behind it.
    std::uint64_t left = fileBytes - header.bytes + (header.format == PlyFormat::kAscii ? 1 : 0);
    for (const PlyElement& element : header.elements) {
        const std::uint64_t rowBytes = element.minRowBytes(header.format);
        if (rowBytes == 0) continue;
        if (element.count > left / rowBytes) {
            throw InputError(path + ": the .ply header promises " + std::to_string(element.count) + " of element '" +
                             element.name.substr(0, 40) + "' with at least " + std::to_string(rowBytes) +
                             " bytes each, but the file has only " + std::to_string(left) +
                             " bytes for them; it is truncated or its header is wrong");
        }
        left -= element.count * rowBytes;
    }
}

} // namespace

PositionArray parsePly(const std::string& path, FileBytes bytes)
{
    const PlyHeader header = HeaderReader(path, bytes).read();
    checkCounts(path, header, bytes.size());
    const auto vertex = std::find_if(header.elements.begin(), header.elements.end(),
                                     [](const PlyElement& element) { return element.name == "vertex"; });
    if (vertex == header.elements.end()) throw InputError(path + ": the .ply file has no element 'vertex'");
    const VertexLayout layout = findPosition(path, *vertex);
    if (vertex->count > kMaxFilePoints) {
        throw InputError(path + ": " + std::to_string(vertex->count) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    if (header.format == PlyFormat::kAscii) {
        TextValues values(path, bytes, header.bytes);
        return readBody(values, header, *vertex, layout);
    }
    BinaryValues values(path, bytes, header.bytes, header.format == PlyFormat::kBigEndian);
    return readBody(values, header, *vertex, layout);
}

} // namespace vdb_nns
