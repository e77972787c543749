// The head of a text, line by line, each of them optional:
//
//   a byte order mark
//   a line of names: without any number, or behind //. If x, y and z are among them, these are the columns.
//   a line with one integer: the number of rows. In chemistry's .xyz a comment follows it, of any form, and the rows begin with
//   an element. In "extended" .xyz the comment says where the positions are: Properties=species:S:1:pos:R:3
//   rows
// Blank lines and those that begin with # are left out, but for the comment of chemistry's .xyz.
#include "io/text_shape.h"

#include "io/text_rows.h"
#include "util/shown_text.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <set>

namespace vdb_nns {

namespace {

// Rows that are looked at for a column that numbers the points.
constexpr std::size_t kSampledRows = 100;
// In the comment of "extended" .xyz.
constexpr std::string_view kProperties = "properties="; // in lower case

struct Line {
    const char* begin = nullptr;
    std::string_view text; // without its end and comment
    const char* next = nullptr;
};

std::vector<std::string_view> fieldsOf(std::string_view text, char separator)
{
    std::vector<std::string_view> fields;
    FieldSplitter splitter(text, separator);
    for (std::string_view field; splitter.next(field);) fields.push_back(field);
    return fields;
}

bool isNumber(std::string_view field)
{
    double ignored;
    const NumberText read = readNumber(field, ignored);
    return read == NumberText::kNumber || read == NumberText::kTooLarge;
}

bool isInteger(std::string_view field)
{
    if (!field.empty() && (field.front() == '+' || field.front() == '-')) field.remove_prefix(1);
    return !field.empty() && field.find_first_not_of("0123456789") == std::string_view::npos;
}

std::size_t numbersIn(const std::vector<std::string_view>& fields)
{
    return static_cast<std::size_t>(std::count_if(fields.begin(), fields.end(), isNumber));
}

// The separator that leaves the most numbers, and of several the fewest fields, as in `1 , 2 , 3`.
char separatorOf(std::string_view text)
{
    char best = ' ';
    std::vector<std::string_view> fields = fieldsOf(text, ' ');
    std::size_t most = numbersIn(fields), fewest = fields.size();
    for (const char separator : {',', ';'}) {
        fields = fieldsOf(text, separator);
        const std::size_t numbers = numbersIn(fields);
        if (numbers > most || (numbers > 0 && numbers == most && fields.size() < fewest)) {
            best = separator;
            most = numbers;
            fewest = fields.size();
        }
    }
    return best;
}

// Of a line of names, which has no numbers.
char separatorOfNames(std::string_view text)
{
    if (text.find(';') != std::string_view::npos) return ';';
    return text.find(',') != std::string_view::npos ? ',' : ' ';
}

std::string inLowerCase(std::string_view text)
{
    std::string lower(text);
    for (char& c : lower) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    return lower;
}

// In lower case, without quotes.
std::string plainName(std::string_view name)
{
    if (name.size() >= 2 && name.front() == '"' && name.back() == '"') name = name.substr(1, name.size() - 2);
    return inLowerCase(trimmed(name));
}

class ShapeFinder {
public:
    explicit ShapeFinder(const ArrayFile& file)
        : mFile(file),
          mBegin(reinterpret_cast<const char*>(file.bytes.data())),
          mEnd(mBegin + file.bytes.size()),
          mNext(mBegin)
    {
    }

    TextShape find()
    {
        skipByteOrderMark();
        mShape.begin = mShape.end = mEnd;
        Line line;
        if (!nextLine(line)) return mShape;
        if (isNames(line)) {
            const Line names = line;
            if (!nextLine(line)) {
                if (!columnsOf(mNames))
                    fail(names.begin, "has no number, and no row follows: '" + shownText(names.text) + "'");
                return mShape;
            }
        }
        if (isCount(line)) {
            if (!readCount(line)) return mShape;
        } else {
            mShape.begin = line.begin;
            mShape.end = mEnd;
        }
        findColumns();
        return mShape;
    }

private:
    [[noreturn]] void fail(const char* place, const std::string& what) const
    {
        throw InputError(mFile.path + ": line " + std::to_string(lineNumber(mBegin, place)) + " (byte " +
                         std::to_string(place - mBegin) + ") " + what);
    }

