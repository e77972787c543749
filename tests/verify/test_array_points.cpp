// The readers of `vdb_nns verify` for arrays and texts: every form that is read, small and by hand, and what
// is refused.
#include "../support/lists_writer.h"
#include "vdb_nns/error.h"
#include "verify/array_points.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>

namespace vdb_nns::testing {

namespace {

using cli::Positions;
using namespace std::string_literals;

constexpr double kInf = HUGE_VAL;
const Positions kTwoPoints = {1, 2, 3, 4, 5, 6};

class ArrayPoints : public ::testing::Test {
protected:
    void TearDown() override
    {
        for (const std::string& path : mPaths) std::filesystem::remove(path);
    }

    std::string file(const std::string& extension, const std::string& bytes)
    {
        const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
        const std::string path = ::testing::TempDir() + "vdb_nns_points_" + test->name() + "." + extension;
        writeBytes(path, bytes);
        mPaths.push_back(path);
        return path;
    }

    Positions read(const std::string& extension, const std::string& bytes,
                   std::vector<std::uint32_t> columns = {}, const std::string& array = {})
    {
        PointFileOptions options;
        options.columns = std::move(columns);
        options.array = array;
        return cli::readArrayPoints(file(extension, bytes), options);
    }

    void refuses(const std::string& extension, const std::string& bytes)
    {
        EXPECT_THROW(read(extension, bytes), InputError) << bytes;
    }

private:
    std::vector<std::string> mPaths;
};

std::string bigEndian(std::uint64_t bits, unsigned bytes)
{
    std::string raw;
    while (bytes-- > 0) raw += static_cast<char>(bits >> (8 * bytes));
    return raw;
}

std::string bigFloat(float value)
{
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bigEndian(bits, 4);
}

std::string npy(const std::string& header, const std::string& values, char version = 1)
{
    const auto length = static_cast<char>(header.size());
    return "\x93NUMPY" + std::string{version, '\0', length, '\0'} + (version == 1 ? "" : "\0\0"s) + header +
           values;
}

std::string ply(const std::string& format, const std::string& header, const std::string& body)
{
    return "ply\nformat " + format + " 1.0\n" + header + "end_header\n" + body;
}

const std::string kXyz = "property float x\nproperty float y\nproperty float z\n";

} // namespace

// ------------------------------------------------------------------------------------------------ text

TEST_F(ArrayPoints, LinesAndSeparators)
{
    for (const char* text :
         {"1 2 3\n4 5 6\n", "1 2 3\n4 5 6", "1\t2\t3\r\n4 5  6\r\n", "1 2 3\r4 5 6\r", "1,2,3\n4, 5,6\n",
          "1;2;3\n4;5; 6\n", "1 , 2 , 3\n4 ,5 , 6\n",
          "\xEF\xBB\xBF"
          "1 2 3\n4 5 6\n",
          "\n# x y z\n 1 2 3 # first\n\n4 5 6\n", "1 2 3\r\r\n\r4 5 6", "1 2 3 x#y\n4 5 6 #z w\n"}) {
        if (std::strstr(text, "x#y")) {
            refuses("xyz", text); // the second row is narrower
        } else {
            EXPECT_EQ(read("xyz", text), kTwoPoints) << text;
        }
    }
    for (const char* extension : {"txt", "csv", "pts", "XYZ"})
        EXPECT_EQ(read(extension, "1 2 3\n4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", ""), Positions());
    EXPECT_EQ(read("csv", "x,y,z\n"), Positions());
    EXPECT_EQ(read("pts", "0\n"), Positions());
}

TEST_F(ArrayPoints, NamesAndCounts)
{
    EXPECT_EQ(read("csv", "id,Z,\"x\",Y\n9,3,1,2\n9,6,4,5\n"), kTwoPoints);
    EXPECT_EQ(read("csv", "\"a,b\";x ; y;z\n9;1;2;3\n9;4;5;6\n"), kTwoPoints);
    EXPECT_EQ(read("txt", "east north up\n1 2 3\n4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", "//X Y Z R\n2\n1 2 3 0\n4 5 6 0\n"), kTwoPoints);
    EXPECT_EQ(read("pts", "2\n1 2 3\n4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("csv", "\"name, first\",1,2,3\nb,4,5,6\n", {1, 2, 3}), kTwoPoints);
    EXPECT_EQ(read("txt", "0 3 2 1\n0 6 5 4\n", {3, 2, 1}), kTwoPoints);
    EXPECT_THROW(read("txt", "1 2 3\n", {0, 1, 3}), InvalidInput);
    refuses("pts", "3\n1 2 3\n4 5 6\n");
    refuses("pts", "1\n1 2 3\n4 5 6\n");
}

TEST_F(ArrayPoints, Chemistry)
{
    EXPECT_EQ(read("xyz", "2\nwater\nO 1 2 3\nH 4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", "2\n\nO 1 2 3\nH 4 5 6\n2\n\nO 0 0 0\nH 0 0 0\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", "2\nstep 7\n8 1 2 3\n1 4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", "2\n1 2 3\nO 1 2 3\nH 4 5 6\n"), kTwoPoints);
    EXPECT_EQ(read("xyz", "2\nProperties=species:S:1:mass:R:1:pos:R:3 pbc=F\nO 16 1 2 3\nH 1 4 5 6\n"),
              kTwoPoints);
    EXPECT_EQ(read("xyz", "2\nLattice=\"9 0 0 0 9 0 0 0 9\" Properties=Z:I:1:pos:R:3\n8 1 2 3\n1 4 5 6\n"),
              kTwoPoints);
    EXPECT_EQ(read("xyz", "2\nno element\n1 2 3\n4 5 6\n"), kTwoPoints);
    refuses("xyz", "3\nwater\nO 1 2 3\nH 4 5 6\n");
    refuses("xyz", "1\nwater\nO 1 2 3\nH 4 5 6\n");
}

TEST_F(ArrayPoints, NumbersOfText)
{
    const Positions read1 = read("xyz", "1.#QNAN -1.#IND00 1.#INF\n-1.#INF00 nan -inf\n");
    ASSERT_EQ(read1.size(), 6U);
    for (const int k : {0, 1, 4}) EXPECT_TRUE(std::isnan(read1[static_cast<std::size_t>(k)]));
    EXPECT_EQ((Positions{read1[2], read1[3], read1[5]}), (Positions{kInf, -kInf, -kInf}));
    EXPECT_EQ(read("xyz", "+1 1e-400 .5\n5. -0 0.1\n"), (Positions{1, 0, .5, 5, -0., .1}));
    for (const char* text : {"1 2 3x\n", "1 2 0x10\n", "1 2 1e999\n", "1 2 1.#QNAX\n", "1 2 --3\n", "1 2\n",
                             "1 2 3\n4 5\n", "1 2 3\n4 5 6 7\n", "1,2,\n", "1 2 3\n4 5 a\n"})
        refuses("xyz", text);
}

// ------------------------------------------------------------------------------------------------ npy

TEST_F(ArrayPoints, Npy)
{
    const std::string values = "\1\2\3\4\5\6",
                      header = "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 3), }";
    for (const char version : {'\1', '\2', '\3'})
        EXPECT_EQ(read("npy", npy(header, values, version)), kTwoPoints);
    EXPECT_EQ(read("npy", npy("{'descr': '|i1', 'fortran_order': True, 'shape': (2, 3)}", "\1\4\2\5\3\6")),
              kTwoPoints);
    EXPECT_EQ(
        read("npy", npy("{\"shape\":(1,3),'descr':'>f2','fortran_order':False}\n", "\x3c\0\xc0\0\0\1"s)),
        (Positions{1, -2, std::ldexp(1, -24)}));
    EXPECT_EQ(read("npy", npy("{'descr': '>i8', 'fortran_order': False, 'shape': (1, 3)}",
                              bigEndian(~std::uint64_t(0), 8) + bigEndian(std::uint64_t(1) << 53, 8) +
                                  bigEndian(7, 8))),
              (Positions{-1, 9007199254740992., 7}));
    EXPECT_EQ(read("npy",
                   npy("{'descr': '|u1', 'fortran_order': False, 'shape': (2, 4)}", "\3\2\0\1\6\5\0\4"s),
                   {3, 1, 0}),
              kTwoPoints);
    EXPECT_EQ(read("npy",
                   npy("{'descr': [('n', '<i2', (2,)), (('title', 'x'), '<u2'), ('z', '|u1'), ('y', '>u2')], "
                       "'fortran_order': False, 'shape': (1,), }",
                       "\0\0\0\0\1\0\3\0\2"s)),
              (Positions{1, 2, 3}));
    EXPECT_EQ(read("npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 3)}", "")), Positions());
}

