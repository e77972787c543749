// Lines, fields and numbers of a text.
#pragma once

#include "io/number_type.h"

#include <cstddef>
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

// The double nearest to a text that is a number from its first to its last character.
inline NumberText readNumber(std::string_view text, double& value)
{
    if (text.empty()) return NumberText::kEmpty;
    const char* next = text.data();
    const char* const what = readTextNumber<double>(next, text.data() + text.size(), value);
    if (what)
        return std::string_view(what) == kIsOutOfRange ? NumberText::kTooLarge : NumberText::kNotANumber;
    return next == text.data() + text.size() ? NumberText::kNumber : NumberText::kNotANumber;
}

} // namespace vdb_nns
