// The reader of text: what is read, and what other text gets.
#include "support/array_file.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <random>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

using Values = std::vector<double>;

ReadArray parsed(const std::string& text, const ArrayChoice& choice = {})
{
    return readAs("a.xyz", bytesOf(text), parseText, choice);
}

Values valuesOf(const std::string& text, const ArrayChoice& choice = {})
{
    return parsed(text, choice).positions.doubles;
}

TEST(TextReader, readsRows)
{
    EXPECT_EQ(valuesOf(""), Values{});
    EXPECT_EQ(valuesOf("# nothing\n\n   \r\n"), Values{});
    EXPECT_EQ(valuesOf("1 2 3"), (Values{1, 2, 3}));
    EXPECT_EQ(valuesOf("# points\r\n 0.1\t+2 -3e4 # and a comment\r\n\r\n4 5 6 #7\n"),
              (Values{0.1, 2, -3e4, 4, 5, 6}));
    EXPECT_EQ(valuesOf("1e-400 4.9e-324 1.7976931348623157e308"),
              (Values{0, 4.9e-324, std::numeric_limits<double>::max()}));
    EXPECT_EQ(valuesOf("12 13 14\n5 5 5\n").size(), 6u); // integers are fine
}

TEST(TextReader, readsWhatIsNotFinite)
{
    for (const char* name :
         {"nan", "NaN", "-nan", "nan(ind)", "1.#QNAN", "-1.#IND", "1.#SNAN", "1.#QNAN0", "-1.#IND00"}) {
        const Values values = valuesOf(std::string("1 ") + name + " 3");
        EXPECT_TRUE(std::isnan(values[1])) << name;
        EXPECT_EQ(values[2], 3) << name;
    }
    EXPECT_EQ(valuesOf("inf -inf 1.#INF000\n-1.#INF +inf infinity"),
              (Values{HUGE_VAL, -HUGE_VAL, HUGE_VAL, -HUGE_VAL, HUGE_VAL, HUGE_VAL}));
    for (const char* other : {"1.#", "1.#QNANx", "1.#1", "1.#INF1", "nanx", "infin", "1.5#INF"}) {
        EXPECT_ERROR(valuesOf(std::string("1 2 3\n1 2 ") + other), "which is not a number") << other;
    }
}

TEST(TextReader, takesAnyLineEndAndSeparator)
{
    const Values expected = {1, 2, 3, 4, 5, 6};
    for (const std::string separator : {" ", "\t", "  \t ", ",", ", ", " ;", ";"}) {
        for (const std::string end : {"\n", "\r\n", "\r", "\r\r\n", "\n\n"}) {
            const std::string text =
                "1" + separator + "2" + separator + "3" + end + "4" + separator + "5" + separator + "6";
            EXPECT_EQ(valuesOf(text), expected) << text;
            EXPECT_EQ(valuesOf(text + end), expected) << text;
            EXPECT_EQ(valuesOf("\xEF\xBB\xBF" + text + end), expected) << text;
        }
    }
    EXPECT_EQ(valuesOf("1,2,3,\n4,5,6,\n"), expected); // the last column is empty
    EXPECT_EQ(valuesOf("\"a,b\",1,2,3\n\"c\",4,5,6\n", {{1, 2, 3}, {}}), expected);
    EXPECT_ERROR(valuesOf("1,2,3\n4,,6\n"), "line 2 (byte 6) has nothing in column 1");
    EXPECT_ERROR(valuesOf("\xFF\xFE"
                          "1 2 3"),
                 "UTF-16");
}

TEST(TextReader, findsColumns)
{
    const Values expected = {1, 2, 3, 4, 5, 6};
    const ReadArray named = parsed("id,X,Z,y,name\n9,1,3,2,a\n8,4,6,5,b\n");
    EXPECT_EQ(named.positions.doubles, expected);
    EXPECT_EQ(named.taken, "columns 1, 3 and 2 of 5");
    EXPECT_TRUE(named.notes.empty());
    EXPECT_EQ(valuesOf("//X Y Z R\n2\n1 2 3 9\n4 5 6 9\n"), expected);
    EXPECT_EQ(valuesOf("\"x\";\"y\";\"z\"\n1;2;3\n4;5;6\n"), expected);
    EXPECT_EQ(valuesOf("1 , 2 , 3\n4 ,5 , 6\n"), expected);
    EXPECT_EQ(valuesOf("x y z\n"), Values{});
    EXPECT_ERROR(valuesOf("This is no table.\n"), "has no number, and no row follows: 'This is no table.'");
    EXPECT_EQ(valuesOf("# made by a test\n# mass x y z\n9 1 2 3\n9 4 5 6\n"), expected); // numpy.savetxt
    EXPECT_EQ(valuesOf("# z y\n1 2 3\n4 5 6\n"), expected);
    const ReadArray unnamed = parsed("lon lat height\n1 2 3\n4 5 6\n");
    EXPECT_EQ(unnamed.positions.doubles, expected);
    ASSERT_EQ(unnamed.notes.size(), 1u);
    EXPECT_NE(unnamed.notes[0].find("does not name x, y and z"), std::string::npos);
    EXPECT_EQ(valuesOf("a 1 2 3\nb 4 5 6\n", {{1, 2, 3}, {}}), expected);
    EXPECT_THROW(valuesOf("1 2 3\n", {{1, 2, 3}, {}}), InvalidInput);
    EXPECT_ERROR(valuesOf("a 1 2 3\n"), "'a' in column 0, which is not a number");
}

