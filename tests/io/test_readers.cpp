// The array formats, byte by byte: what is read, and what every lie of a header gets.
#include "io/array_readers.h"
#include "points/particle_source.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>

namespace vdb_nns {
namespace {

FileBytes bytesOf(const std::string& text)
{
    return {reinterpret_cast<const unsigned char*>(text.data()), text.size()};
}

// The message of the InputError that a reader throws; empty if it throws none.
template <typename F>
std::string errorOf(F&& read)
{
    try {
        read();
    } catch (const InputError& error) {
        return error.what();
    }
    return {};
}

#define EXPECT_ERROR(expression, part)                                                                       \
    EXPECT_NE(errorOf([&] { expression; }).find(part), std::string::npos) << errorOf([&] { expression; })

template <typename Real>
std::string rawValues(const std::vector<Real>& values, bool isBigEndian = false)
{
    std::string out;
    for (const Real value : values) {
        char raw[sizeof(Real)];
        std::memcpy(raw, &value, sizeof value);
        for (std::size_t i = 0; i < sizeof raw; ++i) out += raw[isBigEndian ? sizeof raw - 1 - i : i];
    }
    return out;
}

// ------------------------------------------------------------------------------------------------ .npy

std::string npy(const std::string& dictionary, const std::string& values, int version = 1)
{
    std::string out("\x93NUMPY", 6);
    out += static_cast<char>(version);
    out += '\0';
    for (int i = 0; i < (version == 1 ? 2 : 4); ++i) out += static_cast<char>(dictionary.size() >> (8 * i));
    return out + dictionary + values;
}

std::string npyDictionary(const std::string& descr, const std::string& shape)
{
    return "{'descr': '" + descr + "', 'fortran_order': False, 'shape': " + shape + ", }\n";
}

NpyLayout parsedNpy(const std::string& file)
{
    return parseNpy("a.npy", bytesOf(file));
}

TEST(NpyReader, findsTheValues)
{
    for (int version = 1; version <= 3; ++version) {
        const std::string values = rawValues<float>({1, 2, 3, 4, 5, 6});
        const std::string file = npy(npyDictionary("<f4", "(2, 3)"), values, version);
        const NpyLayout layout = parsedNpy(file);
        EXPECT_EQ(layout.count, 2u);
        EXPECT_FALSE(layout.isDouble);
        EXPECT_EQ(file.substr(layout.dataOffset), values);
    }
    EXPECT_TRUE(parsedNpy(npy(npyDictionary("<f8", "(1, 3)"), std::string(24, '\0'))).isDouble);
    EXPECT_EQ(parsedNpy(npy(npyDictionary("<f8", "(0, 3)"), "")).count, 0u);
    // Any order of the keys, either quote, any white space.
    EXPECT_EQ(parsedNpy(npy("{\"shape\" : (1,3,),\n\t'fortran_order':False,'descr':\"<f4\"}   \n",
                            std::string(12, '\0')))
                  .count,
              1u);
}

TEST(NpyReader, refusesOtherArrays)
{
    const std::string values(24, '\0');
    for (const char* descr : {">f4", "<i4", "|u1", "<f2", "<c8", "f4", "=f4", ""}) {
        EXPECT_ERROR(parsedNpy(npy(npyDictionary(descr, "(2, 3)"), values)),
                     "dtype '" + std::string(descr) + "'");
    }
    for (const char* shape : {"(6,)", "(3, 2)", "()", "(1, 2, 3)", "(2, 4)"}) {
        EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", shape), values)), "shape " + std::string(shape));
    }
    EXPECT_ERROR(parsedNpy(npy("{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }", values)),
                 "Fortran");
    EXPECT_ERROR(parsedNpy(npy("{'descr': [('x', '<f4')], 'fortran_order': False, 'shape': (2,), }", values)),
                 "records");
}

TEST(NpyReader, refusesLies)
{
    const std::string values = rawValues<float>({1, 2, 3, 4, 5, 6});
    const std::string whole = npy(npyDictionary("<f4", "(2, 3)"), values);
    for (std::size_t kept = 0; kept < whole.size(); ++kept) {
        EXPECT_NE(errorOf([&] { parsedNpy(whole.substr(0, kept)); }), "") << kept;
    }
    EXPECT_ERROR(parsedNpy(whole + "x"), "1 bytes too many");
    EXPECT_ERROR(parsedNpy(whole.substr(0, whole.size() - 1)), "truncated");
    // Products that overflow 64 bits, and numbers that do not fit them.
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(1537228672809129302, 3)"), values)), "truncated");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(18446744073709551615, 3)"), values)), "truncated");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(18446744073709551616, 3)"), values)),
                 "expected a size");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(-2, 3)"), values)), "expected a size");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(2.0, 3)"), values)), "expected ')'");
    EXPECT_ERROR(
        parsedNpy(npy("{'descr': '<f4', 'descr': '<f8', 'fortran_order': False, 'shape': (2, 3)}", values)),
        "twice");
    EXPECT_ERROR(parsedNpy(npy("{'descr': '<f4', 'fortran_order': False}", values)), "missing");
    EXPECT_ERROR(parsedNpy(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), } x", values)),
                 "behind");
    EXPECT_ERROR(parsedNpy(npy("{'descr': '<f4", values)), "no end");
    EXPECT_ERROR(parsedNpy(npy("", values)), "expected '{'");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(2, 3)"), values, 4)), "version 4");
    EXPECT_ERROR(parsedNpy(std::string("\x93NUMPY\x02\x00\xff\xff\xff\xff", 12)), "claims 4294967295 bytes");
    EXPECT_ERROR(parsedNpy("PK\x03\x04 this is an npz"), "is not an .npy file");
}

