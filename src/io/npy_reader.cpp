// The .npy reader: a header, which is the text of a Python dictionary, and raw values behind it.
#include "io/array_readers.h"

#include "vdb_nns/error.h"

#include <charconv>
#include <cstring>
#include <optional>

namespace vdb_nns {

namespace {

// NumPy itself reads headers up to 10 000 bytes unless told otherwise; a plain array's has about 70.
constexpr std::uint64_t kMaxHeaderBytes = 65536;

// What the three keys of a header say.
struct Header {
    std::string descr;
    bool fortranOrder = false;
    std::vector<std::uint64_t> shape;
};

// A reader of the one Python literal that a header may hold: {'descr': '<f4', 'fortran_order': False,
// 'shape': (4, 3), }
class HeaderParser {
public:
    HeaderParser(const std::string& path, FileBytes text, std::size_t fileOffset)
        : mPath(path), mText(text), mFileOffset(fileOffset)
    {
    }

    Header parse()
    {
        Header header;
        bool hasDescr = false, hasOrder = false, hasShape = false;
        expect('{');
        while (!accept('}')) {
            const std::string key = string();
            expect(':');
            if (key == "descr" && !hasDescr) {
                hasDescr = true;
                header.descr = descr();
            } else if (key == "fortran_order" && !hasOrder) {
                hasOrder = true;
                header.fortranOrder = boolean();
            } else if (key == "shape" && !hasShape) {
                hasShape = true;
                header.shape = tuple();
            } else {
                fail("key '" + key + "' is unknown or there twice");
            }
            if (!accept(',')) {
                expect('}');
                break;
            }
        }
        if (peek()) fail("something stands behind the dictionary");
        if (!hasDescr || !hasOrder || !hasShape) fail("'descr', 'fortran_order' or 'shape' is missing");
        return header;
    }

private:
    [[noreturn]] void fail(const std::string& what) const
    {
        throw InputError(mPath + ": damaged .npy header at byte " + std::to_string(mFileOffset + mNext) +
                         ": " + what + "; write the file again with numpy.save");
    }

    // The next character that is no white space; nothing at the end.
    std::optional<char> peek()
    {
        while (mNext < mText.size() && std::strchr(" \t\r\n", mText[mNext]) && mText[mNext] != 0) ++mNext;
        if (mNext == mText.size()) return std::nullopt;
        return static_cast<char>(mText[mNext]);
    }

    bool accept(char wanted)
    {
        if (peek() != wanted) return false;
        ++mNext;
        return true;
    }

    void expect(char wanted)
    {
        if (!accept(wanted)) fail(std::string("expected '") + wanted + "'");
    }

    std::string string()
    {
        const std::optional<char> quote = peek();
        if (quote != '\'' && quote != '"') fail("expected a string");
        std::string text;
        for (++mNext; mNext < mText.size(); ++mNext) {
            if (static_cast<char>(mText[mNext]) == *quote) {
                ++mNext;
                return text;
            }
            text += static_cast<char>(mText[mNext]);
        }
        fail("a string has no end");
    }

    std::string descr()
    {
        if (peek() == '[') {
            throw InputError(mPath +
                             ": the .npy file holds structured records; save the positions alone, as an " +
                             "array of shape (N, 3) and dtype float32 or float64");
        }
        return string();
    }

    bool boolean()
    {
        peek();
        for (const char* word : {"True", "False"}) {
            const std::size_t length = std::strlen(word);
            if (mText.size() - mNext >= length && std::memcmp(mText.data() + mNext, word, length) == 0) {
                mNext += length;
                return word[0] == 'T';
            }
        }
        fail("expected True or False");
    }

    std::vector<std::uint64_t> tuple()
    {
        std::vector<std::uint64_t> values;
        expect('(');
        while (!accept(')')) {
            peek();
            const char* const first = reinterpret_cast<const char*>(mText.data()) + mNext;
            const char* const last = reinterpret_cast<const char*>(mText.data()) + mText.size();
            std::uint64_t value = 0;
            const std::from_chars_result result = std::from_chars(first, last, value);
            if (result.ec != std::errc()) fail("expected a size from 0 to 2^64-1");
            mNext += static_cast<std::size_t>(result.ptr - first);
            values.push_back(value);
            if (!accept(',')) {
                expect(')');
                break;
            }
        }
        return values;
    }