TEST_F(ArrayPoints, NpyThatIsRefused)
{
    const std::string values = "\1\2\3\4\5\6";
    const auto header = [](const char* descr, const char* shape) {
        return "{'descr': "s + descr + ", 'fortran_order': False, 'shape': " + shape + "}";
    };
    for (const auto& [descr, shape] : {std::pair{"'|u1'", "(2, 4)"},
                                       {"'|u1'", "(6,)"},
                                       {"'|u1'", "(3, 2)"},
                                       {"'|u1'", "(1, 3)"},
                                       {"'|u1'", "(3, 3)"},
                                       {"'|b1'", "(2, 3)"},
                                       {"'<f3'", "(1, 2)"},
                                       {"'|O'", "(2, 3)"},
                                       {"[('x', '|u1'), ('y', '|u1')]", "(3,)"},
                                       {"'|u1'", "(-2, 3)"}})
        refuses("npy", npy(header(descr, shape), values));
    refuses("npy", npy("{'descr': '|u1', 'shape': (2, 3)}", values));
    refuses("npy", npy(std::string(100, '('), values));
    refuses("npy", "no array at all");
    refuses("npy", npy(header("'>u8'", "(1, 3)"),
                       bigEndian((std::uint64_t(1) << 53) + 1, 8) + std::string(16, '\0')));
}

