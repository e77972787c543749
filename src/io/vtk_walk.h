// What stands before the points of a legacy .vtk file (vtk_reader.cpp says what that is): its head and the
// sections that are walked over. A header of its own for the sake of its length; vtk_reader.cpp is its only
// user.
#pragma once

#include "io/array_readers.h"
#include "io/number_type.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <charconv>
#include <string>
#include <string_view>

namespace vdb_nns {

struct VtkType {
    const char* name;
    NumberType type;
};

// vtkIdType is written as 32 bits, whatever it has in memory. `long` has 64 bits, or 32 where Windows wrote
// it.
constexpr VtkType kVtkTypes[] = {{"float", NumberType::kFloat},
                                 {"double", NumberType::kDouble},
                                 {"int", NumberType::kInt32},
                                 {"unsigned_int", NumberType::kUInt32},
                                 {"short", NumberType::kInt16},
                                 {"unsigned_short", NumberType::kUInt16},
                                 {"char", NumberType::kInt8},
                                 {"signed_char", NumberType::kInt8},
                                 {"unsigned_char", NumberType::kUInt8},
                                 {"long", NumberType::kInt64},
                                 {"unsigned_long", NumberType::kUInt64},
                                 {"vtktypeint64", NumberType::kInt64},
                                 {"vtktypeuint64", NumberType::kUInt64},
                                 {"vtkidtype", NumberType::kInt32}};

inline std::string lowered(std::string_view text)
{
    std::string lower(text);
    for (char& c : lower) c = static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c);
    return lower;
}

// A section's name; no number, of which `nan`, `inf` and `infinity` have letters alone.
inline bool isWord(std::string_view text)
{
    const auto isLetter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; };
    return text.size() >= 4 && text.size() < 40 && std::all_of(text.begin(), text.end(), isLetter) &&
           lowered(text) != "infinity";
}

// The head of the file and the sections before POINTS.
class VtkWalk {
public:
    explicit VtkWalk(const ArrayFile& file)
        : mFile(file), mText(reinterpret_cast<const char*>(file.bytes.data()), file.bytes.size())
    {
    }

    bool isBinary = false;
    std::size_t next = 0;

    void readHead()
    {
        static constexpr std::string_view kMagic = "# vtk DataFile Version ";
        const std::string_view first = line();
        if (first.substr(0, kMagic.size()) != kMagic) {
            throw InputError(
                mFile.path + ": is not a legacy .vtk file: it does not begin with '" + std::string(kMagic) +
                "x.y' but with '" + shownText(first) +
                "'; of VTK's XML formats, take the points with meshio, as docs/formats.md shows");
        }
        const std::string_view version = first.substr(kMagic.size());
        int major = 0;
        const std::from_chars_result read =
            std::from_chars(version.data(), version.data() + version.size(), major);
        if (read.ec != std::errc() || major < 1 || major > 5) {
            failAt(0, "version '" + shownText(version) +
                          "' is not one of 1.0 to 5.1; write the file as version 5.1");
        }
        line(); // the title
        const std::size_t at = next;
        const std::string format = lowered(word());
        if (format != "ascii" && format != "binary")
            failAt(at, "expected ASCII or BINARY, found '" + shownText(format) + "'");
        isBinary = format == "binary";
        readDataset();
    }

    // Number and type of the points; `next` is behind that line.
    std::uint64_t findPoints(std::string& typeName)
    {
        for (;;) {
            mFile.cancel.check();
            const std::size_t at = skipSpaces();
            const std::string section = lowered(word());
            if (section.empty()) failAt(at, "there are no POINTS");
            if (section == "points") {
                const std::uint64_t count = number();
                typeName = lowered(word());
                if (isBinary) endLine();
                return count;
            }
            skipSection(section, at);
        }
    }

    std::string_view wordAt(std::size_t at) const
    {
        const std::size_t end = std::min(mText.find_first_of(" \t\r\n\v\f", at), mText.size());
        return mText.substr(at, end - at);
    }

    std::size_t skipSpacesFrom(std::size_t at) const
    {
        while (at < mText.size() && isTextSpace(mText[at])) ++at;
        return at;
    }

    NumberType typeNamed(const std::string& name, std::size_t at) const
    {
        for (const VtkType& known : kVtkTypes) {
            if (name == known.name) return known.type;
        }
        failAt(at, "type '" + shownText(name) + "' is none of numbers that can be read");
    }

    [[noreturn]] void failAt(std::size_t byte, const std::string& what) const
    {
        throw InputError(mFile.path + ": damaged or unsupported .vtk at byte " + std::to_string(byte) + ": " +
                         what);
    }

private:
    // The rest of the line, and steps behind it.
    std::string_view line()
    {
        const std::size_t end = std::min(mText.find('\n', next), mText.size());
        std::string_view text = mText.substr(next, end - next);
        next = std::min(end + 1, mText.size());
        if (!text.empty() && text.back() == '\r') text.remove_suffix(1);
        return text;
    }

    void endLine()
    {
        const std::size_t at = next;
        const std::string_view rest = line();
        if (rest.find_first_not_of(" \t") != std::string_view::npos)
            failAt(at, "expected the end of a line, found '" + shownText(rest) + "'");
    }

    std::size_t skipSpaces() { return next = skipSpacesFrom(next); }

