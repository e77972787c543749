// The .ply reader, byte by byte: what is read, and what every lie of a header gets.
#include "support/array_file.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

ReadArray readPly(const std::string& file)
{
    return readAs("a.ply", bytesOf(file), parsePly);
}

PositionArray parsedPly(const std::string& file)
{
    return readPly(file).positions;
}

std::vector<double> propertyOf(const std::string& file, const std::string& name)
{
    return readAs("a.ply", bytesOf(file),
                  [&](const ArrayFile& array) { return parsePlyProperty(array, name); });
}

std::string plyHeader(const std::string& format, const std::string& elements)
{
    return "ply\nformat " + format + " 1.0\ncomment made by a test\n" + elements + "end_header\n";
}

const std::string kThreeFloats = "property float x\nproperty float y\nproperty float z\n";

TEST(PlyReader, readsText)
{
    const PositionArray floats = parsedPly(plyHeader("ascii", "element vertex 3\n" + kThreeFloats) +
                                           "0.1 +2 -3e4\nnan inf 1e-60\n\n\t7\t8   9\r\n \r\n");
    ASSERT_EQ(floats.floats.size(), 9u);
    EXPECT_EQ(floats.floats[0], 0.1f);
    EXPECT_EQ(floats.floats[2], -3e4f);
    EXPECT_TRUE(std::isnan(floats.floats[3]));
    EXPECT_TRUE(std::isinf(floats.floats[4]));
    EXPECT_EQ(floats.floats[5], 0);
    EXPECT_EQ(floats.floats[8], 9);

    // Other elements and properties around, lists among them; one double makes all of them doubles, exactly.
    const PositionArray doubles = parsedPly(
        plyHeader("ascii",
                  "element before 2\nproperty list uchar int a\nproperty int b\nelement vertex 2\n"
                  "property uchar red\nproperty double z\nproperty list int float w\nproperty float x\n"
                  "property float64 y\nelement face 1\nproperty list uchar int vertex_indices\n") +
        "2 7 7 1\n0 2\n255 0.1 0 0.1 0.2\n0 4 3 1 2 3 5 6\n3 0 1 2\n");
    EXPECT_EQ(doubles.doubles, (std::vector<double>{0.1f, 0.2, 0.1, 5, 6, 4}));
    EXPECT_EQ(doubles.size(), 2u);
}

TEST(PlyReader, readsBothByteOrders)
{
    for (const bool isBig : {false, true}) {
        const std::string format = isBig ? "binary_big_endian" : "binary_little_endian";
        EXPECT_EQ(parsedPly(plyHeader(format, "element vertex 2\n" + kThreeFloats) +
                            rawValues<float>({1, 2, 3, 4, 5, 0.1f}, isBig))
                      .floats,
                  (std::vector<float>{1, 2, 3, 4, 5, 0.1f}));

        std::string file =
            plyHeader(format, "element skipped 2\nproperty short a\nproperty list uint16 double b\n"
                              "element fixed 3\nproperty int8 c\nproperty uint32 d\n"
                              "element vertex 1\nproperty double y\nproperty list uchar char l\n"
                              "property double x\nproperty double z\n"
                              "element face 1\nproperty list int32 int i\n");
        file += rawValues<std::int16_t>({-5}, isBig) + rawValues<std::uint16_t>({2}, isBig) +
                rawValues<double>({1, 2}, isBig);
        file += rawValues<std::int16_t>({-5}, isBig) + rawValues<std::uint16_t>({0}, isBig);
        file += std::string(15, 'f');
        file += rawValues<double>({0.2}, isBig) + '\x03' + "abc" + rawValues<double>({0.1, 0.3}, isBig);
        file += rawValues<std::int32_t>({1, 0}, isBig);
        EXPECT_EQ(parsedPly(file).doubles, (std::vector<double>{0.1, 0.2, 0.3}));
    }
}