TEST_F(ArrayPoints, Npz)
{
    const std::string one = npy("{'descr': '|u1', 'fortran_order': False, 'shape': (2, 3)}", "\1\2\3\4\5\6");
    const std::string other = npy("{'descr': '|u1', 'fortran_order': False, 'shape': (0, 3)}", "");
    EXPECT_EQ(read("npz", zipBytes({{"a.npy", one}})), kTwoPoints);
    EXPECT_EQ(read("npz", zipBytes({{"b.npy", other}, {"a.npy", one}}), {}, "a"), kTwoPoints);
    EXPECT_THROW(read("npz", zipBytes({{"b.npy", other}, {"a.npy", one}})), InvalidInput);
    EXPECT_THROW(read("npz", zipBytes({{"a.npy", one}}), {}, "c"), InvalidInput);
    std::string damaged = zipBytes({{"a.npy", one}});
    damaged[damaged.find("\4\5\6")] = 7;
    refuses("npz", damaged);
}

// ------------------------------------------------------------------------------------------------ ply

TEST_F(ArrayPoints, PlyText)
{
    const std::string header = "comment x y z\nelement vertex 2\n" + kXyz;
    EXPECT_EQ(read("ply", ply("ascii", header, "1 2 3\n4 5 6\n")), kTwoPoints);
    EXPECT_EQ(read("ply", ply("ascii", header, "1 2 3\r\n\r\n4 5 6")), kTwoPoints);
    EXPECT_EQ(read("ply",
                   "ply\rcomment a\rformat ascii 1.0\relement vertex 1\rproperty uchar z\rproperty int y\r"
                   "property double x\rend_header\r3 -2 0.1\r"),
              (Positions{.1, -2, 3}));
    EXPECT_EQ(read("ply", ply("ascii", "element vertex 1\n" + kXyz, "0.1 2 3\n"))[0], double(.1F));
    EXPECT_EQ(read("ply",
                   ply("ascii",
                       "element a 1\nproperty list uchar int l\nelement vertex 2\nproperty list int int m\n" +
                           kXyz + "element face 2\nproperty int n\n",
                       "2 9 9\n0 1 2 3\n1 7 4 5 6\nno number\n")),
              kTwoPoints); // faces are not looked at
    refuses("ply", ply("ascii", header, "1 2 3 0\n4 5 6 0\n"));
    refuses("ply", ply("ascii", header, "1 2 3 4 5 6\n"));
    refuses("ply", ply("ascii", header, "1 2\n3 4 5 6\n"));
    refuses("ply", ply("ascii", header, "1 2 3\n"));
    refuses("ply", ply("ascii", header, "1 2 3\n4 5 6\n7 8 9\n"));
    refuses("ply", ply("ascii", header, "1 2 3\n4 5 six\n"));
    refuses("ply", ply("ascii", "element vertex 1\nproperty float x\nproperty float y\n", "1 2\n"));
    refuses("ply", ply("ascii", "element face 1\n" + kXyz, "1 2 3\n"));
    refuses("ply", ply("ascii_2", header, "1 2 3\n4 5 6\n"));
}

