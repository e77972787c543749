// Text of a file as messages show it: control characters and what is no ASCII as \xHH, so that no file writes to the terminal.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace vdb_nns {

// At most so many characters.
std::string escapedText(std::string_view text, std::size_t most = std::string_view::npos);

// The first 40 characters.
inline std::string shownText(std::string_view text)
{
    return escapedText(text, 40);
}

} // namespace vdb_nns