TEST(PlyReader, refusesOtherFiles)
{
    EXPECT_ERROR(parsedPly(""), "end_header");
    EXPECT_ERROR(parsedPly("plyer\n"), "is not a .ply file: its first line is not 'ply' but 'plyer'");
    EXPECT_ERROR(parsedPly("ply\nformat ascii 2.0\nend_header\n"), "'2.0' is not 1.0");
    EXPECT_ERROR(parsedPly("ply\nformat binary 1.0\nend_header\n"), "format 'binary'");
    EXPECT_ERROR(parsedPly("ply\nformat ascii 1.0\nend_header\n"), "no element 'vertex'");
    const auto withHeader = [](const std::string& elements) {
        return parsedPly(plyHeader("ascii", elements) + "1 2 3 4\n");
    };
    EXPECT_ERROR(withHeader("element vertex 1\nproperty float x\nproperty float y\n"), "no property 'z'");
    EXPECT_ERROR(
        withHeader("element vertex 1\nproperty list int float x\nproperty float y\nproperty float z\n"),
        "'x' is a list");
    EXPECT_ERROR(withHeader("element vertex 1\n" + kThreeFloats + "property float x\n"),
                 "'x' is there twice");
    EXPECT_ERROR(withHeader("property float x\n"), "before any element");
    EXPECT_ERROR(withHeader("element vertex 1\n" + kThreeFloats + "element vertex 1\n"),
                 "'vertex' is there twice");
    EXPECT_ERROR(withHeader("element vertex 1\nproperty half x\n"), "type 'half'");
    EXPECT_ERROR(withHeader("element vertex 1\nproperty list float int x\n"), "length of a list");
    EXPECT_ERROR(withHeader("element vertex -1\n" + kThreeFloats), "count '-1'");
    EXPECT_ERROR(withHeader("element vertex 18446744073709551616\n" + kThreeFloats),
                 "count '18446744073709551616'");
    EXPECT_ERROR(withHeader("element vertex\n" + kThreeFloats), "expected 'element");
    EXPECT_ERROR(withHeader("vertices 5\n"), "'vertices' is unknown");
}

TEST(PlyReader, refusesLies)
{
    const std::string values = rawValues<float>({1, 2, 3});
    const auto binary = [&](const std::string& elements) {
        return parsedPly(plyHeader("binary_little_endian", elements) + values);
    };
    EXPECT_ERROR(binary("element vertex 2\n" + kThreeFloats), "promises 2 of element 'vertex'");
    EXPECT_ERROR(binary("element vertex 18446744073709551615\n" + kThreeFloats),
                 "promises 18446744073709551615");
    EXPECT_ERROR(binary("element vertex 1537228672809129302\n" + kThreeFloats), "promises");
    EXPECT_ERROR(binary("element a 9223372036854775807\nproperty int a\nelement vertex 1\n" + kThreeFloats),
                 "truncated");
    // The length of a list, 0x3f800000 or negative.
    EXPECT_ERROR(binary("element a 1\nproperty list uint double b\nelement vertex 0\n" + kThreeFloats),
                 "truncated");
    std::string negative = plyHeader(
        "binary_little_endian", "element a 1\nproperty list int int b\nelement vertex 0\n" + kThreeFloats);
    EXPECT_ERROR(parsedPly(negative + "\xff\xff\xff\xff"), "negative");

    const auto text = [&](const std::string& elements, const std::string& rows) {
        return parsedPly(plyHeader("ascii", elements) + rows);
    };
    EXPECT_ERROR(text("element vertex 2\n" + kThreeFloats, "1 2 3\n4 5     "), "truncated");
    EXPECT_ERROR(text("element vertex 1\n" + kThreeFloats, "1 2 y"), "'y' is not a number");
    EXPECT_ERROR(text("element vertex 1\n" + kThreeFloats, "1 2 3,5"), "'3,5' is not a number");
    EXPECT_ERROR(text("element vertex 1\n" + kThreeFloats, "1 2 1e39"), "range");
    EXPECT_ERROR(text("element vertex 1000000000000\n" + kThreeFloats, "1 2 3\n"), "promises 1000000000000");
    EXPECT_ERROR(text("element a 1\nproperty list int int b\nelement vertex 0\n" + kThreeFloats, "-1"),
                 "'-1'");
    EXPECT_ERROR(
        text("element a 1\nproperty list int int b\nelement vertex 0\n" + kThreeFloats, "99999999999999 1"),
        "has 2 values: '99999999999999 1'");
    // An element without properties has no rows, however many it claims.
    EXPECT_EQ(text("element a 18446744073709551615\nelement vertex 1\n" + kThreeFloats, "1 2 3").size(), 1u);
}

