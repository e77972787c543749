// Text: a row a line, with blanks, commas or semicolons between its fields. Before the rows may stand, in
// this order, a line of names and a line with the number of rows; behind that number chemistry's .xyz has a
// line for a comment. Blank lines and those that begin with # say nothing.
#include "file_numbers.h"
#include "point_formats.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <deque>
#include <fstream>

namespace vdb_nns::cli {

namespace {

using Fields = std::vector<std::string>;

const char* const kBlanks = " \t\v\f";
const char* const kProperties = "properties="; // in the comment of "extended" .xyz

std::string trim(const std::string& text)
{
    const std::size_t first = text.find_first_not_of(kBlanks);
    if (first == std::string::npos) return {};
    return text.substr(first, text.find_last_not_of(kBlanks) + 1 - first);
}

// Without what follows a # at the beginning or behind a blank, and without blanks around.
std::string contentOf(const std::string& line)
{
    for (std::size_t at = line.find('#'); at != std::string::npos; at = line.find('#', at + 1)) {
        if (at == 0 || std::string(kBlanks).find(line[at - 1]) != std::string::npos)
            return trim(line.substr(0, at));
    }
    return trim(line);
}

void splitAtBlanks(const std::string& line, Fields& fields)
{
    fields.clear();
    std::size_t at = line.find_first_not_of(kBlanks);
    while (at != std::string::npos) {
        const std::size_t end = std::min(line.find_first_of(kBlanks, at), line.size());
        fields.emplace_back(line, at, end - at);
        at = line.find_first_not_of(kBlanks, end);
    }
}

// A separator inside of "quotes" is none.
void split(const std::string& line, char separator, Fields& fields)
{
    if (separator == ' ') return splitAtBlanks(line, fields);
    fields.clear();
    std::size_t at = 0;
    bool isQuoted = false;
    for (std::size_t i = 0; i <= line.size(); ++i) {
        if (i < line.size() && line[i] == '"') isQuoted = !isQuoted;
        if (i < line.size() && (line[i] != separator || isQuoted)) continue;
        fields.push_back(trim(line.substr(at, i - at)));
        at = i + 1;
    }
}

std::size_t numbersIn(const Fields& fields)
{
    return static_cast<std::size_t>(std::count_if(
        fields.begin(), fields.end(), [](const std::string& f) { return numberOf(f).has_value(); }));
}

// The separator with which a line has the most numbers; of several the one with the fewest fields, blanks
// first.
char separatorOf(const std::string& line, std::size_t* numbers = nullptr)
{
    char best = ' ';
    std::size_t most = 0, fewest = 0;
    Fields fields;
    for (const char separator : {' ', ',', ';'}) {
        split(line, separator, fields);
        const std::size_t found = numbersIn(fields);
        if (found < most || found == 0 || (found == most && fields.size() >= fewest)) continue;
        best = separator;
        most = found;
        fewest = fields.size();
    }
    if (numbers) *numbers = most;
    return best;
}

bool isDigits(const std::string& text)
{
    return !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
}

class TextFile {
public:
    explicit TextFile(const PointInput& input)
        : mInput(input), mStream(input.path, std::ios::binary), mLines(mStream)
    {
        if (!mStream) input.fail("cannot be opened");
    }

    Positions read()
    {
        std::string line;
        if (!nextContent(line)) return {};
        if (isNames(line)) {
            const bool areCoordinates = namedColumns(mNames).has_value();
            if (!nextContent(line)) {
                if (!areCoordinates) fail("has no number, and no row follows");
                return {};
            }
        }
        if (!isDigits(line)) {
            mAhead.push_front(line);
            --mLineNumber;
            readRows();
            return std::move(mPositions);
        }
        if (line.size() > 10) fail("counts more points than fit");
        const std::uint64_t count = std::stoull(line);
        if (isChemistry()) {
            readFrame(count);
        } else {
            readRows();
        }
        if (rows() != count)
            mInput.fail("counts " + std::to_string(count) + " points, and has " + std::to_string(rows()));
        return std::move(mPositions);
    }

private:
    [[noreturn]] void fail(const std::string& what) const
    {
        mInput.fail("line " + std::to_string(mLineNumber) + " " + what);
    }

