// The reader of classic .bgeo files, byte by byte.
#include "support/array_file.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <random>

#include <zlib.h>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

ReadArray readBgeo(const std::string& file)
{
    return readAs("a.bgeo", bytesOf(file), parseBgeo);
}

template <typename Number>
std::string big(const std::vector<Number>& values)
{
    return rawValues<Number>(values, true);
}

std::string name(const std::string& text)
{
    return big<std::uint16_t>({static_cast<std::uint16_t>(text.size())}) + text;
}

std::string attribute(const std::string& text, std::uint16_t size, std::int32_t type)
{
    return name(text) + big<std::uint16_t>({size}) + big<std::int32_t>({type}) +
           (type == 4 ? big<std::int32_t>({2}) + name("first") + name("")
                      : big<std::int32_t>(std::vector<std::int32_t>(size)));
}

// The counts behind the points' are of primitives, point groups, primitive groups, attributes of points, of
// vertices, of primitives and of the whole.
std::string head(std::int32_t points, std::int32_t attributes, std::int32_t primitives = 0,
                 std::int32_t version = 5)
{
    return "BgeoV" + big<std::int32_t>({version, points, primitives, 0, 0, attributes, 0, 0, 0});
}

std::string gzipped(const std::string& text)
{
    z_stream stream{};
    EXPECT_EQ(deflateInit2(&stream, 6, Z_DEFLATED, MAX_WBITS + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
    std::string out(deflateBound(&stream, text.size()) + 64, '\0');
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
    stream.avail_in = static_cast<uInt>(text.size());
    stream.next_out = reinterpret_cast<Bytef*>(&out[0]);
    stream.avail_out = static_cast<uInt>(out.size());
    EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
    out.resize(stream.total_out);
    deflateEnd(&stream);
    return out;
}

const std::string kEnd("\0\xff", 2);

TEST(BgeoReader, readsPoints)
{
    const std::vector<float> expected{1, 2, 3, 4, 5, 0.1f};
    const std::string plain = head(2, 0) + big<float>({1, 2, 3, 1, 4, 5, 0.1f, 1});
    for (const std::string& end : {std::string(), kEnd, std::string("\0abc\xff", 5)}) {
        const ReadArray read = readBgeo(plain + end);
        EXPECT_EQ(read.positions.floats, expected);
        EXPECT_EQ(read.taken, "");
        EXPECT_TRUE(read.notes.empty());
    }
    EXPECT_EQ(readBgeo(head(0, 0) + kEnd).positions.size(), 0u);

    // Attributes of every type that is read; what stands behind the points is not looked at if it is
    // declared.
    const std::string attributes = attribute("id", 1, 1) + attribute("mass", 1, 0) + attribute("v", 3, 5) +
                                   attribute("name", 1, 4) + attribute("uv", 2, 0) + attribute("", 0, 1);
    const std::string rows =
        big<float>({1, 2, 3, 1}) + std::string(32, 'a') + big<float>({4, 5, 0.1f, 1}) + std::string(32, 'b');
    EXPECT_EQ(readBgeo(head(2, 6) + attributes + rows + kEnd).positions.floats, expected);
    EXPECT_EQ(readBgeo(head(2, 6, 1) + attributes + rows + "a primitive").positions.floats, expected);
}

TEST(BgeoReader, readsGzip)
{
    const std::string plain = head(2, 0) + big<float>({1, 2, 3, 1, 4, 5, 6, 1}) + kEnd;
    const std::vector<float> expected{1, 2, 3, 4, 5, 6};
    const std::string packed = gzipped(plain);
    EXPECT_EQ(readBgeo(packed).positions.floats, expected);
    EXPECT_EQ(readBgeo(gzipped(plain.substr(0, 50)) + gzipped(plain.substr(50))).positions.floats, expected);
    for (std::size_t kept = 2; kept < packed.size(); ++kept)
        EXPECT_ERROR(readBgeo(packed.substr(0, kept)), "gzip file is damaged or truncated");
    EXPECT_ERROR(readBgeo(packed + "x"), "gzip file is damaged");
    std::string wrong = packed;
    wrong[wrong.size() - 6] ^= 1; // of the checksum
    EXPECT_ERROR(readBgeo(wrong), "gzip file is damaged");
    EXPECT_ERROR(readBgeo(gzipped(plain.substr(0, 60))), "only 19 bytes follow");

    const std::string large = head(100000, 0) + std::string(1600000, '\0') + kEnd;
    EXPECT_EQ(readBgeo(gzipped(large)).positions.size(), 100000u);
    EXPECT_THROW(readAs("a.bgeo", bytesOf(gzipped(large)), parseBgeo, {}, 1000000), CapacityError);
}

TEST(BgeoReader, saysWhatWeightsAre)
{
    const ReadArray read = readBgeo(head(2, 0) + big<float>({1, 2, 3, 2, 4, 5, 6, 1}) + kEnd);
    EXPECT_EQ(read.positions.floats, (std::vector<float>{1, 2, 3, 4, 5, 6})); // not divided, as in Partio
    ASSERT_EQ(read.notes.size(), 1u);
    EXPECT_NE(read.notes[0].find("1 points have a weight w that is not 1"), std::string::npos);
}

TEST(BgeoReader, refusesOtherFiles)
{
    EXPECT_ERROR(readBgeo(""), "not a classic .bgeo file");
    EXPECT_ERROR(readBgeo("PGEOMETRY V5"), "with gzip, but with 'PGEOM'");
    EXPECT_ERROR(readBgeo("\x7fNSJb and more"), "Houdini 12 and later (binary JSON)");
    EXPECT_ERROR(readBgeo("\x7fNSJb and more"), ".bhclassic");
    EXPECT_ERROR(readBgeo("scf1 and more"), "compressed with Blosc (.bgeo.sc)");
    EXPECT_ERROR(readBgeo(head(0, 0, 0, 4)), "version 4 is not 5");
    EXPECT_ERROR(readBgeo(head(1, 1) + attribute("label", 4, 2) + std::string(32, '\0')),
                 "at byte 41: attribute 'label' has type 2 (string)");
    EXPECT_ERROR(readBgeo(head(1, 1) + attribute("odd", 4, 9) + std::string(32, '\0')), "has type 9");
    const std::string file = head(1, 0) + big<float>({1, 2, 3, 1}) + kEnd;
    EXPECT_THROW(readAs("a.bgeo", bytesOf(file), parseBgeo, {}, 11), CapacityError);
}

TEST(BgeoReader, refusesLies)
{
    const std::string row = big<float>({1, 2, 3, 1});
    EXPECT_ERROR(readBgeo(head(2, 0) + row), "promises 2 points of 16 bytes, but only 16 bytes follow");
    EXPECT_ERROR(readBgeo(head(2147483647, 0) + row), "promises 2147483647");
    EXPECT_ERROR(readBgeo(head(-1, 0) + row), "the number of points is -1");
    EXPECT_ERROR(readBgeo(head(1, -1) + row), "attributes of points is -1");
    EXPECT_ERROR(readBgeo(head(1, 2147483647) + row), "truncated");
    EXPECT_ERROR(readBgeo(head(1, 0) + row + row), "16 bytes are left over behind the last point");
    EXPECT_ERROR(readBgeo(head(1, 0) + row + "\n"), "1 bytes are left over");
    EXPECT_ERROR(readBgeo(head(1, 1) + attribute("v", 65535, 5).substr(0, 100)), "truncated");
    EXPECT_ERROR(readBgeo(head(1, 1) + name("s") + big<std::uint16_t>({1}) + big<std::int32_t>({4, -2})),
                 "strings is -2");
    const std::string whole = head(1, 1) + attribute("name", 1, 4) + row + std::string(4, '\0');
    for (std::size_t kept = 0; kept < whole.size(); ++kept)
        EXPECT_NE(errorOf([&] { readBgeo(whole.substr(0, kept)); }), "");
}

// Random files, as they were made.
TEST(BgeoReader, readsAnyValidFile)
{
    for (unsigned seed = 0; seed < 2000; ++seed) {
        std::mt19937 random(seed);
        const auto below = [&](unsigned limit) { return static_cast<int>(random() % limit); };
        const int points = below(30), attributes = below(5);
        std::string file = head(points, attributes);
        std::size_t others = 0; // bytes
        for (int i = 0; i < attributes; ++i) {
            constexpr int kTypes[] = {0, 1, 4, 5};
            const int size = below(4);
            file += attribute(std::string(static_cast<std::size_t>(below(9)), 'n'),
                              static_cast<std::uint16_t>(size), kTypes[below(4)]);
            others += 4 * static_cast<std::size_t>(size);
        }
        std::vector<float> expected;
        for (int i = 0; i < points; ++i) {
            for (int k = 0; k < 3; ++k) expected.push_back(static_cast<float>(random()) * 1e-6f - 2000);
            file += big<float>(
                {expected[expected.size() - 3], expected[expected.size() - 2], expected.back(), 1});
            for (std::size_t k = 0; k < others; ++k) file += static_cast<char>(random());
        }
        file += kEnd;
        ASSERT_EQ(readBgeo(below(2) ? file : gzipped(file)).positions.floats, expected) << "seed " << seed;
    }
}

} // namespace
} // namespace vdb_nns