TEST(PlyReader, readsAnyTypeOfNumber)
{
    const ReadArray text =
        readPly(plyHeader("ascii", "element vertex 2\nproperty int x\nproperty uchar y\nproperty short z\n") +
                "2147483647 255 -32768\n-2147483648 0 +7\n");
    EXPECT_EQ(text.positions.doubles, (std::vector<double>{2147483647, 255, -32768, -2147483648.0, 0, 7}));
    EXPECT_EQ(text.taken, "properties x, y and z of types int, uchar and short");
    for (const bool isBig : {false, true}) {
        const std::string format = isBig ? "binary_big_endian" : "binary_little_endian";
        const ReadArray ints = readPly(
            plyHeader(format, "element vertex 1\nproperty uint z\nproperty uint32 x\nproperty uint y\n") +
            rawValues<std::uint32_t>({1, 4294967295u, 3}, isBig));
        EXPECT_EQ(ints.positions.doubles, (std::vector<double>{4294967295.0, 3, 1}));
        EXPECT_EQ(ints.taken, "properties x, y and z of type uint");
        const ReadArray mixed = readPly(
            plyHeader(format, "element vertex 1\nproperty char x\nproperty double y\nproperty ushort z\n") +
            "\xff" + rawValues<double>({0.1}, isBig) + rawValues<std::uint16_t>({65535}, isBig));
        EXPECT_EQ(mixed.positions.doubles, (std::vector<double>{-1, 0.1, 65535}));
    }
    EXPECT_EQ(readPly(plyHeader("ascii", "element vertex 1\n" + kThreeFloats) + "1 2 3").taken, "");
    const auto ints = [](const std::string& row) {
        return parsedPly(
            plyHeader("ascii", "element vertex 1\nproperty int x\nproperty uchar y\nproperty short z\n") +
            row);
    };
    EXPECT_ERROR(ints("1 2 3.5"), "line 9 (byte 121): '3.5' is not an integer");
    EXPECT_ERROR(ints("1 256 3"), "'256' is beyond its type's range");
    EXPECT_ERROR(ints("1 -2 3"), "'-2' is not an integer");
    EXPECT_ERROR(ints("1 2 nan"), "'nan' is not an integer");
}

TEST(PlyReader, readsWhatIsNotFiniteAndRoundsToTheNearest)
{
    const auto values = [](const std::string& row) {
        return parsedPly(
                   plyHeader("ascii",
                             "element vertex 1\nproperty double x\nproperty double y\nproperty double z\n") +
                   row)
            .doubles;
    };
    for (const char* nan : {"nan", "NaN", "-nan", "nan(ind)", "-nan(ind)", "nan(snan)", "1.#QNAN", "-1.#IND",
                            "1.#SNAN", "1.#IND00", "-1.#QNAN0"}) {
        const std::vector<double> read = values("1 " + std::string(nan) + " 3");
        EXPECT_TRUE(std::isnan(read[1])) << nan;
        EXPECT_EQ(read[2], 3);
    }
    for (const char* inf : {"inf", "Inf", "+inf", "INFINITY", "1.#INF", "1.#INF00"})
        EXPECT_EQ(values("1 2 " + std::string(inf))[2], HUGE_VAL) << inf;
    EXPECT_EQ(values("1 2 -1.#INF")[2], -HUGE_VAL);
    EXPECT_EQ(values("1 2 -inf")[2], -HUGE_VAL);
    EXPECT_EQ(values("9007199254740993 0.1 1e-400"), (std::vector<double>{9007199254740992.0, 0.1, 0}));
    EXPECT_EQ(values("4.9e-324 2e-324 1e23"), (std::vector<double>{4.9e-324, 0, 1e23}));
    EXPECT_EQ(values("0." + std::string(400, '0') + "1 0.00001e-400 -1e-99999999999999999999"),
              (std::vector<double>{0, 0, 0}));
    for (const char* odd :
         {"1.#QNANx", "1.#", "1.#1", "nanx", "1e", "0x10", "1.5.2", "1,5", "--1", "+-1", "1_0", "infin"}) {
        EXPECT_ERROR(values("1 2 " + std::string(odd)), "is not a number");
    }
    for (const char* large : {"1e309", "-1e400", "1e99999999999999999999", "0.001e400"})
        EXPECT_ERROR(values("1 2 " + std::string(large)), "range");
    EXPECT_ERROR(values("1 2 1" + std::string(400, '0') + ".5"), "range");
    EXPECT_ERROR(values("1 2 \x1b[2J"), "'\\x1B[2J' is not a number");
}

