// Numbers as text, for messages.
#pragma once

#include <charconv>
#include <string>

namespace vdb_nns {

// The fewest digits that read back as the same double.
inline std::string shortest(double value)
{
    char text[32]; // 24 are enough for any double
    return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

} // namespace vdb_nns
