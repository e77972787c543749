// Rows of one width that hold x, y and z as numbers of any type, each at its place: the bodies of binary
// files.
#pragma once

#include "io/array_readers.h"
#include "io/number_type.h"

#include <array>

namespace vdb_nns {

struct FixedColumn {
    std::size_t offset; // bytes from the beginning of a row
    NumberType type;
};

struct FixedRows {
    std::size_t begin; // byte of the file
    std::size_t rowBytes, count;
    std::array<FixedColumn, 3> columns; // x, y and z
    bool isBigEndian;
};

// Floats if all three are floats, else doubles. All rows have to lie inside of the file.
// Throws InputError where an integer is beyond 2^53, CapacityError where they do not fit.
PositionArray readFixedRows(const ArrayFile& file, const FixedRows& rows);

// One column as doubles: a real, or an integer of at most 32 bits.
std::vector<double> readFixedColumn(const ArrayFile& file, const FixedRows& rows, const FixedColumn& column);

// Throws InputError unless that many points can be numbered, CapacityError unless they fit the memory
// allowed, with so many numbers each.
void checkPointCount(const ArrayFile& file, std::uint64_t count, bool isDouble, std::size_t width = 3);

} // namespace vdb_nns