TEST_F(ArrayPoints, PlyBinary)
{
    const std::string header =
        "element a 1\nproperty list ushort uchar l\nelement vertex 1\nproperty char z\n"
        "property short y\nproperty uint x\n";
    EXPECT_EQ(read("ply", ply("binary_little_endian", header, "\2\0\7\7\xff\1\x80\1\0\0\x80"s)),
              (Positions{2147483649., -32767, -1}));
    EXPECT_EQ(read("ply", ply("binary_big_endian", header, "\0\2\7\7\xff\x80\1\x80\0\0\1"s)),
              (Positions{2147483649., -32767, -1}));
    const std::string points = bigFloat(1) + bigFloat(2) + bigFloat(3);
    EXPECT_EQ(read("ply", ply("binary_big_endian", "element vertex 1\n" + kXyz, points)),
              (Positions{1, 2, 3}));
    EXPECT_EQ(read("ply", ply("binary_big_endian",
                              "element vertex 1\n" + kXyz + "element face 9\nproperty int a\n", points)),
              (Positions{1, 2, 3}));
    refuses("ply", ply("binary_big_endian", "element vertex 1\n" + kXyz, points + "\0"s));
    refuses("ply", ply("binary_big_endian", "element vertex 2\n" + kXyz, points));
}

// ------------------------------------------------------------------------------------------------ vtk, bgeo

TEST_F(ArrayPoints, Vtk)
{
    const std::string text = "# vtk DataFile Version 3.0\ntitle\nASCII\n",
                      binary = "# vtk DataFile Version 4.2\r\nt\r\nBINARY\r\n";
    const std::string points = bigFloat(1) + bigFloat(2) + bigFloat(3);
    EXPECT_EQ(read("vtk", text + "DATASET POLYDATA\nPOINTS 2 float\n1 2 3 4\n5 6\nVERTICES 1 2\n1 0\n"),
              kTwoPoints);
    EXPECT_EQ(
        read("vtk", text +
                        "DATASET UNSTRUCTURED_GRID\nFIELD FieldData 2\nTIME 1 1 double\n0.5\nC 2 1 int\n1 2\n"
                        "points 2 unsigned_char\n1 2 3\n4 5 6\n"),
        kTwoPoints);
    EXPECT_EQ(
        read("vtk",
             text + "DATASET STRUCTURED_GRID\nDIMENSIONS 1 1 1\nPOINTS 1 float\n0.1 2 3\n\nMETADATA\n")[0],
        double(.1F));
    EXPECT_EQ(read("vtk", binary + "DATASET POLYDATA\r\nFIELD F 1\r\nTIME 1 1 double\r\n" +
                              std::string(8, 'P') + "\r\nPOINTS 1 float\r\n" + points +
                              "\r\nPOINT_DATA 1\r\n"),
              (Positions{1, 2, 3}));
    EXPECT_EQ(read("vtk", binary + "DATASET POLYDATA\nPOINTS 1 long\n" + bigEndian(1, 8) + bigEndian(2, 8) +
                              bigEndian(3, 8)),
              (Positions{1, 2, 3}));
    refuses("vtk", text + "DATASET STRUCTURED_POINTS\nDIMENSIONS 2 2 2\n");
    refuses("vtk", text + "DATASET POLYDATA\nPOINTS 2 float\n1 2 3\n");
    refuses("vtk", text + "DATASET POLYDATA\nPOINTS 1 float\n1 2 3 4\n");
    refuses("vtk", text + "DATASET POLYDATA\nPOINTS 1 string\n1 2 3\n");
    refuses("vtk", binary + "DATASET POLYDATA\nPOINTS 1 float\n" + points.substr(1));
    refuses("vtk", binary + "DATASET POLYDATA\nPOINTS 1 float\n" + points + points);
    refuses("vtk", "<VTKFile>");
}

TEST_F(ArrayPoints, Bgeo)
{
    const auto counts = [](std::vector<std::uint64_t> values) {
        std::string raw = "BgeoV"s + bigEndian(5, 4);
        for (const std::uint64_t value : values) raw += bigEndian(value, 4);
        return raw;
    };
    const auto point = [](float x) { return bigFloat(x) + bigFloat(x + 1) + bigFloat(x + 2) + bigFloat(1); };
    EXPECT_EQ(read("bgeo", counts({2, 0, 0, 0, 0, 0, 0, 0}) + point(1) + point(4) + "\0\xff"s), kTwoPoints);
    const std::string attributes = "\0\1v\0\3"s + bigEndian(5, 4) + std::string(12, '\0') + "\0\1s\0\1"s +
                                   bigEndian(4, 4) + bigEndian(2, 4) + "\0\1a\0\2bb"s;
    const std::string rest(16, 'r');
    EXPECT_EQ(read("bgeo", counts({2, 1, 0, 0, 2, 0, 0, 0}) + attributes + point(1) + rest + point(4) + rest +
                               "primitives"),
              kTwoPoints);
    refuses("bgeo", counts({2, 0, 0, 0, 0, 0, 0, 0}) + point(1));
    refuses("bgeo", counts({1, 0, 0, 0, 0, 0, 0, 0}) + point(1) + point(4));
    refuses("bgeo", counts({1, 0, 0, 0, 1, 0, 0, 0}) + "\0\1v\0\1"s + bigEndian(9, 4));
    refuses("bgeo", "\x7f"
                    "NSJb");
}

