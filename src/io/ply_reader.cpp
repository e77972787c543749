// The .ply reader. A header names elements and their properties; the rows follow as text or as packed binary
// values.
#include "io/ply_header.h"

#include <cstdlib>

namespace vdb_nns {

namespace {

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
            if (found != vertex.properties.size())
                throw InputError(path + ": .ply property '" + name + "' is there twice");
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

// Asks whether to stop, once in many values.
class ValueCounter {
public:
    explicit ValueCounter(const CancelCheck& cancel) : mCancel(cancel) {}

    void count()
    {
        if (++mValues % kValuesBetween == 0) mCancel.check();
    }

private:
    static constexpr std::uint64_t kValuesBetween = std::uint64_t(1) << 16;

    const CancelCheck& mCancel;
    std::uint64_t mValues = 0;
};

// Values of a text body, one after the other; where lines end does not matter.
class TextValues {
public:
    TextValues(const std::string& path, FileBytes bytes, std::size_t next, const CancelCheck& cancel)
        : mPath(path), mBytes(bytes), mNext(next), mCounter(cancel)
    {
    }

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
        mCounter.count();
        while (mNext < mBytes.size() && isSpace(mBytes[mNext])) ++mNext;
        mTokenStart = mNext;
        while (mNext < mBytes.size() && !isSpace(mBytes[mNext])) ++mNext;
        if (mTokenStart == mNext)
            fail("the file ends before the rows that its header promises; it is truncated");
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
            if (nearest > 1 || nearest < -1)
                fail("'" + std::string(text.substr(0, 40)) + "' is beyond its type's range");
            value = static_cast<Real>(nearest);
        }
        return value;
    }

    const std::string& mPath;
    FileBytes mBytes;
    std::size_t mNext, mTokenStart = 0;
    ValueCounter mCounter;
};

// Values of a binary body.
class BinaryValues {
public:
    BinaryValues(const std::string& path, FileBytes bytes, std::size_t next, bool isBigEndian,
                 const CancelCheck& cancel)
        : mPath(path), mBytes(bytes), mNext(next), mIsBigEndian(isBigEndian), mCounter(cancel)
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
        if (isSigned && value >> (8 * sizeOf(type) - 1))
            failAt(mPath, start, "the length of a list is negative");
        return value;
    }

    void skipList(PlyType type, std::uint64_t length) { skipBytes(length * sizeOf(type)); } // length < 2^32

    void skipBytes(std::uint64_t count)
    {
        mCounter.count();
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
    ValueCounter mCounter;
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
void readVertices(Values& values, const PlyElement& vertex, const VertexLayout& layout,
                  std::vector<Real>& out)
{
    // Which coordinate a property is; 3 for none.
    std::vector<int> coordinate(vertex.properties.size(), 3);
    for (int k = 0; k < 3; ++k) coordinate[layout.property[k]] = k;

    out.reserve(static_cast<std::size_t>(vertex.count) * 3);
    for (std::uint64_t row = 0; row < vertex.count; ++row) {
        Real position[3]{};
        for (std::size_t i = 0; i < coordinate.size(); ++i) {
            if (coordinate[i] < 3) {
                position[coordinate[i]] = values.template real<Real>(vertex.properties[i].type);
            } else {
                skipProperty(values, vertex.properties[i]);
            }
        }
        for (const Real value : position) out.push_back(value);
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
        values.skipBytes(element.count *
                         element.minRowBytes(PlyFormat::kLittleEndian)); // held against the size before
        return;
    }
    for (std::uint64_t row = 0; row < element.count; ++row) {
        for (const PlyProperty& property : element.properties) skipProperty(values, property);
    }
}

template <typename Values>
PositionArray readBody(Values& values, const PlyHeader& header, const PlyElement& vertex,
                       const VertexLayout& layout)
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

// No count may promise more rows than the file has room for, so that no later product or allocation can be
// too large.
void checkCounts(const std::string& path, const PlyHeader& header, std::size_t fileBytes)
{
    // The last value of a text needs no separator behind it.
    std::uint64_t left = fileBytes - header.bytes + (header.format == PlyFormat::kAscii ? 1 : 0);
    for (const PlyElement& element : header.elements) {
        const std::uint64_t rowBytes = element.minRowBytes(header.format);
        if (rowBytes == 0) continue;
        if (element.count > left / rowBytes) {
            throw InputError(path + ": the .ply header promises " + std::to_string(element.count) +
                             " of element '" + element.name.substr(0, 40) + "' with at least " +
                             std::to_string(rowBytes) + " bytes each, but the file has only " +
                             std::to_string(left) +
                             " bytes for them; it is truncated or its header is wrong");
        }
        left -= element.count * rowBytes;
    }
}

} // namespace

ReadArray parsePly(const ArrayFile& file)
{
    const std::string& path = file.path;
    const FileBytes bytes = file.bytes;
    const CancelCheck& cancel = file.cancel;
    const PlyHeader header = PlyHeaderReader(path, bytes).read();
    checkCounts(path, header, bytes.size());
    const auto vertex = std::find_if(header.elements.begin(), header.elements.end(),
                                     [](const PlyElement& element) { return element.name == "vertex"; });
    if (vertex == header.elements.end()) throw InputError(path + ": the .ply file has no element 'vertex'");
    const VertexLayout layout = findPosition(path, *vertex);
    if (vertex->count > kMaxFilePoints) {
        throw InputError(path + ": " + std::to_string(vertex->count) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    checkPointsFit(path, vertex->count * 3 * (layout.isDouble ? sizeof(double) : sizeof(float)),
                   file.allowedBytes);
    if (header.format == PlyFormat::kAscii) {
        TextValues values(path, bytes, header.bytes, cancel);
        return {readBody(values, header, *vertex, layout), {}, {}};
    }
    BinaryValues values(path, bytes, header.bytes, header.format == PlyFormat::kBigEndian, cancel);
    return {readBody(values, header, *vertex, layout), {}, {}};
}

} // namespace vdb_nns
