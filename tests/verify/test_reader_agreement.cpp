// Random files of each kind that are valid: the engine's reader and that of `verify`, which share no code,
// find what each file was made of.
#include "../support/array_file.h"
#include "../support/lists_writer.h"
#include "vdb_nns/point_file.h"
#include "verify/array_points.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <limits>
#include <random>

namespace vdb_nns::testing {

namespace {

using cli::Positions;

struct MadeFile {
    std::string bytes;
    Positions points;
    PointFileOptions options;
};

// A number as a file holds it.
struct MadeNumber {
    std::string raw;  // little-endian
    std::string text; // of which it is the nearest
    double value = 0;
};

class Maker {
public:
    explicit Maker(std::uint64_t seed) : mRandom(seed) {}

    // From 0 to count - 1.
    std::size_t below(std::size_t count)
    {
        return std::uniform_int_distribution<std::size_t>(0, count - 1)(mRandom);
    }
    bool flip() { return below(2) == 0; }
    template <std::size_t N>
    std::string oneOf(const char* const (&words)[N])
    {
        return words[below(N)];
    }

    // `type`: f2 f4 f8 or an integer's i1 to u8.
    MadeNumber number(const std::string& type)
    {
        const auto bytes = static_cast<unsigned>(type[1] - '0');
        if (type == "f2") return half();
        if (type == "f4") return real<float>("%.9g");
        if (type == "f8") return real<double>("%.17g");
        std::uint64_t bits = mRandom() >> (bytes == 8 ? 11 + below(40) : 64 - 8 * bytes);
        double value = static_cast<double>(bits);
        if (type[0] == 'i' && bytes == 8 && flip()) {
            bits = 0 - bits;
            value = -value;
        } else if (type[0] == 'i' && bytes < 8 && bits >> (8 * bytes - 1)) {
            value -= std::ldexp(1, static_cast<int>(8 * bytes));
        }
        char text[32];
        std::snprintf(text, sizeof text, "%.0f", value);
        return {std::string(reinterpret_cast<const char*>(&bits), bytes), text, value};
    }

    MadeNumber half()
    {
        const int fraction = static_cast<int>(below(1024)), exponent = static_cast<int>(below(31));
        const std::uint16_t sign = flip();
        const auto bits = static_cast<std::uint16_t>(sign << 15 | exponent << 10 | fraction);
        const double value =
            exponent ? std::ldexp(1 + fraction / 1024., exponent - 15) : std::ldexp(fraction / 1024., -14);
        return {std::string(reinterpret_cast<const char*>(&bits), 2), "", sign ? -value : value};
    }

    template <typename Real>
    MadeNumber real(const char* format)
    {
        Real value = static_cast<Real>(std::ldexp(std::uniform_real_distribution<double>(-1, 1)(mRandom),
                                                  static_cast<int>(below(60)) - 30));
        switch (below(40)) {
        case 0:
            value = std::numeric_limits<Real>::quiet_NaN();
            break;
        case 1:
            value = flip() ? std::numeric_limits<Real>::infinity() : -std::numeric_limits<Real>::infinity();
            break;
        case 2:
            value = flip() ? std::numeric_limits<Real>::denorm_min() : -std::numeric_limits<Real>::max();
            break;
        case 3:
            value = static_cast<Real>(below(10));
            break;
        default:
            break;
        }
        char text[64];
        std::snprintf(text, sizeof text, format, static_cast<double>(value));
        return {std::string(reinterpret_cast<const char*>(&value), sizeof value), text,
                static_cast<double>(value)};
    }

