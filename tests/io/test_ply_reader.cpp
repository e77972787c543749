// The .ply reader, byte by byte: what is read, and what every lie of a header gets.
#include "support/array_file.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

PositionArray parsedPly(const std::string& file)
{
    return readAs("a.ply", bytesOf(file), parsePly).positions;
}

std::string plyHeader(const std::string& format, const std::string& elements)
{
    return "ply\nformat " + format + " 1.0\ncomment made by a test\n" + elements + "end_header\n";
}

const std::string kThreeFloats = "property float x\nproperty float y\nproperty float z\n";

TEST(PlyReader, readsText)
{
    const PositionArray floats = parsedPly(plyHeader("ascii", "element vertex 3\n" + kThreeFloats) +
                                           "0.1 +2 -3e4\nnan inf 1e-60\n\t7\r\n8   9");
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
        EXPECT_ERROR(parsedPly(file.substr(0, file.size() - 1)), "truncated");
    }
}

TEST(PlyReader, refusesOtherFiles)
{
    EXPECT_ERROR(parsedPly(""), "end_header");
    EXPECT_ERROR(parsedPly("plyer\n"), "is not a .ply file");
    EXPECT_ERROR(parsedPly("ply\nformat ascii 2.0\nend_header\n"), "'2.0' is not 1.0");
    EXPECT_ERROR(parsedPly("ply\nformat binary 1.0\nend_header\n"), "format 'binary'");
    EXPECT_ERROR(parsedPly("ply\nformat ascii 1.0\nend_header\n"), "no element 'vertex'");
    const auto withHeader = [](const std::string& elements) {
        return parsedPly(plyHeader("ascii", elements) + "1 2 3 4\n");
    };
    EXPECT_ERROR(withHeader("element vertex 1\nproperty float x\nproperty float y\n"), "no property 'z'");
    EXPECT_ERROR(withHeader("element vertex 1\nproperty int x\nproperty float y\nproperty float z\n"),
                 "'x' is neither");
    EXPECT_ERROR(
        withHeader("element vertex 1\nproperty list int float x\nproperty float y\nproperty float z\n"),
        "'x' is neither");
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
                 "promises");
    EXPECT_ERROR(binary("element vertex 1\n" + kThreeFloats + "element face 5\nproperty list uchar int i\n"),
                 "promises 5");
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
        "truncated");
    // An element without properties has no rows, however many it claims.
    EXPECT_EQ(text("element a 18446744073709551615\nelement vertex 1\n" + kThreeFloats, "1 2 3").size(), 1u);
}

} // namespace
} // namespace vdb_nns
