// The polygon file format (Greg Turk, Stanford): lines of a header, and behind `end_header` the rows of its
// elements, in their order, as text with a row a line or as packed binary numbers. Positions are x, y and z
// of the element `vertex`; other properties of it are read one at a time.
#include "file_numbers.h"
#include "point_formats.h"

#include <algorithm>
#include <cstring>
#include <fstream>
#include <sstream>

namespace vdb_nns::cli {

namespace {

struct Property {
    std::string name;
    NumberType type;
    std::optional<NumberType> length; // of a list
};

struct Element {
    std::string name;
    std::uint64_t rows = 0;
    std::vector<Property> properties;
};

class PlyFile {
public:
    explicit PlyFile(const PointInput& input) : mInput(input), mStream(input.path, std::ios::binary)
    {
        if (!mStream) input.fail("cannot be opened");
    }

    // Numbers of those properties of each vertex, one behind the other.
    std::vector<double> read(const std::vector<std::string>& properties)
    {
        readHeader();
        std::size_t number = 0;
        while (number < mElements.size() && mElements[number].name != "vertex") ++number;
        if (number == mElements.size()) mInput.fail("has no .ply element 'vertex'");
        findWanted(mElements[number], properties);
        if (mIsText) {
            readText(number);
        } else {
            readBinary(number);
        }
        return std::move(mNumbers);
    }

private:
    // ------------------------------------------------------------------------------------------------ header

    // A line of the header ends with LF, before which a CR is dropped, or with a lone CR if the first one
    // does.
    std::vector<std::string> headerWords()
    {
        std::string line;
        if (!std::getline(mStream, line, mLineEnd)) mInput.fail("ends inside of its .ply header");
        std::istringstream stream(line);
        std::vector<std::string> words;
        for (std::string word; stream >> word;) words.push_back(word);
        return words;
    }

    void findLineEnd()
    {
        char c = 0;
        while (mStream.get(c) && c != '\n' && c != '\r') {
        }
        if (c == '\r' && mStream.peek() != '\n') mLineEnd = '\r';
        mStream.clear();
        mStream.seekg(0);
    }

    void readHeader()
    {
        findLineEnd();
        if (headerWords() != std::vector<std::string>{"ply"}) mInput.fail("is no .ply file");
        std::string format;
        while (true) {
            const std::vector<std::string> words = headerWords();
            const std::string keyword = words.empty() ? "comment" : words[0];
            if (keyword == "comment" || keyword == "obj_info") continue;
            if (keyword == "end_header") break;
            if (keyword == "format" && words.size() == 3) {
                format = words[1];
            } else if (keyword == "element" && words.size() == 3) {
                mElements.push_back({words[1], lengthOf(words[2]), {}});
            } else if (keyword == "property" && !mElements.empty() && words.size() == 3) {
                mElements.back().properties.push_back({words[2], typeOf(words[1]), std::nullopt});
            } else if (keyword == "property" && !mElements.empty() && words.size() == 5 &&
                       words[1] == "list") {
                const NumberType length = typeOf(words[2]);
                if (length.kind == 'f') mInput.fail("has a .ply list whose length is no integer");
                mElements.back().properties.push_back({words[4], typeOf(words[3]), length});
            } else {
                mInput.fail("has a .ply header with the line '" + keyword + "', which is not understood");
            }
        }
        mIsText = format == "ascii";
        mIsBigEndian = format == "binary_big_endian";
        if (!mIsText && !mIsBigEndian && format != "binary_little_endian")
            mInput.fail("has the .ply format '" + format + "', which is not read");
    }

    std::uint64_t lengthOf(const std::string& text) const
    {
        if (text.empty() || text.size() > 18 || text.find_first_not_of("0123456789") != std::string::npos)
            mInput.fail("has a number of .ply rows or values that is none: '" + text + "'");
        return std::stoull(text);
    }

    NumberType typeOf(const std::string& name) const
    {
        const struct {
            const char *name, *newerName;
            NumberType type;
        } kTypes[] = {{"char", "int8", {'i', 1}},     {"uchar", "uint8", {'u', 1}},
                      {"short", "int16", {'i', 2}},   {"ushort", "uint16", {'u', 2}},
                      {"int", "int32", {'i', 4}},     {"uint", "uint32", {'u', 4}},
                      {"float", "float32", {'f', 4}}, {"double", "float64", {'f', 8}}};
        for (const auto& known : kTypes) {
            if (name == known.name || name == known.newerName) return known.type;
        }
        mInput.fail("has the .ply type '" + name + "', which is not known");
    }

    void findWanted(const Element& vertex, const std::vector<std::string>& wanted)
    {
        mPlace.assign(vertex.properties.size(), -1);
        mRow.resize(wanted.size());
        for (std::size_t k = 0; k < wanted.size(); ++k) {
            int found = 0;
            for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
                const Property& property = vertex.properties[i];
                if (property.name != wanted[k] || property.length) continue;
                mPlace[i] = static_cast<int>(k);
                ++found;
            }
            if (found != 1)
                mInput.fail("has no .ply property " + wanted[k] +
                            " of 'vertex' that is a number, or has it twice");
        }
    }

