// VTK's legacy format ("VTK File Formats", Simple Legacy Formats): a line with the version, a title, ASCII or
// BINARY, and sections that begin with a keyword. Positions are the section POINTS. Binary numbers are
// big-endian and begin behind the line of their keyword.
#include "file_numbers.h"
#include "point_formats.h"

#include <algorithm>
#include <cctype>
#include <sstream>

namespace vdb_nns::cli {

namespace {

class VtkFile {
public:
    explicit VtkFile(const PointInput& input) : mInput(input), mBytes(input.bytes()) {}

    Positions read()
    {
        if (upper(nextLine().substr(0, 22)) != "# VTK DATAFILE VERSION") fail("is no legacy .vtk file");
        nextLine(); // the title
        const std::string format = nextWord();
        mIsText = format == "ASCII";
        if (!mIsText && format != "BINARY") fail("is a .vtk file that is neither ASCII nor BINARY");
        for (std::string keyword = nextWord(); keyword != "POINTS"; keyword = nextWord())
            skipSection(keyword);
        return readPoints();
    }

private:
    static constexpr std::uint64_t kMostComponents = 1 << 16; // times any number of tuples fits 64 bits

    [[noreturn]] void fail(const std::string& what) const { mInput.fail(what); }

    static std::string upper(std::string text)
    {
        for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
        return text;
    }

    std::string nextLine()
    {
        if (mAt >= mBytes.size()) fail("is a .vtk file that ends before its points");
        const std::size_t end = std::min(mBytes.find('\n', mAt), mBytes.size());
        std::string line = mBytes.substr(mAt, end - mAt);
        if (!line.empty() && line.back() == '\r') line.pop_back();
        mAt = end + 1;
        return line;
    }

    // Empty at the end of the file.
    std::string peekWord()
    {
        while (mAt < mBytes.size() && std::isspace(static_cast<unsigned char>(mBytes[mAt]))) ++mAt;
        std::size_t end = mAt;
        while (end < mBytes.size() && !std::isspace(static_cast<unsigned char>(mBytes[end]))) ++end;
        return mAt < mBytes.size() ? mBytes.substr(mAt, end - mAt) : std::string();
    }

    std::string nextRawWord()
    {
        std::string word = peekWord();
        if (word.empty()) fail("is a .vtk file that ends before its points do");
        mAt += word.size();
        return word;
    }

    std::string nextWord() { return upper(nextRawWord()); }

    std::uint64_t nextCount()
    {
        const std::string word = nextWord();
        if (word.size() > 10 || word.find_first_not_of("0123456789") != std::string::npos)
            fail("has a .vtk section with the number '" + word + "', which is none");
        return std::stoull(word);
    }

    NumberType typeOf(const std::string& name) const
    {
        const struct {
            const char* name;
            NumberType type;
        } kTypes[] = {{"FLOAT", {'f', 4}},          {"DOUBLE", {'f', 8}},        {"CHAR", {'i', 1}},
                      {"SIGNED_CHAR", {'i', 1}},    {"UNSIGNED_CHAR", {'u', 1}}, {"SHORT", {'i', 2}},
                      {"UNSIGNED_SHORT", {'u', 2}}, {"INT", {'i', 4}},           {"UNSIGNED_INT", {'u', 4}},
                      {"LONG", {'i', 8}},           {"UNSIGNED_LONG", {'u', 8}}, {"VTKIDTYPE", {'i', 4}},
                      {"VTKTYPEINT64", {'i', 8}},   {"VTKTYPEUINT64", {'u', 8}}};
        for (const auto& known : kTypes) {
            if (name == known.name) return known.type;
        }
        fail("has values of the .vtk type '" + name + "', which is not read");
    }

    void skipSection(const std::string& keyword)
    {
        if (keyword == "DATASET") {
            const std::string kind = nextWord();
            if (kind != "POLYDATA" && kind != "UNSTRUCTURED_GRID" && kind != "STRUCTURED_GRID")
                fail("is a .vtk file of the kind " + kind + ", which has no points");
        } else if (keyword == "DIMENSIONS") {
            for (int k = 0; k < 3; ++k) nextCount();
        } else if (keyword == "METADATA") {
            skipMetadata();
        } else if (keyword == "FIELD") {
            nextRawWord(); // its name
            for (std::uint64_t left = nextCount(); left > 0; --left) skipArray();
        } else {
            fail("has the .vtk section '" + keyword + "' before its points, which is not understood");
        }
    }

    // Ends with a blank line.
    void skipMetadata()
    {
        nextLine();
        while (mAt < mBytes.size() && !nextLine().empty()) {
        }
    }

    void skipArray()
    {
        if (upper(peekWord()) == "METADATA") skipMetadata();
        nextRawWord(); // its name
        const std::uint64_t components = nextCount(), tuples = nextCount();
        if (components > kMostComponents) fail("has a .vtk array that is too wide");
        const NumberType type = typeOf(nextWord());
        if (mIsText) {
            for (std::uint64_t left = components * tuples; left > 0; --left) nextRawWord();
        } else {
            nextLine();
            takeBytes(components * tuples, type.bytes);
        }
    }

    // The place of that many values, behind which it goes on.
    const char* takeBytes(std::uint64_t values, std::uint64_t bytes)
    {
        if (mAt > mBytes.size() || values > (mBytes.size() - mAt) / bytes)
            fail("is a .vtk file that ends before the values that it declares");
        const char* const first = mBytes.data() + mAt;
        mAt += values * bytes;
        return first;
    }

    Positions readPoints()
    {
        const std::uint64_t values = 3 * nextCount();
        const NumberType type = typeOf(nextWord());
        Positions positions;
        const auto add = [&](const std::optional<double>& value) {
            if (positions.size() % kRowsBetweenChecks == 0) mInput.checkCancelled();
            if (!value)
                fail("has a coordinate of .vtk point " + std::to_string(positions.size() / 3) +
                     " that is no number or not exact in double");
            positions.push_back(*value);
        };
        if (mIsText) {
            const bool isFloat = type.kind == 'f' && type.bytes == 4;
            while (positions.size() < values) {
                const std::string word = nextRawWord();
                add(isFloat ? floatOf(word) : numberOf(word));
            }
        } else {
            if (values > 0 || mAt < mBytes.size()) nextLine();
            const char* const first = takeBytes(values, type.bytes);
            while (positions.size() < values)
                add(numberAt(first + positions.size() * type.bytes, type, true));
        }
        checkWhatFollows();
        return positions;
    }

    void checkWhatFollows()
    {
        const std::string word = upper(peekWord());
        for (const char* keyword : {"", "METADATA", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS",
                                    "CELLS", "CELL_TYPES", "CELL_DATA", "POINT_DATA", "FIELD"}) {
            if (word == keyword) return;
        }
        fail("has something behind the points of a .vtk file that begins no section");
    }

    const PointInput& mInput;
    const std::string mBytes;
    std::size_t mAt = 0;
    bool mIsText = false;
};

} // namespace

Positions readVtkPoints(const PointInput& input)
{
    return VtkFile(input).read();
}

} // namespace vdb_nns::cli
