// Readers of the array formats: each turns the bytes of a whole file into positions, or throws an InputError
// that names the file, the place, the number that broke and the next step. They work on memory only (fuzz
// targets call them), trust no number of a header before it is held against the size of the file, and
// allocate nothing larger than a small multiple of it. NaN and infinite coordinates are legal data. Know
// nothing of OpenVDB.
#pragma once

#include "util/cancel.h"
#include "vdb_nns/types.h"

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

namespace vdb_nns {

using FileBytes = Span<const unsigned char>;

constexpr std::uint64_t kAnyBytes = std::numeric_limits<std::uint64_t>::max();

// More positions than a particle number can count are refused by every reader.
constexpr std::uint64_t kMaxFilePoints = 0xFFFFFFFFu;

// x y z triples; one of the two is empty.
struct PositionArray {
    std::vector<float> floats;
    std::vector<double> doubles;

    std::size_t size() const { return (floats.size() + doubles.size()) / 3; }
};

// Where the values of an .npy file are: they are used in place.
struct NpyLayout {
    std::size_t dataOffset = 0; // bytes from the start of the file
    std::size_t count = 0;      // particles
    bool isDouble = false;
};

// NumPy's format, versions 1 to 3: little-endian f4 or f8, C order, shape (N, 3), and not a byte more or
// less. https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
NpyLayout parseNpy(const std::string& path, FileBytes bytes);

// The Stanford polygon format: ascii, binary little-endian or big-endian; x y z of element `vertex` as float
// or double. Other elements and properties, lists too, are walked over.
// http://paulbourke.net/dataformats/ply/
// Throws CapacityError where the positions take more than `allowedBytes`.
PositionArray parsePly(const std::string& path, FileBytes bytes, std::uint64_t allowedBytes = kAnyBytes,
                       const CancelCheck& cancel = {nullptr, "read"});

// Text, three numbers a line, more columns ignored; `#` starts a comment; blank lines are ignored. A first
// line of one integer (a particle count, as chemistry's .xyz has) is refused, since what follows it is then
// no list of positions. Throws CapacityError where reading the positions takes more than `allowedBytes`.
PositionArray parseXyz(const std::string& path, FileBytes bytes, std::uint64_t allowedBytes = kAnyBytes,
                       const CancelCheck& cancel = {nullptr, "read"});

// Throws the CapacityError of a file whose points need more than may be taken.
void checkPointsFit(const std::string& path, std::uint64_t neededBytes, std::uint64_t allowedBytes);

} // namespace vdb_nns
