// Readers of the array formats: each turns the bytes of a whole file into positions, or throws an InputError
// that names the file, the place, what stood there, what is expected and the next step. They work on memory
// only (fuzz targets call them), trust no number of a header before it is held against the size of the file, and
// allocate nothing larger than a small multiple of it. NaN and infinite coordinates are legal data. Know
// nothing of OpenVDB.
#pragma once

#include "util/cancel.h"
#include "vdb_nns/point_file.h"
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

// What a caller chose where a file leaves a choice.
struct ArrayChoice {
    std::vector<std::uint32_t>
        columns;       // numbers of those that are x, y and z, from 0; empty: the reader's rule
    std::string array; // name of the array of an .npz; empty: the only one, or `positions`
};

// A file in memory, and what a reader is told about reading it.
struct ArrayFile {
    const std::string& path; // for messages
    FileBytes bytes;
    const ArrayChoice& choice;
    std::uint64_t allowedBytes; // that positions, and what is needed while they are read, may take
    const CancelCheck& cancel;
};

// A named value of each point, beside its position.
struct NamedValue {
    std::string name, type; // type: in the words of the file
};

// What a reader found.
struct ReadArray {
    PositionArray positions;
    std::vector<NamedValue>
        properties; // of a point, in the order of the file, x, y and z among them; of a .ply
    // Where they come from, for people: "columns 0, 1 and 2 of 6", "fields x, y and z", "array 'positions'". Empty where the
    // file leaves no choice.
    std::string taken;
    std::vector<std::string> notes; // what a person should look at: sentences without the file's name
};

// Where the values of an .npy file are that need no conversion: they are used in place.
struct NpyLayout {
    std::size_t dataOffset = 0; // bytes from the start of the file
    std::size_t count = 0;      // particles
    bool isDouble = false;
};

// NumPy's format, versions 1 to 3. https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
// Floats of 2, 4 and 8 bytes and integers, of either endianness and order: (N, 3), wider with columns, or structured with
// fields x, y and z. Not a byte more or less than the header says. True, with `layout`, where the values are those of
// little-endian floats of shape (N, 3) in C order; else `result` has them, converted.
bool parseNpy(const ArrayFile& file, NpyLayout& layout, ReadArray& result);

// A ZIP of .npy files, stored or deflated, as numpy.savez and numpy.savez_compressed write it.
ReadArray parseNpz(const ArrayFile& file);

// The values of an .npy of shape (N,) or (N, 1) with floats of 4 or 8 bytes, of either endianness. Throws InputError for
// others, and for another N than `count`.
std::vector<double> parseNpyValues(const ArrayFile& file, std::uint64_t count);

// What an .npy holds for each of so many points; only its header is looked at, and the values need not follow.
StoredValue describeNpyValues(const std::string& path, const std::string& name, FileBytes bytes,
                              std::uint64_t points);

// Reads the values of such an .npy, appends them as an attribute or a group.
void readNpyValues(const ArrayFile& file, const StoredValue& which, std::uint64_t points,
                   PointValues& values);

// Of all arrays but the one that the positions are read from.
std::vector<StoredValue> listNpzArrays(const ArrayFile& file, std::uint64_t points);
PointValues readNpzArrays(const ArrayFile& file, const std::vector<StoredValue>& which, std::uint64_t points);

// The Stanford polygon format: ascii, binary little-endian or big-endian; x y z of element `vertex` of any type of number.
// Other elements and properties, lists too, are walked over; behind whole vertices they may be damaged, and a note
// says so. http://paulbourke.net/dataformats/ply/
ReadArray parsePly(const ArrayFile& file);

// The values of one property of element `vertex`, of any type of number, each exactly as a double. Throws InvalidInput for
// a property that is not there, InputError for one that is a list or there twice, and where parsePly() does.
std::vector<double> parsePlyProperty(const ArrayFile& file, const std::string& name);

// How the properties of element `vertex` but x, y and z are read as values, from their declarations. Of files that have none:
// nothing.
std::vector<StoredValue> listPlyProperties(const std::vector<AttributeInfo>& properties);

// Throws where parsePlyProperty() does.
PointAttribute readPlyAttribute(const ArrayFile& file, const StoredValue& which);

// Text: the grammar stands beside the code.
ReadArray parseText(const ArrayFile& file);

// VTK's legacy format, versions 1.0 to 5.1: the POINTS of a data set that has some, ascii or binary. What follows the points
// is not needed and not read, but a section or the end of the file has to begin there.
// https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
ReadArray parseVtk(const ArrayFile& file);

// Houdini's classic .bgeo, version 5, plain or compressed with gzip: the points of the geometry, not divided by their weights.
// http://www.sidefx.com/docs/houdini/io/formats/geo.html
ReadArray parseBgeo(const ArrayFile& file);

// Throws the CapacityError of a file whose points need more than may be taken.
void checkPointsFit(const std::string& path, std::uint64_t neededBytes, std::uint64_t allowedBytes);

} // namespace vdb_nns
