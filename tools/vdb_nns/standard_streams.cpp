#include "standard_streams.h"

#include "vdb_nns/error.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

bool gStdoutWasClosed = false;

// The bytes of the UTF-8 character that text[at] begins, or 0: after Table 3-7 of the Unicode standard.
std::size_t characterBytes(const std::string& text, std::size_t at)
{
    const auto byte = [&](std::size_t k) {
        return at + k < text.size() ? static_cast<unsigned char>(text[at + k]) : 0;
    };
    const auto follows = [&](std::size_t k) { return (byte(k) & 0xC0) == 0x80; };
    const int first = byte(0), second = byte(1);
    if (first < 0x80) return 1;
    if (first >= 0xC2 && first <= 0xDF) return follows(1) ? 2 : 0;
    if (first >= 0xE0 && first <= 0xEF) {
        const bool isLong = first != 0xE0 || second >= 0xA0;     // no shorter form exists
        const bool isCharacter = first != 0xED || second < 0xA0; // no half of a UTF-16 pair
        return isLong && isCharacter && follows(1) && follows(2) ? 3 : 0;
    }
    if (first >= 0xF0 && first <= 0xF4) {
        const bool isLong = first != 0xF0 || second >= 0x90;
        const bool isInRange = first != 0xF4 || second < 0x90;
        return isLong && isInRange && follows(1) && follows(2) && follows(3) ? 4 : 0;
    }
    return 0;
}

bool isControl(const std::string& text, std::size_t at, std::size_t bytes)
{
    const auto first = static_cast<unsigned char>(text[at]);
    if (bytes == 1) return first < 0x20 || first == 0x7F;
    return bytes == 2 && first == 0xC2 && static_cast<unsigned char>(text[at + 1]) < 0xA0;
}

} // namespace

bool openStandardStreams()
{
    for (int descriptor = 0; descriptor <= 2; ++descriptor) {
        if (::fcntl(descriptor, F_GETFD) >= 0) continue;
        if (descriptor == STDOUT_FILENO) gStdoutWasClosed = true;
        if (::open("/dev/null", O_RDWR) == descriptor) continue; // the lowest number that is free
        std::perror("vdb_nns: error: /dev/null");
        return false;
    }
    return true;
}

std::string printable(const std::string& text)
{
    std::string out;
    for (std::size_t at = 0; at < text.size();) {
        const std::size_t bytes = characterBytes(text, at), taken = bytes > 0 ? bytes : 1;
        if (bytes > 0 && !isControl(text, at, bytes)) {
            out.append(text, at, bytes);
        } else {
            for (std::size_t k = at; k < at + taken; ++k) {
                char code[8];
                std::snprintf(code, sizeof code, "\\x%02X", static_cast<unsigned char>(text[k]));
                out += code;
            }
        }
        at += taken;
    }
    return out;
}

void say(const std::string& text)
{
    std::fprintf(stderr, "vdb_nns: %s\n", printable(text).c_str());
}

void requireStdout()
{
    if (!gStdoutWasClosed) return;
    throw OutputError(
        "standard output: is closed, and what was asked for goes there; open it, or write to a file");
}

void writeSummary(const std::string& lines)
{
    if (gStdoutWasClosed) return;
    std::string text;
    for (std::size_t begin = 0; begin < lines.size();) {
        const std::size_t end = std::min(lines.find('\n', begin), lines.size());
        text += printable(lines.substr(begin, end - begin)) + "\n";
        begin = end + 1;
    }
    writeStdout(text);
}

void writeStdout(const std::string& text)
{
    requireStdout();
    const bool written = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
    if (!written || std::fflush(stdout) != 0) {
        throw OutputError(std::string("standard output: cannot write: ") + std::strerror(errno));
    }
}

} // namespace vdb_nns::cli