    std::uint64_t rows() const { return mPositions.size() / 3; }

    // Reads until `count` lines are ahead, or all that there are.
    void lookAhead(std::size_t count)
    {
        std::string line;
        while (mAhead.size() < count && mLines.next(line)) {
            if (mIsAtStart && line.compare(0, 3, "\xEF\xBB\xBF") == 0) line.erase(0, 3);
            mIsAtStart = false;
            mAhead.push_back(line);
        }
    }

    bool nextLine(std::string& line)
    {
        lookAhead(1);
        if (mAhead.empty()) return false;
        line.swap(mAhead.front());
        mAhead.pop_front();
        ++mLineNumber;
        return true;
    }

    // The next line that says something.
    bool nextContent(std::string& line)
    {
        while (nextLine(line)) {
            const std::string remark = trim(line);
            line = contentOf(line);
            if (!line.empty()) return true;
            if (!remark.empty() && mWidth == 0) mRemark = trim(remark.substr(1));
        }
        return false;
    }

    // A line without numbers, or behind //, as CloudCompare writes it.
    bool isNames(std::string line)
    {
        std::size_t numbers = 0;
        separatorOf(line, &numbers);
        const bool isMarked = line.compare(0, 2, "//") == 0;
        if (!isMarked && numbers > 0) return false;
        if (isMarked) line.erase(0, 2);
        splitNames(line, mNames);
        return true;
    }

    static void lower(std::string& text)
    {
        for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    }

    static void splitNames(const std::string& line, Fields& names)
    {
        const bool hasSemicolon = line.find(';') != std::string::npos;
        split(line, hasSemicolon ? ';' : line.find(',') != std::string::npos ? ',' : ' ', names);
        for (std::string& name : names) {
            if (name.size() >= 2 && name.front() == '"' && name.back() == '"')
                name = trim(name.substr(1, name.size() - 2));
            lower(name);
        }
    }

    // What follows the number of rows: chemistry has a comment there, which is no row, or any line at all
    // where the next one begins with an element.
    bool isChemistry()
    {
        lookAhead(2);
        if (mAhead.empty()) return false;
        const std::string comment = contentOf(mAhead[0]);
        std::size_t numbers = 0;
        separatorOf(comment, &numbers);
        const bool isRow = numbers >= 3 && comment.find('=') == std::string::npos;
        if (mNames.empty() && !comment.empty() && !isRow) return true;
        if (mAhead.size() < 2) return false;
        Fields atom;
        splitAtBlanks(mAhead[1], atom);
        if (atom.size() < 4 || !numberOf(atom[1])) return false;
        return !numberOf(atom[0]) || (comment.empty() && mNames.empty() && beginsWithAtomicNumber(atom));
    }

    // Behind a comment that says nothing this is chemistry's only by the name of the file, and by real numbers behind it.
    bool beginsWithAtomicNumber(const Fields& row) const
    {
        std::string path = mInput.path;
        lower(path);
        if (path.size() <= 4 || path.substr(path.size() - 4) != ".xyz" || !isInteger(row[0])) return false;
        return !isInteger(row[1]) || !isInteger(row[2]) || !isInteger(row[3]);
    }

    static bool isInteger(const std::string& field)
    {
        return isDigits(field.substr(field.find_first_of("+-") == 0 ? 1 : 0));
    }

    // The first frame of chemistry's .xyz. Behind it may stand another one, which begins with a number too.
    void readFrame(std::uint64_t count)
    {
        nextLine(mComment);
        mIsChemistry = true;
        std::string line;
        for (; count > 0; --count) {
            if (!nextLine(line)) mInput.fail("ends before the rows that it counts");
            line = contentOf(line);
            if (line.empty()) fail("says nothing, and the rows that are counted go on");
            addRow(line);
        }
        if (nextContent(line) && !isDigits(line)) fail("follows the rows that are counted: '" + line + "'");
    }

    void readRows()
    {
        for (std::string line; nextContent(line);) addRow(line);
    }

