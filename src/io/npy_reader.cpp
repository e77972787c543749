// The .npy reader: a header, and raw values behind it, which are positions in one of three ways: rows, columns one after the
// other (Fortran order), or records with fields.
#include "io/half_float.h"
#include "io/npy_header.h"
#include "io/number_type.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>

namespace vdb_nns {

namespace {

// Rows that a task converts.
constexpr std::size_t kTaskRows = std::size_t(1) << 16;

// Where the three coordinates of the first point are, in bytes from the first value, and how far it is to the next point.
struct Places {
    std::uint64_t rows = 0, stride = 0;
    std::uint64_t offset[3] = {};
    NpyType type[3];
    std::string taken;
};

[[noreturn]] void refuseType(const std::string& path, const std::string& descr)
{
    throw InputError(path + ": .npy dtype '" + shownText(descr) +
                     "' is not supported: floats of 16, 32 and 64 bits and integers are; save "
                     "positions.astype(numpy.float64)");
}

std::string list(const std::vector<std::string>& items)
{
    std::string text;
    for (std::size_t i = 0; i < items.size(); ++i)
        text += (i == 0 ? "" : i + 1 == items.size() ? " and " : ", ") + items[i];
    return text;
}

Places placesOfFields(const ArrayFile& file, const NpyHeader& header)
{
    const std::string& path = file.path;
    if (header.shape.size() != 1) {
        throw InputError(path + ": the .npy file holds records of shape " + npyShapeText(header.shape) +
                         ", not (N,); save positions.ravel()");
    }
    std::vector<std::string> names, taken;
    for (const NpyField& field : header.fields) names.push_back("'" + shownText(field.name) + "'");
    Places places;
    places.rows = header.shape[0];
    places.stride = header.itemBytes;
    for (std::size_t k = 0; k < 3; ++k) {
        std::size_t number = header.fields.size();
        if (!file.choice.columns.empty()) {
            number = file.choice.columns[k];
            if (number >= header.fields.size()) {
                throw InvalidInput(path + ": has no column " + std::to_string(number) +
                                   " (--columns): its records have " + std::to_string(header.fields.size()) +
                                   " fields, from 0: " + list(names));
            }
        } else {
            const std::string name(1, "xyz"[k]), capital(1, "XYZ"[k]);
            for (std::size_t i = 0; i < header.fields.size(); ++i) {
                const bool isCapital = header.fields[i].name == capital && number == header.fields.size();
                if (header.fields[i].name == name || isCapital) number = i;
            }
            if (number == header.fields.size()) {
                throw InputError(path + ": the records of the .npy file have no field '" + name + "', but " +
                                 list(names) + "; say which are x, y and z (--columns 0,1,2)");
            }
        }
        const NpyField& field = header.fields[number];
        if (field.isArray || !field.type.isNumber())
            refuseType(path, field.descr + (field.isArray ? " with a shape" : ""));
        places.offset[k] = field.offset;
        places.type[k] = field.type;
        taken.push_back(names[number]);
    }
    places.taken = "fields " + list(taken) + " of " + std::to_string(names.size());
    return places;
}

Places placesOfColumns(const ArrayFile& file, const NpyHeader& header)
{
    const std::string& path = file.path;
    if (!header.type.isNumber()) refuseType(path, header.descr);
    const std::vector<std::uint64_t>& shape = header.shape;
    const std::string is = path + ": .npy shape " + npyShapeText(shape) + " is not (N, 3)";
    if (shape.size() == 1) {
        throw InputError(is + (shape[0] % 3 == 0
                                   ? "; save positions.reshape(-1, 3) if it is x y z x y z ..."
                                   : "; positions need three coordinates: numpy.column_stack((x, y, z))"));
    }
    if (shape.size() == 3 && shape[2] == 3) {
        throw InputError(is +
                         "; save one frame, positions[0], or all of them as one, positions.reshape(-1, 3)");
    }
    if (shape.size() != 2) throw InputError(is + "; save an array of points with three coordinates each");
    const std::uint64_t width = shape[1];
    if (width < 3) {
        throw InputError(is + (shape[0] == 3 ? "; save positions.T" : "; positions need three coordinates"));
    }
    const std::vector<std::uint32_t>& columns = file.choice.columns;
    if (width > 3 && columns.empty()) {
        throw InputError(is + (shape[0] == 3 ? "; save positions.T, or, if its rows are points, " : "; ") +
                         "say which columns are x, y and z (--columns 0,1,2), or save positions[:, :3]" +
                         (width % 3 == 0 ? ", or positions[0].reshape(-1, 3) if each row is a frame" : ""));
    }
    Places places;
    places.rows = shape[0];
    places.stride = header.fortranOrder ? header.itemBytes : header.itemBytes * width;
    std::vector<std::string> taken;
    for (std::size_t k = 0; k < 3; ++k) {
        const std::uint64_t column = columns.empty() ? k : columns[k];
        if (column >= width) {
            throw InvalidInput(path + ": has no column " + std::to_string(column) + " (--columns): it has " +
                               std::to_string(width) + ", from 0");
        }
        places.offset[k] = column * (header.fortranOrder ? header.itemBytes * shape[0] : header.itemBytes);
        places.type[k] = header.type;
        taken.push_back(std::to_string(column));
    }
    if (!columns.empty()) places.taken = "columns " + list(taken) + " of " + std::to_string(width);
    return places;
}

// Converts one coordinate of rows [begin, end). Returns the first row whose integer is no double, or `end`.
template <typename Number, typename Real>
std::size_t convertAs(const unsigned char* first, std::uint64_t stride, bool isBigEndian, std::size_t begin,
                      std::size_t end, Real* out)
{
    std::size_t inexact = end;
    for (std::size_t row = begin; row < end; ++row) {
        const auto value = loadNumber<Number>(first + row * stride, isBigEndian);
        if (!isExactInDouble(value)) inexact = std::min(inexact, row);
        out[3 * row] = static_cast<Real>(value);
    }
    return inexact;
}

template <typename Real>
std::size_t convertHalves(const unsigned char* first, std::uint64_t stride, bool isBigEndian,
                          std::size_t begin, std::size_t end, Real* out)
{
    for (std::size_t row = begin; row < end; ++row)
        out[3 * row] = floatOfHalf(loadNumber<std::uint16_t>(first + row * stride, isBigEndian));
    return end;
}

template <typename Real>
std::size_t convertRows(const NpyType& type, const unsigned char* first, std::uint64_t stride,
                        std::size_t begin, std::size_t end, Real* out)
{
    const bool isBig = type.isBigEndian();
    const auto as = [&](auto number) {
        return convertAs<decltype(number)>(first, stride, isBig, begin, end, out);
    };
    if (type.kind == 'f') {
        if (type.bytes == 2) return convertHalves(first, stride, isBig, begin, end, out);
        return type.bytes == 4 ? as(float()) : as(double());
    }
    const bool isSigned = type.kind == 'i';
    switch (type.bytes) {
    case 1:
        return isSigned ? as(std::int8_t()) : as(std::uint8_t());
    case 2:
        return isSigned ? as(std::int16_t()) : as(std::uint16_t());
    case 4:
        return isSigned ? as(std::int32_t()) : as(std::uint32_t());
    default:
        return isSigned ? as(std::int64_t()) : as(std::uint64_t());
    }
}

template <typename Real>
void convert(const ArrayFile& file, const Places& places, const unsigned char* values, std::vector<Real>& out)
{
    const auto rows = static_cast<std::size_t>(places.rows);
    checkPointsFit(file.path, places.rows * 3 * sizeof(Real), file.allowedBytes);
    out.resize(3 * rows);
    std::atomic<std::size_t> inexact{rows};
    tbb::parallel_for(std::size_t(0), (rows + kTaskRows - 1) / kTaskRows, [&](std::size_t task) {
        file.cancel.check();
        const std::size_t begin = task * kTaskRows, end = std::min(rows, begin + kTaskRows);
        for (int k = 0; k < 3; ++k) {
            const std::size_t row = convertRows(places.type[k], values + places.offset[k], places.stride,
                                                begin, end, out.data() + k);
            std::size_t before = inexact;
            while (row < end && row < before && !inexact.compare_exchange_weak(before, row)) {
            }
        }
    });
    if (inexact < rows) {
        throw InputError(
            file.path + ": point " + std::to_string(inexact) +
            " has a coordinate beyond 2^53, which is no exact double; subtract an origin from the "
            "integers before they are saved");
    }
}

bool isInPlace(const Places& places)
{
    const NpyType& type = places.type[0];
    return type.kind == 'f' && type.bytes >= 4 && !type.isBigEndian() && places.stride == 3 * type.bytes &&
           places.offset[0] == 0 && places.offset[1] == type.bytes && places.offset[2] == 2 * type.bytes &&
           std::all_of(places.type, places.type + 3, [&](const NpyType& other) {
               return other.kind == 'f' && other.bytes == type.bytes && other.order == type.order;
           });
}

} // namespace

bool parseNpy(const ArrayFile& file, NpyLayout& layout, ReadArray& result)
{
    const NpyHeader header = readNpyHeader(file.path, file.bytes);
    const Places places =
        header.isStructured() ? placesOfFields(file, header) : placesOfColumns(file, header);
    checkNpySize(file.path, header, file.bytes.size() - header.dataOffset);
    if (places.rows > kMaxFilePoints) {
        throw InputError(file.path + ": " + std::to_string(places.rows) + " points are more than the " +
                         std::to_string(kMaxFilePoints) + " that fit; split the file");
    }
    result.taken = places.taken;
    if (isInPlace(places)) {
        layout.dataOffset = header.dataOffset;
        layout.count = static_cast<std::size_t>(places.rows);
        layout.isDouble = places.type[0].bytes == 8;
        return true;
    }
    const unsigned char* const values = file.bytes.data() + header.dataOffset;
    const bool areFloats = std::all_of(places.type, places.type + 3, [](const NpyType& type) {
        return type.kind == 'f' && type.bytes <= 4;
    });
    if (areFloats) {
        convert(file, places, values, result.positions.floats);
    } else {
        convert(file, places, values, result.positions.doubles);
    }
    return false;
}

std::vector<double> parseNpyValues(const ArrayFile& file, std::uint64_t count)
{
    const NpyHeader header = readNpyHeader(file.path, file.bytes);
    const NpyType& type = header.type;
    const std::vector<std::uint64_t>& shape = header.shape;
    const std::string expected = "; expected are " + std::to_string(count) +
                                 " floats of 4 or 8 bytes, shape (" + std::to_string(count) +
                                 ",), one for each point";
    if (header.isStructured() || !type.isFloat() || type.bytes < 4) {
        throw InputError(file.path + ": holds " +
                         (header.isStructured() ? "records" : "the dtype '" + shownText(header.descr) + "'") +
                         expected);
    }
    const bool isList = shape.size() == 1 || (shape.size() == 2 && shape[1] == 1);
    if (!isList) throw InputError(file.path + ": has the shape " + npyShapeText(shape) + expected);
    checkNpySize(file.path, header, file.bytes.size() - header.dataOffset);
    if (shape[0] != count) {
        throw InputError(file.path + ": has " + std::to_string(shape[0]) + " values, shape " +
                         npyShapeText(shape) + expected);
    }
    checkPointsFit(file.path, count * sizeof(double), file.allowedBytes);
    std::vector<double> values(static_cast<std::size_t>(count));
    const unsigned char* const first = file.bytes.data() + header.dataOffset;
    const bool isBig = type.isBigEndian();
    tbb::parallel_for(std::size_t(0), (values.size() + kTaskRows - 1) / kTaskRows, [&](std::size_t task) {
        file.cancel.check();
        const std::size_t end = std::min(values.size(), (task + 1) * kTaskRows);
        for (std::size_t i = task * kTaskRows; i < end; ++i) {
            values[i] = type.bytes == 4 ? double(loadNumber<float>(first + 4 * i, isBig))
                                        : loadNumber<double>(first + 8 * i, isBig);
        }
    });
    return values;
}

} // namespace vdb_nns