TEST(PlyReader, readsHeadersAsTheyAreWritten)
{
    const std::string body = "element vertex 2\n" + kThreeFloats + "end_header\n1 2 3\n4 5 6\n";
    const std::vector<float> expected{1, 2, 3, 4, 5, 6};
    const auto withEnds = [](std::string text, const std::string& lineEnd) {
        for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += lineEnd.size())
            text.replace(at, 1, lineEnd);
        return text;
    };
    for (const char* const head : {"ply\nformat ascii 1.0\n", "ply\ncomment first\nformat ascii 1.0\n",
                                   "ply\nobj_info a b\ncomment\n\nformat ascii 1.0\ncomment c\n"}) {
        for (const char* const lineEnd : {"\n", "\r\n", "\r"})
            EXPECT_EQ(parsedPly(withEnds(head + body, lineEnd)).floats, expected) << head << body;
    }
    // A comment of another system in between.
    EXPECT_EQ(parsedPly("ply\ncomment c\r\nformat ascii 1.0\n" + body).floats, expected);
    EXPECT_EQ(
        parsedPly(withEnds(plyHeader("binary_little_endian", "element vertex 2\n" + kThreeFloats), "\r") +
                  rawValues<float>(expected))
            .floats,
        expected);
    EXPECT_ERROR(parsedPly("ply\nelement vertex 2\nformat ascii 1.0\n" + body),
                 "expected the line 'format NAME 1.0'");
    EXPECT_ERROR(parsedPly("ply\ncomment c\nend_header\n"), "'format NAME 1.0'");
}

TEST(PlyReader, refusesTextRowsOfAnotherWidth)
{
    const std::string five = "element vertex 3\n" + kThreeFloats + "property uchar red\nproperty float u\n";
    const auto rows = [&](const std::string& text) { return parsedPly(plyHeader("ascii", five) + text); };
    EXPECT_EQ(rows("1 2 3 0 0\n4 5 6 0 0\n7 8 9 0 0\n").size(), 3u);
    // One more in the first, a middle and the last row; one less; two rows in a line; one row in two lines.
    EXPECT_ERROR(rows("1 2 3 0 0 5\n4 5 6 0 0\n7 8 9 0 0\n"),
                 "line 11 (byte 159) has 6 values: '1 2 3 0 0 5'; the header declares 5 for a row of element "
                 "'vertex', "
                 "one row a line (x y z red u); left over behind the last one: 1 value, 1 byte");
    EXPECT_ERROR(rows("1 2 3 0 0\n4 5 6 0 0 0\n7 8 9 0 0\n"), "line 12 (byte 169) has 6 values");
    EXPECT_ERROR(rows("1 2 3 0 0\n4 5 6 0 0\n7 8 9 0 0 1 2 3\n"), "line 13 (byte 179) has 8 values");
    EXPECT_ERROR(rows("1 2 3 0 0\n4 5 6 0\n7 8 9 0 0\n"), "line 12 (byte 169) has 4 values: '4 5 6 0'");
    EXPECT_ERROR(rows("1 2 3 0 0\n4 5 6 0 0\n7 8 9 0"), "has 4 values: '7 8 9 0'; the header declares 5");
    EXPECT_ERROR(rows("1 2 3 0 0 4 5 6 0 0\n7 8 9 0 0\n1 1 1 1 1\n"), "has 10 values");
    EXPECT_ERROR(rows("1 2 3\n0 0\n4 5 6 0 0\n7 8 9 0 0\n"), "line 11 (byte 159) has 3 values");
    EXPECT_ERROR(rows("1 2 3 0 0\n4 5 6 0 0\n"), "promises 3 rows of element 'vertex'");

    // With a list among the properties.
    const std::string list = "element vertex 2\n" + kThreeFloats + "property list uchar int l\n";
    EXPECT_EQ(parsedPly(plyHeader("ascii", list) + "1 2 3 0\n4 5 6 2 7 8\n").size(), 2u);
    EXPECT_ERROR(parsedPly(plyHeader("ascii", list) + "1 2 3 0\n4 5 6 2 7\n"),
                 "line 11 (byte 157) has 5 values");
    EXPECT_ERROR(parsedPly(plyHeader("ascii", list) + "1 2 3 0 9\n4 5 6 0\n"),
                 "line 10 (byte 149) has 5 values");
    EXPECT_ERROR(parsedPly(plyHeader("ascii", list) + "1 2 3 0\n4 5 6 x\n"),
                 "'x' is not the length of a list");

    // The same in elements that stand before.
    const std::string before =
        "element a 2\nproperty int i\nproperty list int int l\nelement vertex 1\n" + kThreeFloats;
    EXPECT_EQ(parsedPly(plyHeader("ascii", before) + "1 0\n2 1 1\n4 5 6\n").floats,
              (std::vector<float>{4, 5, 6}));
    EXPECT_ERROR(parsedPly(plyHeader("ascii", before) + "1 0\n2 1\n4 5 6\n"), "for a row of element 'a'");
    EXPECT_ERROR(parsedPly(plyHeader("ascii", before) + "1 0\n4 5 6\n"),
                 "promises 1 rows of element 'vertex'");
}