    void skipByteOrderMark()
    {
        const std::string_view text(mBegin, static_cast<std::size_t>(mEnd - mBegin));
        if (text.substr(0, 3) == "\xEF\xBB\xBF") mNext += 3;
        if (text.substr(0, 2) == "\xFF\xFE" || text.substr(0, 2) == "\xFE\xFF")
            fail(mBegin,
                 "begins with the byte order mark of UTF-16, which is not read; save the text as UTF-8");
    }

    // Any line, its comment included.
    Line rawLine(const char* begin) const
    {
        const char* const lineEnd = findLineEnd(begin, mEnd);
        return {begin, {begin, static_cast<std::size_t>(lineEnd - begin)}, afterLineEnd(lineEnd, mEnd)};
    }

    // The next line that says something.
    bool nextLine(Line& line)
    {
        while (mNext != mEnd) {
            line = rawLine(mNext);
            mNext = line.next;
            const std::string_view whole = trimmed(line.text);
            line.text = trimmed(withoutComment(line.text));
            if (!line.text.empty()) return true;
            if (!whole.empty()) mLastRemark = trimmed(whole.substr(1));
        }
        return false;
    }

    bool isNames(const Line& line)
    {
        std::string_view text = line.text;
        const bool isMarked = text.substr(0, 2) == "//";
        if (isMarked) text = trimmed(text.substr(2));
        if (!isMarked && numbersIn(fieldsOf(text, separatorOf(text))) > 0) return false;
        for (const std::string_view name : fieldsOf(text, separatorOfNames(text)))
            mNames.push_back(plainName(name));
        return true;
    }

    static bool isCount(const Line& line) { return isInteger(line.text) && line.text.front() != '-'; }

    // Sets where the rows are. False where the count is 0.
    bool readCount(const Line& line)
    {
        double count = 0;
        if (readNumber(line.text, count) != NumberText::kNumber ||
            count > static_cast<double>(kMaxFilePoints)) {
            fail(line.begin, "counts '" + shownText(line.text) + "' points, more than the " +
                                 std::to_string(kMaxFilePoints) + " that fit");
        }
        mShape.count = static_cast<std::uint64_t>(count);
        mShape.countLine = lineNumber(mBegin, line.begin);
        if (line.next == mEnd) {
            if (count > 0)
                fail(line.begin, "counts '" + shownText(line.text) + "' points, and no row follows");
            return false;
        }
        const Line comment = rawLine(line.next), first = rawLine(comment.next == mEnd ? mEnd : comment.next);
        const std::string_view rest = trimmed(withoutComment(comment.text));
        const bool hasRow = numbersIn(fieldsOf(rest, separatorOf(rest))) >= 3 &&
                            rest.find('=') == std::string_view::npos; // Lattice="1 0 0 ..." has numbers too
        const std::vector<std::string_view> atom = fieldsOf(trimmed(first.text), ' ');
        const bool hasElement = atom.size() >= 4 && isNumber(atom[1]) &&
                                (!isNumber(atom[0]) || (rest.empty() && isAtomicNumber(atom)));
        const bool hasComment = mNames.empty() && !hasRow && !rest.empty();
        if (hasElement || hasComment) {
            readFrame(comment);
        } else {
            mShape.begin = line.next;
            mShape.end = mEnd;
        }
        return count > 0;
    }

    // Of a row behind a comment that says nothing, in a file whose name is that of chemistry.
    bool isAtomicNumber(const std::vector<std::string_view>& row) const
    {
        const std::string path = inLowerCase(mFile.path);
        return path.size() > 4 && path.compare(path.size() - 4, 4, ".xyz") == 0 && mNames.empty() &&
               isInteger(row[0]) && !(isInteger(row[1]) && isInteger(row[2]) && isInteger(row[3]));
    }

