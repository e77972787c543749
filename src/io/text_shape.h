// What the head of a text says of its rows.
#pragma once

#include "io/array_readers.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

struct TextShape {
    const char* begin = nullptr; // of the first row
    const char* end = nullptr;   // behind the last one
    char separator = ' ';        // ' ': blanks and tabs
    std::size_t width = 0;       // fields of a row; 0 where there is none
    std::uint32_t columns[3] = {0, 1, 2};
    std::optional<std::uint64_t> count; // of rows, where a line says it
    std::size_t countLine = 0;          // which one, from 1
    std::string taken;
    std::vector<std::string> notes;
};

// @throws InputError for a head that is no text of rows, InvalidInput for chosen columns that it does not have
TextShape findTextShape(const ArrayFile& file);

} // namespace vdb_nns
