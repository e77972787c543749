// The reader of legacy .vtk files, byte by byte.
#include "support/array_file.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

ReadArray readVtk(const std::string& file)
{
    return readAs("a.vtk", bytesOf(file), parseVtk);
}

std::string vtkHead(const std::string& format, const std::string& dataset, const std::string& version = "3.0")
{
    return "# vtk DataFile Version " + version + "\nmade by a test\n" + format + "\nDATASET " + dataset +
           "\n";
}

template <typename Number>
std::string big(const std::vector<Number>& values)
{
    return rawValues<Number>(values, true);
}

TEST(VtkReader, readsText)
{
    for (const char* const dataset : {"POLYDATA", "UNSTRUCTURED_GRID", "polydata"}) {
        for (const char* const version : {"1.0", "2.0", "3.0", "4.2", "5.1"}) {
            const ReadArray read =
                readVtk(vtkHead("ASCII", dataset, version) +
                        "POINTS 3 float\n0.1 2 3 4\n5 6\r\n\n-7e1 nan 1.#INF\nVERTICES 1 2\n1 0\n");
            ASSERT_EQ(read.positions.floats.size(), 9u);
            EXPECT_EQ(read.positions.floats[0], 0.1f);
            EXPECT_EQ(read.positions.floats[6], -70);
            EXPECT_TRUE(std::isnan(read.positions.floats[7]));
            EXPECT_EQ(read.positions.floats[8], HUGE_VALF);
            EXPECT_EQ(read.taken, "");
        }
    }
    EXPECT_EQ(readVtk(vtkHead("ascii", "POLYDATA") + "points 1 DOUBLE 0.1 1e-400 3").positions.doubles,
              (std::vector<double>{0.1, 0, 3}));
    const ReadArray ints = readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 1 unsigned_char\n255 0 7\n");
    EXPECT_EQ(ints.positions.doubles, (std::vector<double>{255, 0, 7}));
    EXPECT_EQ(ints.taken, "POINTS of type unsigned_char");
    EXPECT_EQ(readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 0 float\n").positions.size(), 0u);
    EXPECT_EQ(readVtk(vtkHead("ASCII", "STRUCTURED_GRID") +
                      "DIMENSIONS 1 1 2\nPOINTS 2 int\n1 2 3\n4 5 6\nPOINT_DATA 2\n")
                  .positions.doubles,
              (std::vector<double>{1, 2, 3, 4, 5, 6}));
    EXPECT_EQ(
        readVtk("# vtk DataFile Version 3.0\r\nt\r\nASCII\r\nDATASET POLYDATA\r\nPOINTS 1 float\r\n1 2 3\r\n")
            .positions.floats,
        (std::vector<float>{1, 2, 3}));
}

template <typename Number>
void checkBinary(const std::string& type, const std::vector<Number>& values)
{
    const std::vector<double> expected(values.begin(), values.end());
    for (const char* const behind :
         {"", "\n", "\nMETADATA\nINFORMATION 0\n\n", "\nCELLS 1 2\n\1\2\3", "\n\nPOINT_DATA 1\n"}) {
        const ReadArray read =
            readVtk(vtkHead("BINARY", "UNSTRUCTURED_GRID") + "POINTS " + std::to_string(values.size() / 3) +
                    " " + type + "\n" + big(values) + behind);
        const std::vector<double> floats(read.positions.floats.begin(), read.positions.floats.end());
        EXPECT_EQ(type == "float" ? floats : read.positions.doubles, expected) << type << behind;
    }
}

TEST(VtkReader, readsEveryTypeOfBinaryNumber)
{
    checkBinary<float>("float", {0.1f, 2, -3, 4, 5, 6});
    checkBinary<double>("double", {0.1, 1e300, -3});
    checkBinary<std::int8_t>("char", {-128, 127, 0});
    checkBinary<std::int8_t>("signed_char", {-128, 127, 0});
    checkBinary<std::uint8_t>("unsigned_char", {255, 1, 0});
    checkBinary<std::int16_t>("short", {-32768, 32767, 0});
    checkBinary<std::uint16_t>("unsigned_short", {65535, 1, 0});
    checkBinary<std::int32_t>("int", {-2147483647, 2147483647, 0});
    checkBinary<std::uint32_t>("unsigned_int", {4294967295u, 1, 0});
    checkBinary<std::int32_t>("vtkIdType", {-5, 6, 7});
    const std::int64_t most = std::int64_t(1) << 53;
    checkBinary<std::int64_t>("vtktypeint64", {-most, most, 0, 1, 2, 3});
    checkBinary<std::uint64_t>("vtktypeuint64", {std::uint64_t(most), 1, 0});
    checkBinary<std::int64_t>("long", {-most, most, 0, 1, 2, 3});
    checkBinary<std::uint64_t>("unsigned_long", {std::uint64_t(most), 1, 0});
    // As Windows writes it.
    checkBinary<std::int32_t>("long", {-7, 8, 9, 1, 2, 3});
    checkBinary<std::uint32_t>("unsigned_long", {4294967295u, 8, 9});
    EXPECT_ERROR(readVtk(vtkHead("BINARY", "POLYDATA") + "POINTS 1 vtktypeint64\n" +
                         big<std::int64_t>({1, most + 1, 3})),
                 "the y of point 0 at byte 96 is an integer beyond 2^53");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 1 vtktypeint64\n1 2 -9007199254740993"),
                 "beyond 2^53");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 1 vtktypeuint64\n1 2 18446744073709551615"),
                 "beyond 2^53");
}

