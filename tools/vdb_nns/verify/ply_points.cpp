// The polygon file format (Greg Turk, Stanford): lines of a header, and behind `end_header` the rows of its
// elements, in their order, as text with a row a line or as packed binary numbers. Positions are x, y and z
// of the element `vertex`.
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

    Positions read()
    {
        readHeader();
        std::size_t number = 0;
        while (number < mElements.size() && mElements[number].name != "vertex") ++number;
        if (number == mElements.size()) mInput.fail("has no .ply element 'vertex'");
        findCoordinates(mElements[number]);
        if (mIsText) {
            readText(number);
        } else {
            readBinary(number);
        }
        return std::move(mPositions);
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

    void findCoordinates(const Element& vertex)
    {
        mCoordinate.assign(vertex.properties.size(), -1);
        for (int k = 0; k < 3; ++k) {
            int found = 0;
            for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
                const Property& property = vertex.properties[i];
                if (property.name != std::string(1, "xyz"[k]) || property.length) continue;
                mCoordinate[i] = k;
                ++found;
            }
            if (found != 1) mInput.fail("has no .ply property x, y or z of 'vertex', or has it twice");
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

    void add(const double* position)
    {
        if (mPositions.size() / 3 % kRowsBetweenChecks == 0) mInput.checkCancelled();
        mPositions.insert(mPositions.end(), position, position + 3);
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
        double position[3] = {};
        for (std::size_t i = 0; i < element.properties.size(); ++i) {
            const Property& property = element.properties[i];
            take();
            if (property.length) {
                for (std::uint64_t left = lengthOf(word); left > 0; --left) take();
            } else if (isVertex && mCoordinate[i] >= 0) {
                const bool isFloat = property.type.kind == 'f' && property.type.bytes == 4;
                const std::optional<double> value = isFloat ? floatOf(word) : numberOf(word);
                if (!value)
                    mInput.fail("has a .ply coordinate that is no number of its type: '" + word + "'");
                position[mCoordinate[i]] = *value;
            }
        }
        if (nextWord()) mInput.fail("has a .ply row with more values than declared: '" + line + "'");
        if (isVertex) add(position);
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
        double position[3] = {};
        for (std::size_t i = 0; i < element.properties.size(); ++i) {
            const Property& property = element.properties[i];
            if (property.length) {
                const double length = readNumber(*property.length);
                if (length < 0) mInput.fail("has a .ply list of negative length");
                for (auto left = static_cast<std::uint64_t>(length); left > 0; --left)
                    readNumber(property.type);
            } else {
                const double value = readNumber(property.type);
                if (isVertex && mCoordinate[i] >= 0) position[mCoordinate[i]] = value;
            }
        }
        if (isVertex) add(position);
    }

    const PointInput& mInput;
    std::ifstream mStream;
    char mLineEnd = '\n';
    bool mIsText = false, mIsBigEndian = false;
    std::vector<Element> mElements;
    std::vector<int> mCoordinate; // of each property of a vertex: 0, 1, 2 or none, -1
    Positions mPositions;
};

} // namespace

Positions readPlyPoints(const PointInput& input)
{
    return PlyFile(input).read();
}

} // namespace vdb_nns::cli