    std::string_view word()
    {
        const std::string_view text = wordAt(skipSpaces());
        next += text.size();
        return text;
    }

    std::uint64_t number()
    {
        const std::size_t at = skipSpaces();
        const std::string_view text = word();
        std::uint64_t value = 0;
        const std::from_chars_result read = std::from_chars(text.data(), text.data() + text.size(), value);
        if (text.empty() || read.ec != std::errc() || read.ptr != text.data() + text.size())
            failAt(at, "expected a count, found '" + shownText(text) + "'");
        return value;
    }

    void readDataset()
    {
        const std::size_t at = skipSpaces();
        std::string keyword = lowered(word());
        if (keyword == "field")
            failAt(at, "the file holds a FIELD and no data set, so that it has no points");
        if (keyword != "dataset") failAt(at, "expected DATASET, found '" + shownText(keyword) + "'");
        const std::string kind(word());
        const std::string lower = lowered(kind);
        if (lower == "polydata" || lower == "unstructured_grid" || lower == "structured_grid") return;
        const bool isImplicit = lower == "structured_points" || lower == "rectilinear_grid";
        failAt(at, "DATASET " + shownText(kind) +
                       (isImplicit ? " says its points by axes and has none of its own"
                                   : " is none of POLYDATA, UNSTRUCTURED_GRID and STRUCTURED_GRID") +
                       "; save it as POLYDATA (in ParaView: Extract Surface, or Append Datasets)");
    }

    void skipSection(const std::string& section, std::size_t at)
    {
        if (section == "metadata") return skipMetadata();
        if (section == "dimensions") {
            for (int k = 0; k < 3; ++k) number();
            return;
        }
        if (section == "field") return skipField();
        if (section == "cell_types") return skipValues(number(), "int", at);
        const char* const cells[] = {"cells", "vertices", "lines", "polygons", "triangle_strips"};
        if (std::find(std::begin(cells), std::end(cells), section) == std::end(cells)) {
            failAt(at, "expected POINTS or a section that may stand before it, found '" + shownText(section) +
                           "'");
        }
        const std::uint64_t count = number(), size = number();
        const std::size_t after = next;
        if (lowered(word()) != "offsets") { // before version 5
            next = after;
            return skipValues(size, "int", at);
        }
        skipValues(count, lowered(word()), at);
        if (lowered(word()) != "connectivity")
            failAt(at, "a section of cells has OFFSETS but no CONNECTIVITY");
        skipValues(size, lowered(word()), at);
    }

    // Lines up to an empty one.
    void skipMetadata()
    {
        line();
        while (next < mText.size() && line().find_first_not_of(" \t") != std::string_view::npos) {
        }
    }

    void skipField()
    {
        word(); // its name
        for (std::uint64_t arrays = number(); arrays > 0; --arrays) {
            const std::size_t at = skipSpaces();
            std::string name(word());
            while (lowered(name) == "metadata") { // of the array before
                skipMetadata();
                name = word();
            }
            if (name.empty()) failAt(at, "the file ends inside of a FIELD; it is truncated");
            if (name == "NULL_ARRAY") continue;
            const std::uint64_t components = number(), tuples = number();
            if (components > 0 && tuples > mText.size() / components) failTruncated(at);
            skipValues(components * tuples, lowered(word()), at);
        }
    }

    // The rest of the line and then the values.
    void skipValues(std::uint64_t count, const std::string& typeName, std::size_t at)
    {
        const bool isString = typeName == "string" || typeName == "utf8_string";
        if (typeName == "variant") failAt(at, "an array of type variant stands before POINTS; remove it");
        if (!isString && typeName != "bit") typeNamed(typeName, at);
        if (isBinary || isString) endLine();
        if (isString) return skipStrings(count, at);
        if (isBinary) {
            const bool isBit = typeName == "bit";
            const std::uint64_t each = isBit ? 1 : sizeOf(typeNamed(typeName, at));
            const std::uint64_t values = isBit ? count / 8 + (count % 8 != 0) : count;
            if (values > (mText.size() - next) / each) failTruncated(at);
            next += static_cast<std::size_t>(values * each);
            return;
        }
        for (; count > 0; --count) {
            if (word().empty()) failTruncated(at);
        }
    }

    // Text: a line each. Binary: the two upper bits of the first byte say how many bytes the length has.
    void skipStrings(std::uint64_t count, std::size_t at)
    {
        for (; count > 0; --count) {
            if (next == mText.size()) failTruncated(at);
            if (!isBinary) {
                line();
                continue;
            }
            const unsigned first = static_cast<unsigned char>(mText[next]);
            const std::size_t lengthBytes = std::size_t(8) >> (first >> 6);
            if (lengthBytes > mText.size() - next) failTruncated(at);
            std::uint64_t length = first & 0x3F;
            for (std::size_t i = 1; i < lengthBytes; ++i)
                length = length << 8 | static_cast<unsigned char>(mText[next + i]);
            next += lengthBytes;
            if (length > mText.size() - next) failTruncated(at);
            next += static_cast<std::size_t>(length);
        }
    }

    [[noreturn]] void failTruncated(std::size_t at) const
    {
        failAt(at, "the values of this section go beyond the end of the file; it is truncated");
    }

    const ArrayFile& mFile;
    std::string_view mText;
};

} // namespace vdb_nns