TEST(TextReader, warnsOfNumbersThatMayBeNoCoordinates)
{
    const auto warns = [](const std::string& text) { return !parsed(text).notes.empty(); };
    EXPECT_TRUE(warns("1 0.1 0.2 0.3\n2 0.4 0.5 0.6\n"));
    EXPECT_FALSE(warns("1 2 3 4\n2 4 5 6\n"));             // a lattice
    EXPECT_FALSE(warns("0.5 0.1 0.2 7\n1.5 0.4 0.5 8\n")); // real numbers
    EXPECT_FALSE(warns("1 0.1 0.2\n2 0.4 0.5\n"));         // no column more
    std::string elements, others;
    for (int i = 0; i < 30; ++i) {
        elements += std::to_string(i % 3 ? 1 : 8) + " 0.1 0.2 0." + std::to_string(i) + "\n";
        others += std::to_string(i * 37 % 30) + " 0.1 0.2 0.3\n";
    }
    EXPECT_TRUE(warns(elements));
    EXPECT_FALSE(warns(others));
}

TEST(TextReader, readsCounts)
{
    const Values expected = {1, 2, 3, 4, 5, 6};
    EXPECT_EQ(valuesOf("2\n1 2 3\n4 5 6\n"), expected);
    EXPECT_EQ(valuesOf("# about\n\n 2 # points\r\n1 2 3 7\r\n\r\n4 5 6 8\n"), expected);
    EXPECT_EQ(valuesOf("0\n"), Values{});
    EXPECT_ERROR(valuesOf("3\n1 2 3\n4 5 6\n"), "line 1 counts 3 points, and 2 rows follow");
    EXPECT_ERROR(valuesOf("1\n1 2 3\n4 5 6\n"), "line 1 counts 1 points, and 2 rows follow");
    EXPECT_ERROR(valuesOf("5"), "and no row follows");
    EXPECT_ERROR(valuesOf("99999999999\n1 2 3\n"), "more than the 4294967295");
}

TEST(TextReader, readsChemistry)
{
    const Values expected = {1, 2, 3, 4, 5, 6};
    const std::string rows = "H 1 2 3\nO 4 5 6\n";
    for (const char* comment : {"water", "", "# water", "-12.5 energy", "1 2 3", "2"})
        EXPECT_EQ(valuesOf("2\n" + std::string(comment) + "\n" + rows), expected) << comment;
    EXPECT_EQ(valuesOf("2\nwater\n1 1 2 3\n8 4 5 6\n"), expected); // atomic numbers
    EXPECT_EQ(valuesOf("2\nwater\n1 2 3\n4 5 6\n"), expected);     // no elements
    EXPECT_EQ(parsed("2\nwater\n" + rows).taken.substr(0, 23), "columns 1, 2 and 3 of 4");
    const ReadArray frames = parsed("2\nfirst\n" + rows + "\n1\nsecond\nH 7 7 7\n");
    EXPECT_EQ(frames.positions.doubles, expected);
    ASSERT_EQ(frames.notes.size(), 1u);
    EXPECT_NE(frames.notes[0].find("several frames"), std::string::npos);
    EXPECT_EQ(valuesOf("1\nLattice=\"9 0 0 0 9 0 0 0 9\" Properties=Z:I:1:pos:R:3\n8 1 2 3\n"),
              (Values{1, 2, 3}));
    EXPECT_EQ(valuesOf("2\nLattice=\"1 0 0\" Properties=species:S:1:forces:R:3:pos:R:3 pbc=\"T T T\"\n"
                       "H 9 9 9 1 2 3\nO 9 9 9 4 5 6\n"),
              expected);
    // Numbers in the comment, and any case.
    EXPECT_EQ(valuesOf("2\nLattice=\"1.0 0.0 0.0 0.5 0.5 0.0\" properties=Z:I:1:pos:R:3\n1 1 2 3\n8 4 5 6\n"),
              expected);
    EXPECT_EQ(valuesOf("2\nLattice=\"1.0 0.0 0.0 0.5 0.5 0.0\"\n1 1 2 3\n8 4 5 6\n"), expected);
    EXPECT_EQ(valuesOf("2\n\n1 1 2.5 3\n8 4 5 6\n"), (Values{1, 2.5, 3, 4, 5, 6}));
    EXPECT_EQ(valuesOf("2\n# water\n1 1 2.5 3\n8 4 5 6\n"), (Values{1, 2.5, 3, 4, 5, 6}));
    // Other columns than positions are none.
    for (const char* properties :
         {"species:S:1:frc:R:3", "species:S:1:pos:R:2", "species:S:1:velo:R:3:Q:R:3"})
        EXPECT_ERROR(valuesOf("2\nProperties=" + std::string(properties) + "\n" + rows), "which names no pos")
            << properties;
    EXPECT_ERROR(valuesOf("2\nProperties=species:S:1:pos:R:3:q:R:1\n" + rows),
                 "which are 5 columns, and has 4");
    EXPECT_ERROR(valuesOf("2\nProperties=species:S:1:mass\n" + rows), "no list of name:type:columns");
    EXPECT_EQ(valuesOf("2\nProperties=species:S:1:frc:R:3\n" + rows, {{1, 2, 3}, {}}), expected);
    EXPECT_ERROR(valuesOf("3\nwater\n" + rows), "line 1 counts 3 points, and 2 rows follow");
    EXPECT_ERROR(valuesOf("1\nwater\n" + rows),
                 "line 4 (byte 16) follows the 1 rows that line 1 counts: 'O 4 5 6'");
    EXPECT_ERROR(valuesOf("2\nwater\nH 1 2 3\nO 4 5\n"),
                 "line 4 (byte 16) has 3 columns, and the first row has 4");
}

