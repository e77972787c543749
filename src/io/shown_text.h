// Text of a file as messages show it.
#pragma once

#include <string>
#include <string_view>

namespace vdb_nns {

// At most 40 characters; control characters and what is no ASCII as \xHH, so that no file writes to the terminal.
inline std::string shownText(std::string_view text)
{
    constexpr std::size_t kMost = 40;
    constexpr const char* kDigits = "0123456789abcdef";
    std::string shown;
    for (const char c : text) {
        if (shown.size() >= kMost) return shown + "...";
        const auto code = static_cast<unsigned char>(c);
        if (code >= 32 && code < 127) {
            shown += c;
        } else if (c == '\t') {
            shown += "\\t";
        } else {
            shown += std::string("\\x") + kDigits[code >> 4] + kDigits[code & 15];
        }
    }
    return shown;
}

} // namespace vdb_nns