    // Of chemistry's .xyz: as many lines as counted; more frames may follow.
    void readFrame(const Line& comment)
    {
        mIsChemistry = true;
        mComment = comment.text;
        mShape.begin = comment.next;
        const char* next = comment.next;
        for (std::uint64_t left = *mShape.count; left > 0; --left) {
            if (next == mEnd) {
                fail(next, "is missing: line " + std::to_string(mShape.countLine) + " counts " +
                               std::to_string(*mShape.count) + " points, and " +
                               std::to_string(*mShape.count - left) + " rows follow");
            }
            next = rawLine(next).next;
        }
        mShape.end = next;
        mNext = next;
        Line line;
        if (!nextLine(line)) return;
        if (!isCount(line)) {
            fail(line.begin, "follows the " + std::to_string(*mShape.count) + " rows that line " +
                                 std::to_string(mShape.countLine) + " counts: '" + shownText(line.text) +
                                 "'");
        }
        mShape.notes.push_back("the file has several frames, and the first was read");
    }

    void findColumns()
    {
        mNext = mShape.begin;
        Line line;
        if (!nextLine(line) || line.begin >= mShape.end) return;
        mShape.separator = separatorOf(line.text);
        const std::vector<std::string_view> fields = fieldsOf(line.text, mShape.separator);
        mShape.width = fields.size();
        if (mShape.width < 3) {
            fail(line.begin, "has fewer than three columns: '" + shownText(line.text) +
                                 "'; a row is x y z, with blanks, tabs, commas or semicolons between");
        }
        if (!chosenColumns(line) && !namedColumns() && !chemicalColumns(fields) && !remarkedColumns())
            warnOfNumbers();
        if (mShape.width > 3 || mShape.columns[0] != 0 || mShape.columns[1] != 1) {
            mShape.taken = "columns " + std::to_string(mShape.columns[0]) + ", " +
                           std::to_string(mShape.columns[1]) + " and " + std::to_string(mShape.columns[2]) +
                           " of " + std::to_string(mShape.width) +
                           (mIsChemistry ? ", in angstrom as .xyz files of chemistry are" : "");
        }
    }

    bool chosenColumns(const Line& line)
    {
        const std::vector<std::uint32_t>& chosen = mFile.choice.columns;
        if (chosen.empty()) return false;
        for (std::size_t k = 0; k < 3; ++k) {
            mShape.columns[k] = chosen[k];
            if (chosen[k] < mShape.width) continue;
            throw InvalidInput(mFile.path + ": has no column " + std::to_string(chosen[k]) +
                               " (--columns): line " + std::to_string(lineNumber(mBegin, line.begin)) +
                               " has " + std::to_string(mShape.width) + ", from 0");
        }
        return true;
    }

    bool namedColumns()
    {
        if (mNames.empty()) return false;
        if (takeNamed(mNames)) return true;
        mShape.notes.push_back("the line of names does not name x, y and z for the " +
                               std::to_string(mShape.width) +
                               " columns, and the first three were taken; choose with --columns 0,1,2");
        return true;
    }

    // The last comment before the rows, as numpy.savetxt writes names.
    bool remarkedColumns()
    {
        std::vector<std::string> names;
        for (const std::string_view name : fieldsOf(mLastRemark, separatorOfNames(mLastRemark)))
            names.push_back(plainName(name));
        return takeNamed(names);
    }

    bool takeNamed(const std::vector<std::string>& names)
    {
        const std::optional<std::array<std::uint32_t, 3>> columns = columnsOf(names);
        if (!columns || names.size() != mShape.width) return false;
        std::copy(columns->begin(), columns->end(), mShape.columns);
        return true;
    }

    // Of x, y and z among names.
    static std::optional<std::array<std::uint32_t, 3>> columnsOf(const std::vector<std::string>& names)
    {
        std::array<std::uint32_t, 3> columns{};
        for (std::size_t k = 0; k < 3; ++k) {
            const auto found = std::find(names.begin(), names.end(), std::string(1, "xyz"[k]));
            if (found == names.end()) return std::nullopt;
            columns[k] = static_cast<std::uint32_t>(found - names.begin());
        }
        return columns;
    }