TEST(VtkReader, walksOverSectionsBeforeThePoints)
{
    const std::vector<float> expected{1, 2, 3, 4, 5, 6};
    const std::string points = "\nPOINTS 2 float\n" + big(expected);
    const std::string head = vtkHead("BINARY", "POLYDATA", "5.1");
    const auto check = [&](const std::string& before) {
        EXPECT_EQ(readVtk(head + before + points).positions.floats, expected) << before;
    };
    check("FIELD FieldData 1\nTIME 1 1 double\n" + big<double>({0.25}));
    check("FIELD FieldData 1\nTIME 1 1 double\n" + big<double>({0.25}) + "\nMETADATA\nINFORMATION 0\n\n");
    check("FIELD f 2\na 3 2 int\n" + std::string(24, 'P') +
          "\nMETADATA\nCOMPONENT_NAMES\nX\nY\n\nb 1 9 bit\nxy\n");
    check("FIELD f 2\ns 1 3 string\n" + std::string("\xC3") + "abc" + "\xC0" + std::string("\x80\x02zz") +
          "\nt 1 1 char\nP");
    check("FIELD f 2\nNULL_ARRAY\na 1 1 short\nPO");
    check("VERTICES 2 4\n" + std::string(16, 'P') + "\nLINES 1 3\n" + std::string(12, 'Q'));
    check("VERTICES 3 2\nOFFSETS vtktypeint64\n" + std::string(24, 'P') + "\nCONNECTIVITY vtktypeint64\n" +
          std::string(16, 'Q'));
    check("CELLS 1 2\n" + std::string(8, '\n') + "\nCELL_TYPES 1\n" + std::string(4, '\1'));

    const auto text = [](const std::string& before) {
        return readVtk(vtkHead("ASCII", "POLYDATA", "5.1") + before + "POINTS 1 int\n1 2 3\n")
            .positions.doubles;
    };
    for (const char* const before :
         {"FIELD FieldData 1\nTIME 1 1 double\n0.25\nMETADATA\nINFORMATION 0\n\n",
          "FIELD f 1\ns 1 2 string\nPOINTS%20x\n\n", "VERTICES 1 2\n1 0\n",
          "VERTICES 2 1\nOFFSETS vtktypeint64\n0 1\nCONNECTIVITY vtktypeint64\n0\n", "\n\n"}) {
        EXPECT_EQ(text(before), (std::vector<double>{1, 2, 3})) << before;
    }
    EXPECT_ERROR(text("FIELD f 1\na 1 1 variant\n1\n"), "variant");
    EXPECT_ERROR(text("POINT_DATA 1\n"), "found 'point_data'");
}

TEST(VtkReader, refusesOtherFiles)
{
    EXPECT_ERROR(readVtk(""), "not a legacy .vtk file");
    EXPECT_ERROR(readVtk("<VTKFile type=\"PolyData\">\n"), "meshio");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA", "6.0") + "POINTS 0 float\n"), "version '6.0'");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA", "x") + "POINTS 0 float\n"), "version 'x'");
    EXPECT_ERROR(readVtk(vtkHead("UTF8", "POLYDATA")), "expected ASCII or BINARY, found 'utf8'");
    for (const char* const grid : {"STRUCTURED_POINTS", "RECTILINEAR_GRID"})
        EXPECT_ERROR(readVtk(vtkHead("ASCII", grid)),
                     "DATASET " + std::string(grid) + " says its points by axes");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "TABLE")), "DATASET TABLE is none of");
    EXPECT_ERROR(readVtk("# vtk DataFile Version 3.0\nt\nASCII\nFIELD f 0\n"),
                 "holds a FIELD and no data set");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA")), "there are no POINTS");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 1 bit\n1 1 1"), "type 'bit'");
    EXPECT_ERROR(readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS x float\n"), "expected a count, found 'x'");
    EXPECT_ERROR(readVtk(vtkHead("BINARY", "POLYDATA") + "POINTS 1 float x\n"), "expected the end of a line");
    const std::string file = vtkHead("ASCII", "POLYDATA") + "POINTS 1 float\n1 2 3\n";
    EXPECT_THROW(readAs("a.vtk", bytesOf(file), parseVtk, {}, 11), CapacityError);
}