TEST(PlyReader, refusesWhatIsLeftOver)
{
    const std::string two = "element vertex 2\n" + kThreeFloats;
    EXPECT_ERROR(parsedPly(plyHeader("ascii", two) + "1 2 3\n4 5 6\n7 8 9\n1 1 1\n"),
                 "line 11 (byte 135), '7 8 9', stands behind the last row that the .ply header declares: 2 "
                 "lines, 12 bytes, "
                 "left over behind 2 rows");
    const std::string faces = two + "element face 1\nproperty list uchar int vertex_indices\n";
    EXPECT_ERROR(parsedPly(plyHeader("ascii", faces) + "1 2 3\n4 5 6\n3 0 1 0\n3 1 1 1\n"),
                 "1 line, 8 bytes, left over");
    EXPECT_ERROR(parsedPly(plyHeader("ascii", faces) + "1 2 3\n4 5 6\n7 8 9.5\n3 0 1 0\n"),
                 "looks like one more");
    // A list that goes on in the next line is still what was declared.
    EXPECT_EQ(parsedPly(plyHeader("ascii", faces) + "1 2 3\n4 5 6\n3 0\n1 0\n").size(), 2u);

    for (const bool isBig : {false, true}) {
        const std::string format = isBig ? "binary_big_endian" : "binary_little_endian";
        const std::string rows = rawValues<float>({1, 2, 3, 4, 5, 6}, isBig);
        EXPECT_EQ(parsedPly(plyHeader(format, two) + rows).size(), 2u);
        EXPECT_ERROR(parsedPly(plyHeader(format, two) + rows + "\n"),
                     "1 bytes are left over behind the last row");
        EXPECT_ERROR(parsedPly(plyHeader(format, two) + rows + rows), "24 bytes are left over");
        EXPECT_ERROR(parsedPly(plyHeader(format, two) + rows + rows), "as many as 2 rows more");
        EXPECT_ERROR(parsedPly(plyHeader(format, two) + rows + rows.substr(0, 16)), "8 for each vertex");
        const std::string face = "\3" + rawValues<std::int32_t>({0, 1, 0}, isBig);
        EXPECT_EQ(parsedPly(plyHeader(format, faces) + rows + face).size(), 2u);
        EXPECT_ERROR(parsedPly(plyHeader(format, faces) + rows + face + face), "13 bytes are left over");
        // Values that are not declared, or more vertices, before faces.
        std::string wide;
        for (const float x : {0.1f, 0.2f}) wide += rawValues<float>({x, 2, 3, 0.5f, 0.7f}, isBig);
        EXPECT_ERROR(parsedPly(plyHeader(format, faces) + wide + face), "8 for each vertex");
        EXPECT_ERROR(parsedPly(plyHeader(format, faces) + rows + rows + rows.substr(0, 12) + face),
                     "counting 3 rows more");
    }
}