    void addRow(const std::string& line)
    {
        if (rows() % kRowsBetweenChecks == 0) mInput.checkCancelled();
        if (mWidth == 0) {
            mSeparator = separatorOf(line);
            split(line, mSeparator, mFields);
            mWidth = mFields.size();
            if (mWidth < 3) fail("has fewer than three columns");
            chooseColumns();
        } else {
            split(line, mSeparator, mFields);
        }
        if (mFields.size() != mWidth)
            fail("has " + std::to_string(mFields.size()) + " columns, not " + std::to_string(mWidth));
        for (const std::size_t column : mColumns) {
            const std::optional<double> value = numberOf(mFields[column]);
            if (!value) fail("has no number in column " + std::to_string(column) + ": '" + line + "'");
            mPositions.push_back(*value);
        }
    }

    // By the fields of the first row, which are in mFields.
    void chooseColumns()
    {
        const std::vector<std::uint32_t>& chosen = mInput.options.columns;
        if (!chosen.empty()) {
            for (int k = 0; k < 3; ++k) {
                mInput.checkColumn(chosen[k], mWidth);
                mColumns[k] = chosen[k];
            }
        } else if (!mNames.empty()) {
            chooseNamedColumns(mNames);
        } else if (mIsChemistry) {
            const std::string& first = mFields[0];
            const bool hasElement = mWidth > 3 && (!numberOf(first) || isInteger(first));
            const std::size_t column = positionProperty().value_or(hasElement ? 1 : 0);
            for (std::size_t k = 0; k < 3; ++k) mColumns[k] = column + k;
        } else {
            Fields names;
            splitNames(mRemark, names);
            chooseNamedColumns(names);
        }
    }

    // Names count only if each column has one, and x, y and z are among them.
    void chooseNamedColumns(const Fields& names)
    {
        const auto columns = namedColumns(names);
        if (columns && names.size() == mWidth) std::copy(columns->begin(), columns->end(), mColumns);
    }

    static std::optional<std::array<std::size_t, 3>> namedColumns(const Fields& names)
    {
        std::array<std::size_t, 3> columns{};
        for (std::size_t k = 0; k < 3; ++k) {
            const auto found = std::find(names.begin(), names.end(), std::string(1, "xyz"[k]));
            if (found == names.end()) return std::nullopt;
            columns[k] = static_cast<std::size_t>(found - names.begin());
        }
        return columns;
    }

    // "Extended" .xyz: Properties=species:S:1:pos:R:3, names with a type and a number of columns each.
    std::optional<std::size_t> positionProperty() const
    {
        std::string list = mComment;
        lower(list);
        const std::size_t at = list.find(kProperties);
        if (at == std::string::npos) return std::nullopt;
        list.erase(0, at + std::string(kProperties).size());
        if (list.compare(0, 1, "\"") == 0) list.erase(0, 1);
        list = list.substr(0, list.find_first_of(" \t\""));
        std::replace(list.begin(), list.end(), ':', ' ');
        Fields parts;
        splitAtBlanks(list, parts);
        std::optional<std::size_t> position;
        std::size_t column = 0;
        for (std::size_t i = 0; i < parts.size(); i += 3) {
            if (i + 2 >= parts.size() || !isDigits(parts[i + 2]) || parts[i + 2].size() > 3)
                fail("has a comment before it whose properties are no list");
            const std::size_t width = std::stoul(parts[i + 2]);
            if (parts[i] == "pos" && width == 3 && !position) position = column;
            column += width;
        }
        if (!position || column != mWidth)
            fail("has a comment before it whose properties are not its columns");
        return position;
    }

    const PointInput& mInput;
    std::ifstream mStream;
    LineReader mLines;
    std::deque<std::string> mAhead; // lines that have been looked at
    std::size_t mLineNumber = 0;    // of the last one that was taken, from 1
    bool mIsAtStart = true;

    Fields mNames; // in lower case
    bool mIsChemistry = false;
    std::string mComment;
    std::string mRemark; // the last line before the rows that begins with #, without that

    char mSeparator = ' ';
    std::size_t mWidth = 0; // columns of a row; 0 before the first one
    std::size_t mColumns[3] = {0, 1, 2};
    Fields mFields;
    Positions mPositions;
};

} // namespace

Positions readTextPoints(const PointInput& input)
{
    return TextFile(input).read();
}

} // namespace vdb_nns::cli
