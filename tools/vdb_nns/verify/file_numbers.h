// Numbers as files hold them, in bytes and in text, and lines of text.
#pragma once

#include <istream>
#include <optional>
#include <string>

namespace vdb_nns::cli {

struct NumberType {
    char kind = 'f';    // 'f', 'i' or 'u'
    unsigned bytes = 4; // 2, 4 or 8 of a float; 1, 2, 4 or 8 of an integer
};

// Of one of the kinds and sizes above.
bool isNumberType(NumberType type);

// The value of the number that begins at `first`. Nothing for an integer beyond 2^53 on either side of 0: not
// every one is a double.
std::optional<double> numberAt(const char* first, NumberType type, bool isBigEndian);

// The double nearest to a text that is a number from its first to its last character, as the C library reads
// it, or Microsoft's 1.#QNAN, -1.#IND and 1.#INF. Nothing for any other text, for hexadecimal and for what is
// beyond the range.
std::optional<double> numberOf(const std::string& text);

// The same with float as the type whose nearest number is taken.
std::optional<double> floatOf(const std::string& text);

// Lines that end with LF, CR LF or CR.
class LineReader {
public:
    explicit LineReader(std::istream& stream) : mStream(stream) {}

    // False behind the last line.
    bool next(std::string& line);

private:
    std::istream& mStream;
    std::string mBlock;  // up to a LF
    std::size_t mAt = 1; // where its next line begins; past its end where there is none
};

} // namespace vdb_nns::cli