    // ------------------------------------------------------------------------------------------------ rows

    bool isLast(std::size_t vertex) const
    {
        for (std::size_t i = vertex + 1; i < mElements.size(); ++i) {
            if (mElements[i].rows > 0 && !mElements[i].properties.empty()) return false;
        }
        return true;
    }

    // The row that was read.
    void addRow()
    {
        if (mNumbers.size() / mRow.size() % kRowsBetweenChecks == 0) mInput.checkCancelled();
        mNumbers.insert(mNumbers.end(), mRow.begin(), mRow.end());
    }

    void readText(std::size_t vertex)
    {
        LineReader lines(mStream);
        std::string line;
        const auto nextRow = [&] {
            while (lines.next(line)) {
                if (line.find_first_not_of(" \t\v\f") != std::string::npos) return true;
            }
            return false;
        };
        for (std::size_t i = 0; i <= vertex; ++i) {
            if (mElements[i].properties.empty()) continue;
            for (std::uint64_t row = 0; row < mElements[i].rows; ++row) {
                if (!nextRow()) mInput.fail("ends before the .ply rows that its header promises");
                readRow(mElements[i], line, i == vertex);
            }
        }
        if (isLast(vertex) && nextRow())
            mInput.fail("has more .ply rows than its header declares: '" + line + "'");
    }

    // A line that has as many values as its element declares.
    void readRow(const Element& element, const std::string& line, bool isVertex)
    {
        std::size_t at = 0;
        std::string word;
        const auto nextWord = [&] {
            const std::size_t first = line.find_first_not_of(" \t\v\f", at);
            if (first == std::string::npos) return false;
            at = std::min(line.find_first_of(" \t\v\f", first), line.size());
            word.assign(line, first, at - first);
            return true;
        };
        const auto take = [&] {
            if (!nextWord()) mInput.fail("has a .ply row with fewer values than declared: '" + line + "'");
        };
        for (std::size_t i = 0; i < element.properties.size(); ++i) {
            const Property& property = element.properties[i];
            take();
            if (property.length) {
                for (std::uint64_t left = lengthOf(word); left > 0; --left) take();
            } else if (isVertex && mPlace[i] >= 0) {
                const bool isFloat = property.type.kind == 'f' && property.type.bytes == 4;
                const std::optional<double> value = isFloat ? floatOf(word) : numberOf(word);
                if (!value) mInput.fail("has a .ply value that is no number of its type: '" + word + "'");
                mRow[static_cast<std::size_t>(mPlace[i])] = *value;
            }
        }
        if (nextWord()) mInput.fail("has a .ply row with more values than declared: '" + line + "'");
        if (isVertex) addRow();
    }

    void readBytes(char* out, std::size_t bytes)
    {
        if (!mStream.read(out, static_cast<std::streamsize>(bytes)))
            mInput.fail("ends before the .ply rows that its header promises");
    }

    double readNumber(NumberType type)
    {
        char raw[8];
        readBytes(raw, type.bytes);
        return *numberAt(raw, type, mIsBigEndian); // at most 32 bits where it is an integer
    }

    void readBinary(std::size_t vertex)
    {
        for (std::size_t i = 0; i <= vertex; ++i) {
            if (mElements[i].properties.empty()) continue;
            for (std::uint64_t row = 0; row < mElements[i].rows; ++row)
                readBinaryRow(mElements[i], i == vertex);
        }
        if (isLast(vertex) && mStream.peek() != std::ifstream::traits_type::eof())
            mInput.fail("has more bytes than the .ply rows that its header declares");
    }

    void readBinaryRow(const Element& element, bool isVertex)
    {
        for (std::size_t i = 0; i < element.properties.size(); ++i) {
            const Property& property = element.properties[i];
            if (property.length) {
                const double length = readNumber(*property.length);
                if (length < 0) mInput.fail("has a .ply list of negative length");
                for (auto left = static_cast<std::uint64_t>(length); left > 0; --left)
                    readNumber(property.type);
            } else {
                const double value = readNumber(property.type);
                if (isVertex && mPlace[i] >= 0) mRow[static_cast<std::size_t>(mPlace[i])] = value;
            }
        }
        if (isVertex) addRow();
    }

    const PointInput& mInput;
    std::ifstream mStream;
    char mLineEnd = '\n';
    bool mIsText = false, mIsBigEndian = false;
    std::vector<Element> mElements;
    std::vector<int> mPlace;  // of each property of a vertex among those wanted, or -1
    std::vector<double> mRow; // those wanted of a vertex
    std::vector<double> mNumbers;
};

} // namespace

Positions readPlyPoints(const PointInput& input)
{
    return PlyFile(input).read({"x", "y", "z"});
}

std::vector<double> readPlyProperty(const PointInput& input, const std::string& name)
{
    return PlyFile(input).read({name});
}

} // namespace vdb_nns::cli
