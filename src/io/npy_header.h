// The header of an .npy file: the text of a Python dictionary.
#pragma once

#include "io/array_readers.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <charconv>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

namespace vdb_nns {

// NumPy itself reads headers up to 10 000 bytes unless told otherwise; a plain array's has about 70.
constexpr std::uint64_t kMaxNpyHeaderBytes = 65536;

// A dtype of NumPy: byte order ('<', '>', '|' or '='), kind ('f', 'i', 'u', ...) and bytes.
struct NpyType {
    char order = '|', kind = 'V';
    std::uint64_t bytes = 0;

    bool isBigEndian() const { return order == '>'; }
    bool isFloat() const { return kind == 'f' && (bytes == 2 || bytes == 4 || bytes == 8); }
    bool isInteger() const
    {
        return (kind == 'i' || kind == 'u') && (bytes == 1 || bytes == 2 || bytes == 4 || bytes == 8);
    }
    bool isNumber() const { return isFloat() || isInteger(); }
};

struct NpyField {
    std::string name, descr; // descr: as it stands there
    NpyType type;
    std::uint64_t offset = 0; // in a record
    bool isArray = false;     // has a shape of its own
};

struct NpyHeader {
    std::string descr; // of values that are no records
    NpyType type;
    std::vector<NpyField> fields; // of records
    std::uint64_t itemBytes = 0;
    bool fortranOrder = false;
    std::vector<std::uint64_t> shape;
    std::size_t dataOffset = 0; // bytes from the start of the file

    bool isStructured() const { return !fields.empty(); }
};

// A reader of the one Python literal that a header may hold: {'descr': '<f4', 'fortran_order': False,
// 'shape': (4, 3), }
class NpyHeaderParser {
public:
    NpyHeaderParser(const std::string& path, FileBytes text, std::size_t fileOffset)
        : mPath(path), mText(text), mFileOffset(fileOffset)
    {
    }

    NpyHeader parse()
    {
        bool hasDescr = false, hasOrder = false, hasShape = false;
        expect('{');
        while (!accept('}')) {
            const std::string key = string();
            expect(':');
            if (key == "descr" && !hasDescr) {
                hasDescr = true;
                readDescr();
            } else if (key == "fortran_order" && !hasOrder) {
                hasOrder = true;
                mHeader.fortranOrder = boolean();
            } else if (key == "shape" && !hasShape) {
                hasShape = true;
                mHeader.shape = tuple();
            } else {
                fail("key '" + shownText(key) + "' is unknown or there twice");
            }
            if (!accept(',')) {
                expect('}');
                break;
            }
        }
        if (peek()) fail("something stands behind the dictionary");
        if (!hasDescr || !hasOrder || !hasShape) fail("'descr', 'fortran_order' or 'shape' is missing");
        return std::move(mHeader);
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

    // "<f4": order, kind, bytes. The text of another type, a date's say, is kept as the kind V.
    static NpyType typeOf(const std::string& descr)
    {
        NpyType type;
        if (descr.size() < 3) return type;
        std::uint64_t bytes = 0;
        const char* const last = descr.data() + descr.size();
        const std::from_chars_result result = std::from_chars(descr.data() + 2, last, bytes);
        if (result.ec != std::errc() || result.ptr != last) return type;
        return {descr[0], descr[1], bytes};
    }

    void readDescr()
    {
        if (peek() != '[') {
            mHeader.descr = string();
            mHeader.type = typeOf(mHeader.descr);
            mHeader.itemBytes = mHeader.type.bytes;
            return;
        }
        expect('[');
        while (!accept(']')) {
            readField();
            if (!accept(',')) {
                expect(']');
                break;
            }
        }
        if (mHeader.fields.empty()) fail("records without fields");
    }

    // ('name', '<f4'), ('name', '<f4', (3,)) or (('title', 'name'), '<f4').
    void readField()
    {
        NpyField field;
        expect('(');
        if (accept('(')) {
            string();
            expect(',');
            field.name = string();
            expect(')');
        } else {
            field.name = string();
        }
        expect(',');
        if (peek() == '[') fail("fields inside of fields are not read");
        field.descr = string();
        field.type = typeOf(field.descr);
        field.offset = mHeader.itemBytes;
        std::uint64_t bytes = field.type.bytes;
        if (accept(',') && peek() == '(') {
            field.isArray = true;
            for (const std::uint64_t count : tuple()) {
                if (count > 0 && bytes > kMostItemBytes / count) fail("a field is too large");
                bytes *= count;
            }
        }
        expect(')');
        if (bytes > kMostItemBytes - mHeader.itemBytes) fail("a record is too large");
        mHeader.itemBytes += bytes;
        mHeader.fields.push_back(std::move(field));
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

    static constexpr std::uint64_t kMostItemBytes = std::uint64_t(1) << 31;

    const std::string& mPath;
    FileBytes mText;
    std::size_t mFileOffset; // of the text
    std::size_t mNext = 0;
    NpyHeader mHeader;
};

// Of the bytes of a file or of its beginning. Throws InputError.
NpyHeader readNpyHeader(const std::string& path, FileBytes bytes);

// Throws InputError unless so many bytes are the values that the header declares, to the byte.
void checkNpySize(const std::string& path, const NpyHeader& header, std::uint64_t available);

// "(4, 3)", as Python writes it.
std::string npyShapeText(const std::vector<std::uint64_t>& shape);

} // namespace vdb_nns
