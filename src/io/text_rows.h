// Lines, fields and numbers of a text.
#pragma once

#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <string>
#include <string_view>

#include <emmintrin.h>

namespace vdb_nns {

inline bool isBlank(char c)
{
    return c == ' ' || c == '\t' || c == '\v' || c == '\f';
}

inline std::string_view trimmed(std::string_view text)
{
    while (!text.empty() && isBlank(text.front())) text.remove_prefix(1);
    while (!text.empty() && isBlank(text.back())) text.remove_suffix(1);
    return text;
}

// The first LF or CR at or behind `next`, or `end`.
inline const char* findLineEnd(const char* next, const char* end)
{
    const __m128i lf = _mm_set1_epi8('\n'), cr = _mm_set1_epi8('\r');
    for (; end - next >= 16; next += 16) {
        const __m128i text = _mm_loadu_si128(reinterpret_cast<const __m128i*>(next));
        const int found = _mm_movemask_epi8(_mm_or_si128(_mm_cmpeq_epi8(text, lf), _mm_cmpeq_epi8(text, cr)));
        if (found != 0) return next + __builtin_ctz(static_cast<unsigned>(found));
    }
    while (next != end && *next != '\n' && *next != '\r') ++next;
    return next;
}

// Behind the end of a line, which is LF, CR LF or CR.
inline const char* afterLineEnd(const char* lineEnd, const char* end)
{
    if (lineEnd == end) return end;
    return lineEnd + (*lineEnd == '\r' && lineEnd + 1 != end && lineEnd[1] == '\n' ? 2 : 1);
}

// Number of the line that `place` is in, from 1.
inline std::size_t lineNumber(const char* begin, const char* place)
{
    std::size_t number = 1;
    for (const char* next = begin; (next = findLineEnd(next, place)) != place; ++number)
        next = afterLineEnd(next, place);
    return number;
}

// A line without its comment: `#` at its beginning or behind a blank.
inline std::string_view withoutComment(std::string_view line)
{
    for (std::size_t at = line.find('#'); at != std::string_view::npos; at = line.find('#', at + 1)) {
        if (at == 0 || isBlank(line[at - 1])) return line.substr(0, at);
    }
    return line;
}

// Takes the next field of a line off it. Separator ' ': blanks and tabs, any number of them; else that character, with
// blanks around fields dropped. A field in double quotes may hold separators. False where there is none.
// A separator at the end of a line is followed by an empty field.
class FieldSplitter {
public:
    FieldSplitter(std::string_view line, char separator) : mRest(line), mSeparator(separator) {}

    bool next(std::string_view& field)
    {
        if (mIsAtEnd) return false;
        while (!mRest.empty() && isBlank(mRest.front())) mRest.remove_prefix(1);
        std::size_t end = 0;
        if (mSeparator == ' ') {
            if (mRest.empty()) return false;
            while (end < mRest.size() && !isBlank(mRest[end])) ++end;
            field = mRest.substr(0, end);
            mRest.remove_prefix(end);
            return true;
        }
        if (!mRest.empty() && mRest.front() == '"') {
            const std::size_t close = mRest.find('"', 1);
            end = close == std::string_view::npos ? mRest.size() : close + 1;
        }
        end = mRest.find(mSeparator, end);
        mIsAtEnd = end == std::string_view::npos;
        field = trimmed(mRest.substr(0, end));
        mRest.remove_prefix(mIsAtEnd ? mRest.size() : end + 1);
        return true;
    }

private:
    std::string_view mRest;
    char mSeparator;
    bool mIsAtEnd = false;
};

enum class NumberText { kNumber, kEmpty, kNotANumber, kTooLarge };

// Microsoft's older run-time library writes 1.#QNAN, -1.#IND, 1.#INF and the like, some with zeros behind them.
inline bool readMicrosoftNumber(std::string_view text, double& value)
{
    const bool isNegative = !text.empty() && text.front() == '-';
    if (isNegative) text.remove_prefix(1);
    if (text.substr(0, 3) != "1.#") return false;
    text.remove_prefix(3);
    for (const std::string_view name : {"QNAN", "SNAN", "IND", "INF", "NAN"}) {
        if (text.substr(0, name.size()) != name) continue;
        if (text.find_first_not_of('0', name.size()) != std::string_view::npos) return false;
        value = name == "INF" ? HUGE_VAL : std::strtod("nan", nullptr);
        if (isNegative) value = -value;
        return true;
    }
    return false;
}

// The double nearest to a text that is a number from its first to its last character.
inline NumberText readNumber(std::string_view text, double& value)
{
    if (text.empty()) return NumberText::kEmpty;
    const char* first = text.data();
    const char* const last = first + text.size();
    if (*first == '+' && text.size() > 1 && first[1] != '-') ++first; // from_chars takes no plus sign
    const std::from_chars_result result = std::from_chars(first, last, value);
    if (result.ec == std::errc::invalid_argument || result.ptr != last) {
        return readMicrosoftNumber(text, value) ? NumberText::kNumber : NumberText::kNotANumber;
    }
    if (result.ec == std::errc::result_out_of_range) {
        // Too small is rounded to the nearest double, which strtod does; too large has none.
        value = std::strtod(std::string(first, last).c_str(), nullptr);
        if (value > 1 || value < -1) return NumberText::kTooLarge;
    }
    return NumberText::kNumber;
}

} // namespace vdb_nns