TEST(PlyReader, forgivesElementsBehindWholeVertices)
{
    const std::string elements =
        "element vertex 2\n" + kThreeFloats + "element face 2\nproperty list uchar int vertex_indices\n";
    const std::vector<float> expected{1, 2, 3, 4, 5, 6};
    const auto check = [&](const std::string& file) {
        const ReadArray read = readPly(file);
        EXPECT_EQ(read.positions.floats, expected);
        ASSERT_EQ(read.notes.size(), 1u);
        EXPECT_NE(read.notes[0].find("the 2 vertices are whole"), std::string::npos) << read.notes[0];
    };
    const std::string text = plyHeader("ascii", elements) + "1 2 3\n4 5 6\n";
    EXPECT_TRUE(readPly(text + "3 0 1 0\n3 1 1 1\n").notes.empty());
    for (const char* const damaged :
         {"", "3 0 1 0\n", "3 0 1 0\n3 1", "3 0 1\n3 1 1 1\n", "x\ny\n", "-1\n3 0 1 0\n"})
        check(text + damaged);
    for (const bool isBig : {false, true}) {
        const std::string format = isBig ? "binary_big_endian" : "binary_little_endian";
        const std::string whole = plyHeader(format, elements) + rawValues<float>(expected, isBig);
        const std::string face = "\3" + rawValues<std::int32_t>({0, 1, 0}, isBig);
        for (std::size_t kept = 0; kept < 26; ++kept) check(whole + (face + face).substr(0, kept));
        check(whole + "\xff" + face + face);
        // Less than the vertices is not forgiven.
        EXPECT_ERROR(readPly(whole.substr(0, whole.size() - 1)), "truncated");
    }
    std::string negative = plyHeader("binary_little_endian", "element vertex 1\n" + kThreeFloats +
                                                                 "element a 1\nproperty list char int l\n");
    const ReadArray read = readPly(negative + rawValues<float>({1, 2, 3}) + "\xff" + "abc");
    ASSERT_EQ(read.notes.size(), 1u);
    EXPECT_NE(read.notes[0].find("negative"), std::string::npos);
}

TEST(PlyReader, takesNoMoreMemoryThanAllowed)
{
    const std::string file = plyHeader("ascii", "element vertex 1\n" + kThreeFloats) + "1 2 3";
    EXPECT_THROW(readAs("a.ply", bytesOf(file), parsePly, {}, 11), CapacityError);
    EXPECT_EQ(readAs("a.ply", bytesOf(file), parsePly, {}, 12).positions.size(), 1u);
}

// Files of more than one chunk: rows keep their places, and a fault has the number of its line.
TEST(PlyReader, readsTextInChunks)
{
    constexpr int kPoints = 200000;
    std::string rows;
    for (int i = 0; i < kPoints; ++i)
        rows += std::to_string(i) + " -" + std::to_string(i) + ".5 1e1\n" + (i % 7 ? "" : "\n");
    const std::string elements = "element vertex " + std::to_string(kPoints) + "\n" + kThreeFloats +
                                 "element face 1\nproperty list uchar int i\n";
    const std::vector<float> read = parsedPly(plyHeader("ascii", elements) + rows + "1 1\n").floats;
    ASSERT_EQ(read.size(), 3u * kPoints);
    for (std::size_t i = 0; i < kPoints; ++i) {
        ASSERT_EQ(read[3 * i], static_cast<float>(i));
        ASSERT_EQ(read[3 * i + 1], -static_cast<float>(i) - 0.5f);
        ASSERT_EQ(read[3 * i + 2], 10);
    }
    std::string wrong = rows;
    wrong[wrong.find("\n150000 ") + 1] = 'x';
    EXPECT_ERROR(parsedPly(plyHeader("ascii", elements) + wrong + "1 1\n"),
                 "line " + std::to_string(11 + 150000 + (150000 + 6) / 7) + " (byte");
    EXPECT_ERROR(parsedPly(plyHeader("ascii", elements) + rows + "1 1\n1 1\n"), "1 line, 4 bytes, left over");
}

// ------------------------------------------------------------------------------------------------ any valid
// file

struct Property {
    const char* type;
    bool isReal;
    int bytes;
    double least, most; // of integers
};

constexpr Property kProperties[] = {{"char", false, 1, -128, 127},
                                    {"uint8", false, 1, 0, 255},
                                    {"short", false, 2, -32768, 32767},
                                    {"uint16", false, 2, 0, 65535},
                                    {"int", false, 4, -2147483648.0, 2147483647},
                                    {"uint32", false, 4, 0, 4294967295.0},
                                    {"float", true, 4, 0, 0},
                                    {"float64", true, 8, 0, 0}};

class PlyMaker {
public:
    explicit PlyMaker(unsigned seed) : mRandom(seed), mFormat(below(3)) {}

    std::vector<double> expected; // x y z as doubles
    bool isDouble = false;