// ------------------------------------------------------------------------------------------------ .ply

PositionArray parsedPly(const std::string& file)
{
    return parsePly("a.ply", bytesOf(file));
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

// ------------------------------------------------------------------------------------------------ .xyz

std::vector<double> parsedXyz(const std::string& text)
{
    return parseXyz("a.xyz", bytesOf(text)).doubles;
}

TEST(XyzReader, readsLines)
{
    EXPECT_EQ(parsedXyz(""), (std::vector<double>{}));
    EXPECT_EQ(parsedXyz("# nothing\n\n   \r\n"), (std::vector<double>{}));
    EXPECT_EQ(parsedXyz("1 2 3"), (std::vector<double>{1, 2, 3}));
    EXPECT_EQ(parsedXyz("# points\r\n 0.1\t+2 -3e4 more columns # and a comment\r\n\r\n4 5 6#7\n"),
              (std::vector<double>{0.1, 2, -3e4, 4, 5, 6}));
    EXPECT_EQ(parsedXyz("1e-400 4.9e-324 1.7976931348623157e308"),
              (std::vector<double>{0, 4.9e-324, std::numeric_limits<double>::max()}));
    const std::vector<double> special = parsedXyz("nan inf -inf\n");
    EXPECT_TRUE(std::isnan(special[0]));
    EXPECT_EQ(special[1], HUGE_VAL);
    EXPECT_EQ(special[2], -HUGE_VAL);
    EXPECT_EQ(parsedXyz("12 13 14\n5 5 5\n").size(), 6u); // integers are fine
}

TEST(XyzReader, keepsTheOrderOverManyChunks)
{
    std::string text;
    constexpr int kLines = 300000; // several chunks
    for (int i = 0; i < kLines; ++i) text += std::to_string(i) + " " + std::to_string(i * 2) + " 0.5\n";
    const std::vector<double> values = parsedXyz(text);
    ASSERT_EQ(values.size(), 3u * kLines);
    for (int i = 0; i < kLines; ++i) {
        ASSERT_EQ(values[static_cast<std::size_t>(i) * 3], i);
        ASSERT_EQ(values[static_cast<std::size_t>(i) * 3 + 1], i * 2);
    }
    text += "1 2\n3 4\n";
    EXPECT_ERROR(parsedXyz(text), "line 300001 (byte " + std::to_string(text.size() - 8) + ")");
}

TEST(XyzReader, takesMemoryForPointsOnly)
{
    std::string text = "1 2 3\n";
    for (int i = 0; i < 10000; ++i) text += i % 2 ? "#\n" : "\n";
    EXPECT_EQ(parseXyz("a.xyz", bytesOf(text), 48).size(), 1u); // 3 doubles, twice
    EXPECT_THROW(parseXyz("a.xyz", bytesOf(text), 47), CapacityError);
}

TEST(XyzReader, refusesOtherText)
{
    EXPECT_ERROR(parsedXyz("3\ncomment\nH 0 0 0\n"), "line 1 is one integer, '3'");
    EXPECT_ERROR(parsedXyz("# about\n\n  128  # atoms\r\n1 2 3\n"), "line 3 is one integer, '128'");
    EXPECT_ERROR(parsedXyz("1 2 3\n7\n"), "line 2 (byte 6) has fewer than three numbers");
    EXPECT_ERROR(parsedXyz("1 2 3\nH 0 0 0\n"), "not a number: 'H 0 0 0'");
    EXPECT_ERROR(parsedXyz("1,2,3\n"), "not a number");
    EXPECT_ERROR(parsedXyz("1 2 # 3\n"), "fewer");
    EXPECT_ERROR(parsedXyz("1 2 3e\n1 2 0x\n"), "not a number");
    EXPECT_ERROR(parsedXyz("1 2 +-3\n"), "not a number");
    EXPECT_ERROR(parsedXyz("1 2 1e309\n"), "range of double");
    EXPECT_ERROR(parsedXyz(std::string("1 2 3\n1 2 \0 3\n", 13)), "line 2");
    EXPECT_ERROR(parsedXyz("\xff\xfe\x31\x00"), "line 1");
}

// ------------------------------------------------------------------------------------------------ files

TEST(ArrayFiles, areReadWhateverTheirAlignment)
{
    std::string name = (std::filesystem::temp_directory_path() / "vdb_nns_readers_XXXXXX").string();
    const std::filesystem::path folder = ::mkdtemp(name.data());
    const std::string path = (folder / "a.npy").string();
    std::vector<double> values(3 * 50000);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<double>(i) * 0.1;
    for (std::size_t padding = 0; padding < 8; ++padding) {
        std::ofstream(path, std::ios::binary)
            << npy(npyDictionary("<f8", "(50000, 3)") + std::string(padding, ' '), rawValues(values));
        const PointFile file = PointFile::read(path);
        ASSERT_EQ(file.view().size(), 50000u);
        EXPECT_EQ(file.info().codec, "float64");
        for (std::size_t i = 0; i < 50000; i += 997) {
            EXPECT_EQ(file.view().worldPosition(i),
                      (Vec3d{values[3 * i], values[3 * i + 1], values[3 * i + 2]}));
        }
    }
    std::filesystem::remove_all(folder);
}

} // namespace
} // namespace vdb_nns