TEST_F(ArrayPoints, OtherFiles)
{
    for (const char* path : {"a.vdb", "a.b/xyz", "xyz", "a.xyz.gz"})
        EXPECT_FALSE(cli::isArrayPointFile(path)) << path;
    EXPECT_TRUE(cli::isArrayPointFile("a.b/c.NPZ"));
    for (const char* extension : {"xyz", "npy", "npz", "ply", "vtk", "bgeo"})
        EXPECT_THROW(cli::readArrayPoints("/nonexistent/a."s + extension), InputError);
}

// --------------------------------------------------------------------------------------------- disagreement

TEST_F(ArrayPoints, DifferenceIsFoundAndNamed)
{
    const auto difference = [](const Positions& engine, const Positions& own) {
        return cli::findDifference("a.xyz", ParticleView::fromArray(engine.data(), engine.size() / 3), own)
            .value_or("none");
    };
    EXPECT_EQ(difference({}, {}), "none");
    EXPECT_EQ(difference(kTwoPoints, kTwoPoints), "none");
    EXPECT_EQ(difference({NAN, 0, kInf}, {-NAN, 0, kInf}), "none");
    EXPECT_EQ(difference(kTwoPoints, {1, 2, 3, 4, 5, NAN}),
              "a.xyz: point 1 is (4, 5, 6) to the engine's reader and (4, 5, nan) to verify's own");
    EXPECT_EQ(difference({0.1, 0, 0}, {std::nextafter(0.1, 1), 0, 0}),
              "a.xyz: point 0 is (0.10000000000000001, 0, 0) to the engine's reader and "
              "(0.10000000000000002, 0, 0) to "
              "verify's own");
    EXPECT_EQ(difference({0, 0, 0}, {-0., 0, 0}),
              "a.xyz: point 0 is (0, 0, 0) to the engine's reader and (-0, 0, 0) to verify's own");
    EXPECT_EQ(difference(kTwoPoints, {1, 2, 3}),
              "a.xyz: has 2 points to the engine's reader and 1 to verify's own");
}

TEST_F(ArrayPoints, DifferenceOfValuesIsFoundAndNamed)
{
    using Values = std::vector<double>;
    const auto difference = [](const Values& engine, const Values& own) {
        return cli::findDifference("r.npy", engine, own).value_or("none");
    };
    EXPECT_EQ(difference({1, NAN}, {1, NAN}), "none");
    EXPECT_EQ(difference({1, 0}, {1, -0.}),
              "r.npy: the value of point 1 is 0 to the engine's reader and -0 to verify's own");
    EXPECT_EQ(difference({1, 2}, {1}), "r.npy: has 2 values to the engine's reader and 1 to verify's own");
}

TEST_F(ArrayPoints, PropertiesOfAPly)
{
    const std::string header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                               "property float z\nproperty uchar n\nproperty float r\n"
                               "property list uchar int near\nend_header\n";
    const std::string path = file("ply", header + "1 2 3 7 0.1 0\n4 5 6 8 nan 1 9\n");
    EXPECT_EQ(cli::readPlyScalars(path, "n"), (std::vector<double>{7, 8}));
    EXPECT_EQ(cli::readPlyScalars(path, "r")[0], double(0.1F));
    for (const char* const name : {"near", "q", ""})
        EXPECT_THROW(cli::readPlyScalars(path, name), InputError);
}

// As the engine's reader once read a lone CR: the first point only.
TEST_F(ArrayPoints, TwoFilesDiffer)
{
    const PointFile engine = PointFile::read(file("xyz", "1 2 3\n"));
    const Positions own = read("pts", "1 2 3\r4 5 6\r");
    EXPECT_TRUE(cli::findDifference("a.xyz", engine.view(), own));
}

} // namespace vdb_nns::testing
