#include "util/shown_text.h"

namespace vdb_nns {

std::string escapedText(std::string_view text, std::size_t most)
{
    constexpr const char* kDigits = "0123456789ABCDEF";
    std::string shown;
    for (const char c : text) {
        if (shown.size() >= most) return shown + "...";
        const auto code = static_cast<unsigned char>(c);
        if (code >= 32 && code < 127) {
            shown += c;
        } else if (c == '\t') {
            shown += "\\t";
        } else {
            shown += "\\x";
            shown += kDigits[code >> 4];
            shown += kDigits[code & 15];
        }
    }
    return shown;
}

} // namespace vdb_nns