    const std::string& mPath;
    FileBytes mText;
    std::size_t mFileOffset; // of the text
    std::size_t mNext = 0;
};

std::string shapeText(const std::vector<std::uint64_t>& shape)
{
    std::string text = "(";
    for (std::size_t i = 0; i < shape.size(); ++i) text += (i ? ", " : "") + std::to_string(shape[i]);
    return text + (shape.size() == 1 ? ",)" : ")");
}

// Finds the header's text and returns it; `dataOffset` is what follows.
FileBytes headerText(const std::string& path, FileBytes bytes, std::size_t& dataOffset)
{
    static const unsigned char kMagic[6] = {0x93, 'N', 'U', 'M', 'P', 'Y'};
    if (bytes.size() < 10 || std::memcmp(bytes.data(), kMagic, sizeof kMagic) != 0) {
        throw InputError(path + ": is not an .npy file: it does not begin with \\x93NUMPY and a header (" +
                         std::to_string(bytes.size()) + " bytes in all); write it with numpy.save");
    }
    const unsigned major = bytes[6];
    if (major < 1 || major > 3) {
        throw InputError(path + ": .npy version " + std::to_string(major) +
                         " at byte 6 is not supported (1 to 3 are)");
    }
    const std::size_t lengthBytes = major == 1 ? 2 : 4;
    const std::size_t start = 8 + lengthBytes;
    std::uint64_t length = 0;
    for (std::size_t i = lengthBytes; i-- > 0;) {
        length = length << 8 | (8 + i < bytes.size() ? bytes[8 + i] : 0u);
    }
    if (bytes.size() < start || length > bytes.size() - start || length > kMaxHeaderBytes) {
        throw InputError(path + ": the .npy header at byte 8 claims " + std::to_string(length) +
                         " bytes, but the file has " + std::to_string(bytes.size()) +
                         " and a header may have " + std::to_string(kMaxHeaderBytes) +
                         "; the file is truncated or damaged");
    }
    dataOffset = start + static_cast<std::size_t>(length);
    return {bytes.data() + start, static_cast<std::size_t>(length)};
}

} // namespace

bool parseNpy(const ArrayFile& file, NpyLayout& layout, ReadArray&)
{
    const std::string& path = file.path;
    const FileBytes bytes = file.bytes;
    const FileBytes text = headerText(path, bytes, layout.dataOffset);
    const Header header = HeaderParser(path, text, layout.dataOffset - text.size()).parse();

    if (header.descr != "<f4" && header.descr != "<f8") {
        throw InputError(path + ": .npy dtype '" + header.descr +
                         "' is not supported; convert to little-endian float32 " +
                         "('<f4') or float64 ('<f8')");
    }
    if (header.fortranOrder) {
        throw InputError(path +
                         ": the .npy array is in Fortran order; save numpy.ascontiguousarray(positions)");
    }
    if (header.shape.size() != 2 || header.shape[1] != 3) {
        throw InputError(path + ": .npy shape " + shapeText(header.shape) + " is not (N, 3)");
    }
    layout.isDouble = header.descr == "<f8";
    const std::uint64_t pointBytes = layout.isDouble ? 24 : 12;
    const std::uint64_t available = bytes.size() - layout.dataOffset;
    const std::uint64_t count = header.shape[0];
    if (count > available / pointBytes) {
        throw InputError(path + ": truncated: the .npy header promises " + std::to_string(count) +
                         " points of " + std::to_string(pointBytes) + " bytes, but only " +
                         std::to_string(available) + " bytes follow from byte " +
                         std::to_string(layout.dataOffset) + "; copy the file again");
    }
    if (count * pointBytes != available) {
        throw InputError(path + ": " + std::to_string(available - count * pointBytes) +
                         " bytes too many behind the " + std::to_string(count) +
                         " points of the .npy header, from byte " +
                         std::to_string(layout.dataOffset + count * pointBytes) + "; write the file again");
    }
    if (count > kMaxFilePoints) {
        throw InputError(path + ": " + std::to_string(count) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    layout.count = static_cast<std::size_t>(count);
    return true;
}

} // namespace vdb_nns
