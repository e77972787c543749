// Reads the .npz lists that verify checks: a SciPy CSR matrix in a stored ZIP, of which a small part is in
// memory at a time. Trusts nothing: every length, offset, type and checksum is tested before it is used, and
// a lie is an InputError. What the lists say about particles is not judged here but by independent_search.h.
// Knows the file format only.
#pragma once

#include "vdb_nns/progress.h"

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::cli {

// An open file of lists. Copies share it. Safe to read from several threads; each keeps a MB or two of what
// it read last.
class ListsFile {
public:
    // Accepts indptr and indices as int32 or int64, data as int8 or float32, in members of any order and
    // alignment.
    // Cost: one pass over the file for its checksums.
    // @throws InputError: no such file, not a ZIP, a member missing, double, compressed, outside the file or
    //         with a wrong CRC-32; a wrong type; a shape without the rows of indptr; row offsets that decrease or do not cover the
    //         indices
    // @throws Cancelled
    static ListsFile open(const std::string& path, const Progress* progress = nullptr);

    const std::string& path() const;
    std::uint64_t rowCount() const;
    std::uint64_t columnCount() const;
    std::uint64_t pairCount() const;

    // True: values are float32 distances; false: the int8 of a connectivity, which should be 1.
    bool holdsDistances() const;

    // A row as the file has it: numbers are not checked against the row count. The vectors are resized.
    // @throws InputError where the file has become shorter, or its row offsets have changed
    void readRow(std::uint64_t i, std::vector<std::int64_t>& neighbors, std::vector<float>& values) const;

    struct Data;

private:
    std::shared_ptr<const Data> mData;
};

} // namespace vdb_nns::cli