    std::string make()
    {
        std::string body;
        std::string header = "ply\n";
        if (below(2)) header += "comment before\n";
        header += std::string("format ") +
                  (mFormat == 0   ? "ascii"
                   : mFormat == 1 ? "binary_little_endian"
                                  : "binary_big_endian") +
                  " 1.0\n";
        for (int before = below(3); before > 0; --before)
            addElement("before" + std::to_string(before), header, body);
        addElement("vertex", header, body);
        for (int behind = below(3); behind > 0; --behind)
            addElement("behind" + std::to_string(behind), header, body);
        return header + "end_header\n" + body;
    }

private:
    int below(int limit) { return static_cast<int>(mRandom() % static_cast<unsigned>(limit)); }

    double value(const Property& p)
    {
        if (!p.isReal) return p.least + std::floor((p.most - p.least) * (mRandom() / 4294967295.0));
        const double real = (mRandom() / 4294967295.0 - 0.5) * std::pow(10.0, below(30) - 15);
        return p.bytes == 4 ? static_cast<float>(real) : real;
    }

    template <typename Number>
    std::string raw(double v) const
    {
        return rawValues<Number>({static_cast<Number>(v)}, mFormat == 2);
    }

    std::string put(const Property& p, double v) const
    {
        if (mFormat == 0) {
            char text[40];
            std::snprintf(text, sizeof text, "%.17g ", v);
            return text;
        }
        if (p.isReal) return p.bytes == 4 ? raw<float>(v) : raw<double>(v);
        const bool isSigned = p.least < 0;
        if (p.bytes == 1) return isSigned ? raw<std::int8_t>(v) : raw<std::uint8_t>(v);
        if (p.bytes == 2) return isSigned ? raw<std::int16_t>(v) : raw<std::uint16_t>(v);
        return isSigned ? raw<std::int32_t>(v) : raw<std::uint32_t>(v);
    }

    struct Column {
        Property type;
        std::string name;
        int listOf; // the type of a list's values; -1 for none
    };

    void addElement(const std::string& name, std::string& header, std::string& body)
    {
        std::vector<Column> columns;
        const auto addOthers = [&] {
            for (int more = below(3); more > 0; --more) {
                const bool isList = below(4) == 0;
                columns.push_back({kProperties[isList ? 1 + 2 * below(2) : below(8)],
                                   "p" + std::to_string(columns.size()), isList ? below(8) : -1});
            }
        };
        const bool isVertex = name == "vertex";
        int order[3] = {0, 1, 2};
        std::shuffle(order, order + 3, mRandom);
        const int oneType = below(2) ? 6 : -1;
        for (int k = 0; k < 3 && isVertex; ++k) {
            addOthers();
            columns.push_back(
                {kProperties[oneType < 0 ? below(8) : oneType], std::string(1, "xyz"[order[k]]), -1});
            isDouble = isDouble || std::string(columns.back().type.type) != "float";
        }
        addOthers();
        if (columns.empty()) return;
        const int rows = below(20);
        header += "element " + name + " " + std::to_string(rows) + "\n";
        for (const Column& c : columns) {
            header += std::string("property ") + (c.listOf >= 0 ? "list " : "") + c.type.type + " " +
                      (c.listOf >= 0 ? std::string(kProperties[c.listOf].type) + " " : "") + c.name + "\n";
        }
        for (int row = 0; row < rows; ++row) {
            double position[3]{};
            for (const Column& c : columns) {
                const int length = below(5);
                const double v = c.listOf >= 0 ? length : value(c.type);
                body += put(c.type, v);
                for (int i = 0; i < length && c.listOf >= 0; ++i)
                    body += put(kProperties[c.listOf], value(kProperties[c.listOf]));
                if (isVertex && c.name[0] >= 'x') position[c.name[0] - 'x'] = v;
            }
            if (mFormat == 0) body += below(5) ? "\n" : "\r\n";
            if (isVertex) expected.insert(expected.end(), position, position + 3);
        }
    }

    std::mt19937 mRandom;
    int mFormat; // ascii, little and big endian
};