TEST(TextReader, keepsTheOrderOverManyChunks)
{
    for (const char* const end : {"\n", "\r", "\r\n"}) {
        std::string text;
        constexpr int kRows = 300000; // several chunks
        for (int i = 0; i < kRows; ++i)
            text += std::to_string(i) + " " + std::to_string(i * 2) + " 0.5" + end;
        const Values values = valuesOf(text);
        ASSERT_EQ(values.size(), 3u * kRows);
        for (std::size_t i = 0; i < kRows; ++i) {
            ASSERT_EQ(values[3 * i], static_cast<double>(i));
            ASSERT_EQ(values[3 * i + 1], static_cast<double>(2 * i));
        }
        const std::size_t bytes = text.size();
        text += std::string("1 2") + end + "3 4" + end;
        EXPECT_ERROR(valuesOf(text), "line 300001 (byte " + std::to_string(bytes) + ") has 2 columns");
    }
}

// As printf has them, with 1 to 17 digits.
TEST(TextReader, takesTheNearestDouble)
{
    std::mt19937_64 random(11);
    std::string text;
    Values expected;
    for (int i = 0; i < 30000; ++i) {
        const std::uint64_t bits = random() & ~(std::uint64_t(1) << 62); // exponents below 1
        double value;
        std::memcpy(&value, &bits, sizeof value);
        if (!std::isfinite(value)) value = 0;
        char number[64];
        std::snprintf(number, sizeof number, i % 2 ? "%.*g" : "%+.*e", static_cast<int>(1 + random() % 17),
                      value);
        expected.push_back(std::strtod(number, nullptr));
        text += number + std::string(i % 3 == 2 ? "\n" : " ");
    }
    EXPECT_EQ(valuesOf(text), expected);
}

TEST(TextReader, takesMemoryForPointsOnly)
{
    std::string text = "1 2 3\n";
    for (int i = 0; i < 10000; ++i) text += i % 2 ? "#\n" : "\n";
    EXPECT_EQ(readAs("a.xyz", bytesOf(text), parseText, {}, 24).positions.size(), 1u); // 3 doubles
    EXPECT_THROW(readAs("a.xyz", bytesOf(text), parseText, {}, 23), CapacityError);
}

TEST(TextReader, refusesOtherText)
{
    EXPECT_ERROR(valuesOf("1 2 3\n7\n"), "line 2 (byte 6) has 1 columns, and the first row has 3: '7'");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 3 4\n"), "has 4 columns, and the first row has 3");
    EXPECT_ERROR(valuesOf("1 2 # 3\n"), "fewer than three columns");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 3e\n"), "'3e' in column 2, which is not a number");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 6#7\n"), "'6#7'");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 0x1p3\n"), "not a number");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 1.0D+00\n"), "not a number");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 +-3\n"), "not a number");
    EXPECT_ERROR(valuesOf("1 2 1e309\n"), "range of double");
    EXPECT_ERROR(valuesOf(std::string("1 2 3\n1 2 \0\n", 12)), "'\\x00' in column 2");
    EXPECT_ERROR(valuesOf("1 2 3\n1 2 \x1b[31m\n"), "'\\x1B[31m'");
}

} // namespace
} // namespace vdb_nns