    bool chemicalColumns(const std::vector<std::string_view>& fields)
    {
        if (!mIsChemistry) return false;
        std::uint32_t first = mShape.width > 3 && (!isNumber(fields[0]) || isInteger(fields[0])) ? 1 : 0;
        if (const std::optional<std::uint32_t> position = positionProperty()) first = *position;
        for (std::uint32_t k = 0; k < 3; ++k) mShape.columns[k] = first + k;
        return true;
    }

    // Column of `pos` after the comment's Properties=name:type:columns:..., which must be those of the rows.
    std::optional<std::uint32_t> positionProperty() const
    {
        const std::string comment = inLowerCase(mComment);
        const std::size_t at = comment.find(kProperties);
        if (at == std::string::npos) return std::nullopt;
        std::string_view list = std::string_view(comment).substr(at + kProperties.size());
        if (!list.empty() && list.front() == '"') list.remove_prefix(1);
        list = list.substr(0, list.find_first_of(" \t\""));
        const auto begin = static_cast<std::size_t>(list.data() - comment.data());
        const std::string is = "follows Properties=" + shownText(mComment.substr(begin, list.size())) + ", ";
        const std::string choose = "; say which columns are x, y and z (--columns 1,2,3)";
        std::optional<std::uint32_t> position;
        std::uint32_t columns = 0;
        while (!list.empty()) {
            std::string_view part[3];
            for (std::string_view& each : part) {
                const std::size_t colon = std::min(list.find(':'), list.size());
                each = list.substr(0, colon);
                list.remove_prefix(std::min(colon + 1, list.size()));
            }
            double count = 0;
            if (readNumber(part[2], count) != NumberText::kNumber || !(count >= 1 && count < 1000))
                fail(mShape.begin, is + "which is no list of name:type:columns" + choose);
            if (part[0] == "pos" && count == 3 && !position) position = columns;
            columns += static_cast<std::uint32_t>(count);
        }
        if (!position) fail(mShape.begin, is + "which names no pos of three columns" + choose);
        if (columns != mShape.width) {
            fail(mShape.begin, is + "which are " + std::to_string(columns) + " columns, and has " +
                                   std::to_string(mShape.width) + choose);
        }
        return position;
    }

    // A first column of integers that ascend, or that are few, beside columns that are no integers.
    void warnOfNumbers()
    {
        if (mShape.width < 4) return;
        mNext = mShape.begin;
        Line line;
        std::size_t rows = 0;
        bool isAscending = true, areOthersIntegers = true;
        double before = -HUGE_VAL;
        std::set<double> values;
        while (rows < kSampledRows && nextLine(line)) {
            const std::vector<std::string_view> fields = fieldsOf(line.text, mShape.separator);
            double value = 0;
            if (fields.size() < 4 || !isInteger(fields[0]) ||
                readNumber(fields[0], value) != NumberText::kNumber)
                return;
            ++rows;
            isAscending = isAscending && value > before;
            before = value;
            values.insert(value);
            for (std::size_t k = 1; k < 4; ++k) {
                if (!isNumber(fields[k])) return;
                areOthersIntegers = areOthersIntegers && isInteger(fields[k]);
            }
        }
        const bool areFew = rows >= 10 && values.size() <= rows / 5;
        if (rows < 2 || areOthersIntegers || !(isAscending || areFew)) return;
        mShape.notes.push_back(std::string("the first column looks like ") +
                               (isAscending ? "a number of the points" : "an element or a kind") +
                               " and was taken as x; if it is none, choose with --columns 1,2,3");
    }

    const ArrayFile& mFile;
    const char *mBegin, *mEnd, *mNext;
    TextShape mShape;
    std::vector<std::string> mNames; // in lower case
    bool mIsChemistry = false;
    std::string_view mComment;
    std::string_view mLastRemark; // of lines that begin with #
};

} // namespace

TextShape findTextShape(const ArrayFile& file)
{
    return ShapeFinder(file).find();
}

} // namespace vdb_nns
