// The reader of text: what is read, and what other text gets.
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

std::vector<double> parsedXyz(const std::string& text)
{
    return readAs("a.xyz", bytesOf(text), parseText).positions.doubles;
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
    EXPECT_EQ(readAs("a.xyz", bytesOf(text), parseText, {}, 48).positions.size(), 1u); // 3 doubles, twice
    EXPECT_THROW(readAs("a.xyz", bytesOf(text), parseText, {}, 47), CapacityError);
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

} // namespace
} // namespace vdb_nns