    std::vector<std::size_t> permutation(std::size_t count)
    {
        std::vector<std::size_t> order(count);
        for (std::size_t i = 0; i < count; ++i) order[i] = i;
        std::shuffle(order.begin(), order.end(), mRandom);
        return order;
    }

private:
    std::mt19937_64 mRandom;
};

std::string swapped(std::string raw)
{
    std::reverse(raw.begin(), raw.end());
    return raw;
}

const char* const kNumberTypes[] = {"f2", "f4", "f8", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"};

// ------------------------------------------------------------------------------------------------ text

std::string microsoftText(Maker& maker, const MadeNumber& number)
{
    if (std::isnan(number.value))
        return maker.oneOf({"1.#QNAN", "-1.#IND", "1.#QNAN00", "nan", "NaN", "-nan"});
    if (std::isinf(number.value))
        return std::string(number.value < 0 ? "-" : "") +
               maker.oneOf({"1.#INF", "1.#INF00", "inf", "Infinity"});
    return (number.value > 0 && maker.below(8) == 0 ? "+" : "") + number.text;
}

MadeFile makeText(Maker& maker)
{
    MadeFile file;
    const std::string lineEnd = maker.oneOf({"\n", "\r\n", "\r"});
    const std::string separator = maker.oneOf({" ", "\t", ",", ";"});
    const bool isBlank = separator == " " || separator == "\t";
    const std::string before = maker.oneOf({"", "", " "}), behind = maker.oneOf({"", " ", "\t "});
    const auto join = [&](const std::vector<std::string>& fields) {
        std::string line = maker.below(10) == 0 ? "  " : "";
        for (std::size_t i = 0; i < fields.size(); ++i)
            line += (i == 0 ? "" : isBlank ? separator + behind : before + separator + behind) + fields[i];
        return line;
    };
    const auto comment = [&] {
        return maker.below(4) == 0 ? maker.oneOf({"# a, b", "#", "", "  "}) + lineEnd : std::string();
    };

    const std::size_t rows = maker.below(40), extra = maker.below(4), width = 3 + extra;
    const bool isChemistry = isBlank && maker.below(4) == 0, hasNames = !isChemistry && maker.below(3) == 0;
    std::vector<std::size_t> place = {0, 1, 2}; // the columns of x, y and z
    if (maker.flip()) file.bytes += "\xEF\xBB\xBF";
    if (hasNames || (!isChemistry && maker.flip())) {
        place = maker.permutation(width);
        place.resize(3);
    }
    if (!isChemistry) file.bytes += comment();
    if (hasNames) {
        std::vector<std::string> names(width, "value");
        for (std::size_t k = 0; k < 3; ++k) {
            names[place[k]] = std::string(1, (maker.flip() ? "xyz" : "XYZ")[k]);
            if (maker.flip()) names[place[k]] = "\"" + names[place[k]] + "\"";
        }
        file.bytes += (maker.below(4) == 0 ? "//" : "") + join(names) + lineEnd + comment();
    } else if (!isChemistry) {
        file.options.columns.assign(place.begin(), place.end());
        if (place == std::vector<std::size_t>{0, 1, 2} && maker.flip()) file.options.columns.clear();
    }
    bool isAtomicNumber = false;
    if (isChemistry) {
        const bool hasProperties = maker.flip();
        isAtomicNumber = maker.flip();
        const std::string others = extra > 0 ? ":more:R:" + std::to_string(extra) : "";
        file.bytes += std::to_string(rows) + lineEnd +
                      (hasProperties ? "Lattice=\"1 0 0 0 1 0 0 0 1\" Properties=Z:I:1:pos:R:3" + others
                                     : "a molecule") +
                      lineEnd;
    } else if (maker.below(3) == 0) {
        // Behind a number that ends the text, or a blank line, chemistry would have its comment.
        file.bytes += std::to_string(rows) + lineEnd;
    }
    for (std::size_t row = 0; row < rows; ++row) {
        std::vector<std::string> fields(width);
        for (std::string& field : fields) field = maker.number("f4").text;
        for (std::size_t k = 0; k < 3; ++k) {
            const MadeNumber number = maker.number(maker.flip() ? "f8" : "i4");
            fields[place[k]] = microsoftText(maker, number);
            file.points.push_back(number.value);
        }
        if (isChemistry)
            fields.insert(fields.begin(),
                          isAtomicNumber ? maker.oneOf({"1", "6"}) : maker.oneOf({"H", "He", "C"}));
        file.bytes += join(fields) + (maker.below(9) == 0 && isBlank ? " # note" : "");
        if (row + 1 < rows || maker.flip()) file.bytes += lineEnd;
    }
    return file;
}

// ------------------------------------------------------------------------------------------------ npy

std::string npyBytes(Maker& maker, const std::string& descr, bool isFortran, const std::string& shape,
                     const std::string& values)
{
    std::string header = "{'descr': " + descr + ", 'fortran_order': " + (isFortran ? "True" : "False") +
                         ", 'shape': " + shape + ", }";
    header += std::string(maker.below(70), ' ') + "\n";
    const auto version = static_cast<char>(1 + maker.below(3));
    std::string bytes = std::string("\x93NUMPY") + version + '\0';
    for (int k = 0; k < (version == 1 ? 2 : 4); ++k) bytes += static_cast<char>(header.size() >> (8 * k));
    return bytes + header + values;
}

std::string orderedType(Maker& maker, const std::string& type, bool& isBig)
{
    isBig = type[1] != '1' && maker.flip();
    return (type[1] == '1' ? "'|" : isBig ? "'>" : "'<") + type + "'";
}

MadeFile makeNpyArray(Maker& maker)
{
    MadeFile file;
    const std::size_t rows = maker.below(40), width = 3 + (maker.flip() ? 0 : maker.below(4));
    const std::string type = maker.oneOf(kNumberTypes);
    bool isBig = false;
    const std::string descr = orderedType(maker, type, isBig);
    const bool isFortran = maker.flip();
    std::vector<std::size_t> place = {0, 1, 2};
    if (width > 3 || maker.flip()) {
        place = maker.permutation(width);
        place.resize(3);
        file.options.columns.assign(place.begin(), place.end());
    }
    std::vector<MadeNumber> numbers(rows * width);
    for (MadeNumber& number : numbers) number = maker.number(type);
    std::string values;
    for (std::size_t i = 0; i < numbers.size(); ++i) {
        const std::string& raw = numbers[isFortran ? i % rows * width + i / rows : i].raw;
        values += isBig ? swapped(raw) : raw;
    }
    for (std::size_t row = 0; row < rows; ++row) {
        for (const std::size_t column : place) file.points.push_back(numbers[row * width + column].value);
    }
    file.bytes = npyBytes(maker, descr, isFortran,
                          "(" + std::to_string(rows) + ", " + std::to_string(width) + ")", values);
    return file;
}

MadeFile makeNpyRecords(Maker& maker)
{
    MadeFile file;
    const std::size_t rows = maker.below(40), width = 3 + maker.below(4);
    const std::vector<std::size_t> order = maker.permutation(width); // the fields 0, 1 and 2 are x, y and z
    std::vector<std::string> types(width);
    std::vector<char> isBig(width);
    std::string descr = "[";
    for (const std::size_t field : order) {
        types[field] = maker.oneOf(kNumberTypes);
        bool big = false;
        const std::string text = orderedType(maker, types[field], big);
        isBig[field] = big;
        const std::string name = field < 3 ? std::string(1, "xyz"[field]) : "f" + std::to_string(field);
        descr += "('" + name + "', " + text + (field > 2 && maker.flip() ? ", (1,)" : "") + "), ";
    }
    std::string values;
    for (std::size_t row = 0; row < rows; ++row) {
        double point[3] = {};
        for (const std::size_t field : order) {
            const MadeNumber number = maker.number(types[field]);
            values += isBig[field] ? swapped(number.raw) : number.raw;
            if (field < 3) point[field] = number.value;
        }
        file.points.insert(file.points.end(), point, point + 3);
    }
    file.bytes = npyBytes(maker, descr + "]", maker.flip(), "(" + std::to_string(rows) + ",)", values);
    return file;
}

MadeFile makeNpz(Maker& maker)
{
    MadeFile file = maker.flip() ? makeNpyArray(maker) : makeNpyRecords(maker);
    Members members = {{"a.npy", file.bytes}};
    if (maker.flip()) {
        members.insert(maker.flip() ? members.begin() : members.end(), {"b.npy", makeNpyArray(maker).bytes});
        file.options.array = "a";
    }
    file.bytes = zipBytes(members);
    return file;
}

// ------------------------------------------------------------------------------------------------ ply

const std::array<const char*, 2> kPlyNames[] = {
    {{"char", "int8"}}, {{"uchar", "uint8"}}, {{"short", "int16"}},   {{"ushort", "uint16"}},
    {{"int", "int32"}}, {{"uint", "uint32"}}, {{"float", "float32"}}, {{"double", "float64"}}};
const char* const kPlyTypes[] = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"};

class PlyMaker {
public:
    explicit PlyMaker(Maker& maker) : mMaker(maker), mFormat(maker.below(3)) {}

    MadeFile make()
    {
        const std::string lineEnd = mMaker.oneOf({"\n", "\r\n"});
        mHeader = "ply" + lineEnd + comment(lineEnd) + "format " +
                  (const char*[]){"ascii", "binary_little_endian", "binary_big_endian"}[mFormat] + " 1.0" +
                  lineEnd;
        const std::size_t elements = 1 + mMaker.below(3), vertex = mMaker.below(elements);
        for (std::size_t i = 0; i < elements; ++i)
            addElement(i == vertex ? "vertex" : "e" + std::to_string(i), i == vertex, lineEnd);
        mFile.bytes = mHeader + "end_header" + lineEnd + mBody;
        return mFile;
    }

private:
    struct Property {
        std::string type;
        int coordinate = -1;
        bool isList = false;
    };

    std::string comment(const std::string& lineEnd)
    {
        return mMaker.below(3) == 0 ? "comment format x y z" + lineEnd : std::string();
    }

    void addElement(const std::string& name, bool isVertex, const std::string& lineEnd)
    {
        const std::size_t rows = mMaker.below(30),
                          width = isVertex ? 3 + mMaker.below(4) : 1 + mMaker.below(3);
        mHeader += "element " + name + " " + std::to_string(rows) + lineEnd + comment(lineEnd);
        std::vector<Property> properties;
        for (const std::size_t i : mMaker.permutation(width)) {
            const std::size_t type = mMaker.below(8);
            Property property{kPlyTypes[type], isVertex && i < 3 ? static_cast<int>(i) : -1, false};
            property.isList = property.coordinate < 0 && mMaker.below(3) == 0;
            mHeader += "property " + std::string(property.isList ? "list uchar " : "") +
                       kPlyNames[type][mMaker.below(2)] + " " +
                       (property.coordinate < 0 ? "p" + std::to_string(i)
                                                : std::string(1, "xyz"[property.coordinate])) +
                       lineEnd;
            properties.push_back(property);
        }
        for (std::size_t row = 0; row < rows; ++row) addRow(properties, isVertex, lineEnd);
    }

    void addRow(const std::vector<Property>& properties, bool isVertex, const std::string& lineEnd)
    {
        double point[3] = {};
        for (const Property& property : properties) {
            std::size_t values = 1;
            if (property.isList) {
                values = mMaker.below(4);
                add({std::string(1, static_cast<char>(values)), std::to_string(values), 0});
            }
            for (; values > 0; --values) {
                const MadeNumber number = mMaker.number(property.type);
                add(number);
                if (property.coordinate >= 0) point[property.coordinate] = number.value;
            }
        }
        if (mFormat == 0) mBody += lineEnd;
        if (isVertex) mFile.points.insert(mFile.points.end(), point, point + 3);
    }

    void add(const MadeNumber& number)
    {
        if (mFormat == 0) {
            mBody += number.text + mMaker.oneOf({" ", " ", "  ", "\t"});
        } else {
            mBody += mFormat == 1 ? number.raw : swapped(number.raw);
        }
    }

    Maker& mMaker;
    std::size_t mFormat; // ascii, little-endian, big-endian
    std::string mHeader, mBody;
    MadeFile mFile;
};

MadeFile makePly(Maker& maker)
{
    return PlyMaker(maker).make();
}

// ------------------------------------------------------------------------------------------------ vtk, bgeo

MadeFile makeVtk(Maker& maker)
{
    static const char* const kNames[] = {"char", "unsigned_char", "short", "unsigned_short",
                                         "int",  "unsigned_int",  "float", "double"};
    const bool isText = maker.flip();
    MadeFile file;
    file.bytes = std::string("# vtk DataFile Version 3.0\nPOINTS 1 float\n") + (isText ? "ASCII" : "BINARY") +
                 "\nDATASET " + maker.oneOf({"POLYDATA", "UNSTRUCTURED_GRID"}) + "\n";
    const auto addNumbers = [&](std::size_t count, const std::string& type, Positions* values) {
        for (; count > 0; --count) {
            const MadeNumber number = maker.number(type);
            file.bytes += isText ? number.text + maker.oneOf({" ", "\n", "  "}) : swapped(number.raw);
            if (values) values->push_back(number.value);
        }
        file.bytes += "\n";
    };
    if (maker.flip()) {
        const std::size_t arrays = maker.below(3);
        file.bytes += "FIELD FieldData " + std::to_string(arrays) + "\n";
        for (std::size_t i = 0; i < arrays; ++i) {
            const std::size_t components = 1 + maker.below(3), tuples = maker.below(5), type = maker.below(8);
            file.bytes += "a" + std::to_string(i) + " " + std::to_string(components) + " " +
                          std::to_string(tuples) + " " + kNames[type] + "\n";
            addNumbers(components * tuples, kPlyTypes[type], nullptr);
        }
    }
    const std::size_t rows = maker.below(40), type = maker.below(8);
    file.bytes += "POINTS " + std::to_string(rows) + " " + kNames[type] + "\n";
    addNumbers(3 * rows, kPlyTypes[type], &file.points);
    file.bytes += maker.oneOf({"", "POINT_DATA 0\n", "\nVERTICES 0 0\n"});
    return file;
}

MadeFile makeBgeo(Maker& maker)
{
    const auto big = [](std::uint64_t value, std::size_t bytes) {
        return swapped(std::string(reinterpret_cast<const char*>(&value), bytes));
    };
    MadeFile file;
    const std::size_t rows = maker.below(40), attributes = maker.below(4), primitives = maker.below(2);
    file.bytes = "BgeoV" + big(5, 4);
    for (const std::size_t count : {rows, primitives, std::size_t(0), std::size_t(0), attributes})
        file.bytes += big(count, 4);
    file.bytes += std::string(12, '\0');
    std::size_t values = 0;
    for (std::size_t i = 0; i < attributes; ++i) {
        const std::size_t type = (const std::size_t[]){0, 1, 4, 5}[maker.below(4)],
                          size = type == 4 ? 1 : 1 + maker.below(4);
        file.bytes += big(2, 2) + "a" + std::to_string(i) + big(size, 2) + big(type, 4);
        if (type == 4) {
            const std::size_t words = maker.below(3);
            file.bytes += big(words, 4);
            for (std::size_t word = 0; word < words; ++word) file.bytes += big(4, 2) + "word";
        } else {
            for (std::size_t k = 0; k < size; ++k) file.bytes += swapped(maker.number("f4").raw);
        }
        values += size;
    }
    for (std::size_t row = 0; row < rows; ++row) {
        for (std::size_t k = 0; k < 4 + values; ++k) {
            const MadeNumber number = maker.number("f4");
            file.bytes += swapped(number.raw);
            if (k < 3) file.points.push_back(number.value);
        }
    }
    file.bytes += primitives > 0 ? "a primitive" : maker.flip() ? std::string("\0\xff", 2) : "";
    return file;
}

// ------------------------------------------------------------------------------------------------ all kinds

Positions enginePositions(const std::string& path, const MadeFile& file)
{
    const ParticleView view = PointFile::read(path, file.options).view();
    Positions positions;
    for (std::size_t i = 0; i < view.size(); ++i) {
        const StoredPosition position = view.stored(i);
        positions.insert(positions.end(), position.offset, position.offset + 3);
    }
    return positions;
}

// The engine's reader of one format, without PointFile.
template <ReadArray (*kParse)(const ArrayFile&)>
Positions parsedPositions(const std::string& path, const MadeFile& file)
{
    const PositionArray array = readAs(path, bytesOf(file.bytes), kParse).positions;
    Positions positions(array.floats.begin(), array.floats.end());
    positions.insert(positions.end(), array.doubles.begin(), array.doubles.end());
    return positions;
}

// Both readers on 400 files. A failure prints the seed of the file, which then lies at the path.
// Of this process alone: several may run at once.
std::string scratchFile(const std::string& extension)
{
    return ::testing::TempDir() + "vdb_nns_agreement_" + std::to_string(getpid()) + "." + extension;
}

void expectAgreement(const std::string& extension, MadeFile (*make)(Maker&),
                     Positions (*readByEngine)(const std::string&, const MadeFile&) = enginePositions)
{
    const std::string path = scratchFile(extension);
    for (std::uint64_t seed = 0; seed < 400; ++seed) {
        SCOPED_TRACE(path + " of seed " + std::to_string(seed));
        Maker maker(seed);
        const MadeFile file = make(maker);
        writeBytes(path, file.bytes);
        Positions own, engine;
        ASSERT_NO_THROW(own = cli::readArrayPoints(path, file.options));
        ASSERT_NO_THROW(engine = readByEngine(path, file));
        const ParticleView made = ParticleView::fromArray(file.points.data(), file.points.size() / 3);
        ASSERT_EQ(cli::findDifference(path, made, own).value_or(""), "");
        ASSERT_EQ(cli::findDifference(path, made, engine).value_or(""), "");
    }
    std::filesystem::remove(path);
}

} // namespace

TEST(ReaderAgreement, Text)
{
    expectAgreement("xyz", makeText);
}

TEST(ReaderAgreement, Npy)
{
    expectAgreement("npy", makeNpyArray);
}

TEST(ReaderAgreement, NpyRecords)
{
    expectAgreement("npy", makeNpyRecords);
}

TEST(ReaderAgreement, Npz)
{
    expectAgreement("npz", makeNpz);
}

TEST(ReaderAgreement, Ply)
{
    expectAgreement("ply", makePly);
}

// Every property that is one number, where the engine's reader finds nothing wrong with its values.
TEST(ReaderAgreement, PlyProperties)
{
    const std::string path = scratchFile("ply");
    std::size_t compared = 0;
    for (std::uint64_t seed = 0; seed < 400; ++seed) {
        SCOPED_TRACE(path + " of seed " + std::to_string(seed));
        Maker maker(seed);
        writeBytes(path, makePly(maker).bytes);
        const PointFile file = PointFile::read(path);
        for (const AttributeInfo& property : file.info().attributes) {
            std::vector<double> engine, own;
            try {
                engine = file.readScalars(property.name);
            } catch (const InputError&) {
                continue;
            }
            ASSERT_NO_THROW(own = cli::readPlyScalars(path, property.name)) << property.name;
            ASSERT_EQ(cli::findDifference(path, engine, own).value_or(""), "") << property.name;
            ++compared;
        }
    }
    EXPECT_GT(compared, 1200U);
    std::filesystem::remove(path);
}

TEST(ReaderAgreement, RadiusFiles)
{
    const std::string path = scratchFile("npy");
    for (const std::string type : {"<f4", ">f4", "<f8", ">f8"}) {
        for (const std::string shape : {"(6,)", "(6, 1)"}) {
            const std::size_t bytes = type[2] == '4' ? 4 : 8;
            std::string values;
            for (std::size_t k = 0; k < 6 * bytes; ++k) values += static_cast<char>(k * k * 37 + 11);
            writeBytes(path, npyBytes(type, shape, values));
            const std::vector<double> engine = readRadiusFile(path, 6);
            ASSERT_EQ(engine.size(), 6U);
            EXPECT_EQ(cli::findDifference(path, engine, cli::readNpyNumbers(path)).value_or(""), "");
        }
    }
    for (const char* const lie : {"(2, 3)", "(7,)", "()"}) {
        writeBytes(path, npyBytes("<f4", lie, std::string(24, 'x')));
        EXPECT_THROW(cli::readNpyNumbers(path), InputError) << lie;
        EXPECT_THROW(readRadiusFile(path, 6), InputError) << lie;
    }
    writeBytes(path, npyBytes("<i4", "(6,)", std::string(24, 'x')));
    EXPECT_THROW(cli::readNpyNumbers(path), InputError);
    std::filesystem::remove(path);
}

TEST(ReaderAgreement, Vtk)
{
    expectAgreement("vtk", makeVtk, parsedPositions<parseVtk>);
}

TEST(ReaderAgreement, Bgeo)
{
    expectAgreement("bgeo", makeBgeo, parsedPositions<parseBgeo>);
}

} // namespace vdb_nns::testing
