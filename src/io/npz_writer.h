// How lists become an .npz file: the layout of the ZIP, and the rows that fill it. Knows no particles and no
// grid, so that tests can lay out files of any size and feed rows of their own.
#pragma once

#include "vdb_nns/point_file.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

// One array of the file: a stored ZIP member that holds an .npy, whose values start on a 64-byte boundary.
struct NpzMember {
    std::string name;      // "indptr.npy"
    std::string npyHeader; // a multiple of 64 bytes
    std::uint64_t valueBytes = 0;
    std::uint64_t localOffset = 0; // of its local header in the file
    std::uint64_t valueOffset = 0; // of its first value in the file
    std::uint32_t crc = 0;         // CRC-32 of header and values, known once they are written

    std::uint64_t bytes() const { return npyHeader.size() + valueBytes; }
};

// What stands before the values of an .npy: a multiple of 64 bytes. `shape` without its parentheses: "4, 3", "4,".
std::string npyHeader(const std::string& descr, const std::string& shape);

NpzMember npzMember(const std::string& name, const std::string& descr, const std::string& shape,
                    std::uint64_t valueBytes);

// Places members one after the other and returns where their directory begins.
std::uint64_t placeMembers(NpzMember* members, std::size_t count);

// What stands at that offset, to the end of the file. Of less than 65535 members.
std::string centralDirectory(const NpzMember* members, std::size_t count, std::uint64_t offset);

// All places are known before the first value is written.
struct NpzLayout {
    enum { kIndptr, kIndices, kData, kShape, kFormat, kMembers, kRows = kMembers, kPart, kMostMembers };
    NpzMember members[kMostMembers];
    std::size_t count = kMembers; // kMostMembers for a part
    std::uint64_t directoryOffset = 0;
    std::size_t indexBytes = 4; // of one value of `indices`: 4, or 8 past 2^31-1 columns
};

struct NpzShape {
    std::uint64_t rows, columns;
};
NpzLayout layoutNpz(const NpzShape& shape, std::uint64_t pairCount, ListValues values, bool isPart = false);

// What a part has besides: the numbers of its rows, and what it is of.
struct NpzPart {
    static constexpr std::size_t kValues = 5;
    const std::vector<std::uint32_t>& rows;
    std::uint64_t values[kValues];
};

// What stands at localOffset, up to valueOffset: the local file header, its padding and the .npy header.
std::string localHeader(const NpzMember& member);

// What stands at directoryOffset, to the end of the file.
std::string centralDirectory(const NpzLayout& layout);

// What the numbers of rows stand for. Called from several threads at once.
class RowGeometry {
public:
    virtual ~RowGeometry() = default;
    virtual double distance(std::size_t row, std::size_t neighbor) const = 0;
    // Puts the numbers of a row, which ascend, into the order of the file.
    virtual void order(std::size_t /*row*/, std::uint32_t* /*numbers*/, std::size_t /*count*/) const {}
};

// The lists to write. Called from several threads at once.
class NpzRows : public RowGeometry {
public:
    virtual std::size_t size() const = 0;
    virtual std::size_t columnCount() const { return size(); }
    virtual std::uint64_t pairCount() const = 0;
    virtual std::uint32_t count(std::size_t row) const = 0;
    // Writes the count(row) numbers of a row, in any order.
    virtual void copyRow(std::size_t row, std::uint32_t* out) const = 0;
};

// writeNpz() of point_file.h for rows of any origin.
void writeNpzRows(const std::string& path, const NpzRows& rows, const ListForm& form,
                  const OutputOptions& options, Progress* progress, const NpzPart* part = nullptr);

} // namespace vdb_nns
