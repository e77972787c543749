// Files of /proc and /sys that hold numbers.
#pragma once

#include <cstdint>
#include <fstream>
#include <string>

namespace vdb_nns {

// The number that the file begins with; `otherwise` where there is none.
inline std::uint64_t readNumber(const std::string& path, std::uint64_t otherwise)
{
    std::ifstream file(path);
    std::uint64_t value = 0;
    return file >> value ? value : otherwise;
}

} // namespace vdb_nns