TEST(VtkReader, refusesLies)
{
    const std::string binary = vtkHead("BINARY", "POLYDATA");
    const std::string values = big<float>({1, 2, 3, 4, 5, 6});
    EXPECT_ERROR(readVtk(binary + "POINTS 3 float\n" + values),
                 "only 24 bytes follow; the file is truncated");
    EXPECT_ERROR(readVtk(binary + "POINTS 18446744073709551615 float\n" + values),
                 "promises 18446744073709551615");
    EXPECT_ERROR(readVtk(binary + "POINTS 18446744073709551615 long\n" + values), "truncated");
    EXPECT_ERROR(readVtk(binary + "POINTS 1 float\n" + values), "12 bytes are left over");
    EXPECT_ERROR(readVtk(binary + "POINTS 2 float\n" + values + "\n7\n"), "3 bytes are left over");
    EXPECT_ERROR(readVtk(binary + "FIELD f 1\na 18446744073709551615 2 int\n"), "truncated");
    EXPECT_ERROR(readVtk(binary + "FIELD f 18446744073709551615\n"), "truncated");
    EXPECT_ERROR(readVtk(binary + "FIELD f 1\ns 1 1 string\n\1"), "truncated");
    EXPECT_ERROR(readVtk(binary + "CELLS 1 18446744073709551615\n"), "truncated");

    const auto text = [](const std::string& values) {
        return readVtk(vtkHead("ASCII", "POLYDATA") + "POINTS 2 float\n" + values);
    };
    EXPECT_EQ(text("1 2 3 4 5 6\n").positions.size(), 2u);
    EXPECT_ERROR(text("1 2 3 4 5\n"), "promises 2 points, but only 5 values follow");
    EXPECT_ERROR(text("1 2 3 4 5\nVERTICES 1 2\n1 0\n"),
                 "'VERTICES' is not a number; it stands in the place of value 6 of the 6");
    EXPECT_ERROR(text("1 2 3 4 5 6\n7 8 9\n"),
                 "damaged or unsupported .vtk at byte 92: '7' stands behind the 6 values");
    EXPECT_ERROR(text("1 2 3 4 5 6 nan\n"), "'nan' stands behind");
    EXPECT_ERROR(text("1 2 3 4 5 6 infinity\n"), "'infinity' stands behind");
    EXPECT_ERROR(text("1 2 3 4,5 6 7\n"), "'4,5' is not a number");
    EXPECT_ERROR(text("1 2 3 1e39 5 6\n"), "'1e39' is beyond its type's range");
    EXPECT_ERROR(text("1 2 3 1.#QNANx 5 6\n"), "is not a number");
}

TEST(VtkReader, readsTextInChunks)
{
    constexpr int kPoints = 200000;
    std::string values;
    for (int i = 0; i < 3 * kPoints; ++i) values += std::to_string(i) + (i % 10 ? " " : "\n");
    const std::string head = vtkHead("ASCII", "POLYDATA") + "POINTS " + std::to_string(kPoints) + " double\n";
    const std::vector<double> read = readVtk(head + values + "\nVERTICES 1 2\n1 0\n").positions.doubles;
    ASSERT_EQ(read.size(), 3u * kPoints);
    for (std::size_t i = 0; i < read.size(); ++i) ASSERT_EQ(read[i], static_cast<double>(i));
    EXPECT_ERROR(readVtk(head + values + "7"), "stands behind the 600000 values");
}

// Random files, as they were made.
TEST(VtkReader, readsAnyValidFile)
{
    for (unsigned seed = 0; seed < 2000; ++seed) {
        std::mt19937 random(seed);
        const auto below = [&](unsigned limit) { return random() % limit; };
        const bool isBinary = below(2), isDouble = below(2);
        const std::size_t points = below(30);
        std::vector<double> doubles(3 * points);
        std::string text, file = vtkHead(isBinary ? "BINARY" : "ASCII", "POLYDATA", below(2) ? "3.0" : "5.1");
        for (double& value : doubles) {
            const float single = static_cast<float>(random()) * 1e-5f - 7;
            value = isDouble ? random() * 1e-9 : single;
            char number[40];
            std::snprintf(number, sizeof number, "%.17g%c", value, " \n\t"[below(3)]);
            text += number;
        }
        for (unsigned fields = below(3); fields > 0; --fields) {
            const std::size_t tuples = below(5);
            file += "FIELD f 1\nname 2 " + std::to_string(tuples) + " unsigned_short\n";
            for (std::size_t i = 0; i < 2 * tuples; ++i)
                file += isBinary ? std::string(2, static_cast<char>(random())) : "7 ";
            file += "\n";
            if (below(2)) file += "METADATA\nINFORMATION 1\nNAME x LOCATION y\nDATA 1\n\n";
        }
        file += "POINTS " + std::to_string(points) + (isDouble ? " double\n" : " float\n");
        const std::vector<float> floats(doubles.begin(), doubles.end());
        file += !isBinary ? text : isDouble ? big(doubles) : big(floats);
        const std::string behind = below(2)   ? "\nVERTICES 1 2\n" + std::string(8, '\0')
                                   : below(2) ? "\n"
                                              : "";
        const PositionArray read = readVtk(file + behind).positions;
        ASSERT_EQ(read.doubles, isDouble ? doubles : std::vector<double>{}) << "seed " << seed;
        ASSERT_EQ(read.floats, isDouble ? std::vector<float>{} : floats) << "seed " << seed;
        ASSERT_NE(errorOf([&] { readVtk(file + " 7\n"); }), "") << "seed " << seed;
    }
}

} // namespace
} // namespace vdb_nns