TEST(PlyReader, readsAnyValidFile)
{
    for (unsigned seed = 0; seed < 3000; ++seed) {
        PlyMaker maker(seed);
        const std::string file = maker.make();
        const ReadArray read = readPly(file);
        const std::vector<double> floats(read.positions.floats.begin(), read.positions.floats.end());
        ASSERT_EQ(maker.isDouble ? read.positions.doubles : floats, maker.expected) << "seed " << seed << "\n"
                                                                                    << file;
        ASSERT_TRUE(read.notes.empty()) << read.notes[0];
        for (std::size_t k = 0; k < 3; ++k) {
            const std::vector<double> values = propertyOf(file, std::string(1, "xyz"[k]));
            ASSERT_EQ(3 * values.size(), maker.expected.size()) << file;
            for (std::size_t i = 0; i < values.size(); ++i)
                ASSERT_EQ(values[i], maker.expected[3 * i + k]) << file;
        }
        if (maker.expected.empty()) continue;
        ASSERT_NE(errorOf([&] { readPly(file + "7\n"); }), "") << "seed " << seed;
    }
}

TEST(PlyReader, readsOneProperty)
{
    const std::string properties =
        "element vertex 2\nproperty uchar red\nproperty float x\nproperty float y\n"
        "property float z\nproperty float pscale\nproperty double mass\n"
        "property short id\n";
    const std::string text =
        plyHeader("ascii", properties) + "255 1 2 3 0.1 0.1 -7\n0 4 5 6 nan 1e300 30000\n";
    EXPECT_EQ(propertyOf(text, "red"), (std::vector<double>{255, 0}));
    EXPECT_EQ(propertyOf(text, "mass"), (std::vector<double>{0.1, 1e300}));
    EXPECT_EQ(propertyOf(text, "pscale")[0], double(0.1f)); // the nearest of the type declared
    EXPECT_TRUE(std::isnan(propertyOf(text, "pscale")[1]));
    EXPECT_EQ(propertyOf(text, "id"), (std::vector<double>{-7, 30000}));
    EXPECT_NE(errorOf([&] {
                  propertyOf(plyHeader("ascii", properties) + "255 1 2 3 0.1 0.1 x\n0 4 5 6 1 1 1\n", "id");
              }).find("'x' is not an integer; expected property id"),
              std::string::npos);
    for (const bool isBig : {false, true}) {
        std::string body;
        for (const float first : {1.0f, 2.0f}) {
            body += std::string(1, char(int(first))) + rawValues<float>({first, 0, 0, first / 3}, isBig) +
                    rawValues<double>({first / 7.0}, isBig) +
                    rawValues<std::int16_t>({std::int16_t(-first)}, isBig);
        }
        const std::string format = isBig ? "binary_big_endian" : "binary_little_endian";
        EXPECT_EQ(propertyOf(plyHeader(format, properties) + body, "red"), (std::vector<double>{1, 2}));
        EXPECT_EQ(propertyOf(plyHeader(format, properties) + body, "pscale"),
                  (std::vector<double>{1.0f / 3, 2.0f / 3}));
        EXPECT_EQ(propertyOf(plyHeader(format, properties) + body, "mass"),
                  (std::vector<double>{1 / 7.0, 2 / 7.0}));
        EXPECT_EQ(propertyOf(plyHeader(format, properties) + body, "id"), (std::vector<double>{-1, -2}));
    }
}

TEST(PlyReader, namesItsPropertiesAndWhatIsThere)
{
    const std::string file =
        plyHeader("ascii", "element vertex 1\n" + kThreeFloats +
                               "property float32 pscale\nproperty list uchar int near\n") +
        "1 2 3 4 1 5\n";
    const ReadArray read = readPly(file);
    ASSERT_EQ(read.properties.size(), 5u);
    EXPECT_EQ(read.properties[3].name, "pscale");
    EXPECT_EQ(read.properties[3].type, "float32");
    EXPECT_EQ(read.properties[4].type, "list uchar int");
    EXPECT_EQ(propertyOf(file, "pscale"), std::vector<double>{4});
    try {
        propertyOf(file, "pscal");
        FAIL() << "no such property";
    } catch (const InvalidInput& e) {
        const std::string what = e.what();
        EXPECT_NE(what.find("no property 'pscal'; did you mean 'pscale'? Its properties are 'x', 'y', 'z', "
                            "'pscale', 'near'"),
                  std::string::npos)
            << what;
    }
    EXPECT_NE(errorOf([&] { propertyOf(file, "near"); }).find("has type list uchar int; expected is"),
              std::string::npos);
}

} // namespace
} // namespace vdb_nns
