// The .npy reader, byte by byte: what is read, and what every lie of a header gets.
#include "support/array_file.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>

namespace vdb_nns {
namespace {

using testing::bytesOf;
using testing::errorOf;
using testing::rawValues;
using testing::readAs;

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
    NpyLayout layout;
    ReadArray result;
    EXPECT_TRUE(readAs("a.npy", bytesOf(file),
                       [&](const ArrayFile& array) { return parseNpy(array, layout, result); }));
    return layout;
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

// What is read of a file that is not used in place.
ReadArray convertedNpy(const std::string& file, const ArrayChoice& choice = {})
{
    NpyLayout layout;
    ReadArray result;
    EXPECT_FALSE(readAs(
        "a.npy", bytesOf(file), [&](const ArrayFile& array) { return parseNpy(array, layout, result); },
        choice));
    return result;
}

template <typename Number>
void expectConverted(char kind)
{
    const std::vector<Number> values = {Number(1), Number(2), Number(3), Number(100), Number(0), Number(-1)};
    const std::vector<double> expected(values.begin(), values.end());
    for (const bool isBigEndian : {false, true}) {
        const std::string descr =
            (isBigEndian ? ">" : "<") + std::string(1, kind) + std::to_string(sizeof(Number));
        if (kind == 'f' && !isBigEndian) continue; // in place
        const ReadArray read =
            convertedNpy(npy(npyDictionary(descr, "(2, 3)"), rawValues(values, isBigEndian)));
        std::vector<double> found = read.positions.doubles;
        if (descr == ">f4") found.assign(read.positions.floats.begin(), read.positions.floats.end());
        EXPECT_EQ(found, expected) << descr;
    }
}

TEST(NpyReader, convertsNumbersExactly)
{
    expectConverted<std::int8_t>('i');
    expectConverted<std::int16_t>('i');
    expectConverted<std::int32_t>('i');
    expectConverted<std::int64_t>('i');
    expectConverted<std::uint8_t>('u');
    expectConverted<std::uint16_t>('u');
    expectConverted<std::uint32_t>('u');
    expectConverted<float>('f');
    expectConverted<double>('f');
    const std::vector<std::uint16_t> halves = {0x3C00, 0xC000, 0x0001, 0x7BFF, 0xFC00, 0x8000};
    const std::vector<float> floats = {1, -2, 0x1p-24f, 65504, -HUGE_VALF, -0.0f};
    EXPECT_EQ(convertedNpy(npy(npyDictionary("<f2", "(2, 3)"), rawValues(halves))).positions.floats, floats);
    EXPECT_EQ(convertedNpy(npy(npyDictionary(">f2", "(2, 3)"), rawValues(halves, true))).positions.floats,
              floats);

    const std::int64_t limit = std::int64_t(1) << 53;
    const std::vector<std::int64_t> most = {limit, -limit, 0};
    EXPECT_EQ(convertedNpy(npy(npyDictionary("<i8", "(1, 3)"), rawValues(most))).positions.doubles,
              (std::vector<double>{0x1p53, -0x1p53, 0}));
    std::vector<std::int64_t> many(3 * 200000, 1);
    many[3 * 150000 + 1] = -limit - 1;
    many[3 * 199999] = limit + 2;
    EXPECT_ERROR(convertedNpy(npy(npyDictionary("<i8", "(200000, 3)"), rawValues(many))), "point 150000 has");
    EXPECT_ERROR(convertedNpy(npy(npyDictionary("<u8", "(1, 3)"), std::string(24, '\xff'))), "2^53");
}

TEST(NpyReader, takesAnyOrder)
{
    const std::string values = rawValues<float>({1, 4, 2, 5, 3, 6});
    const std::vector<float> rows = {1, 2, 3, 4, 5, 6};
    const std::string fortran = "{'descr': '<f4', 'fortran_order': True, 'shape': (2, 3), }";
    EXPECT_EQ(convertedNpy(npy(fortran, values)).positions.floats, rows);
    EXPECT_EQ(convertedNpy(npy(fortran, values), {{2, 0, 1}, {}}).positions.floats,
              (std::vector<float>{3, 1, 2, 6, 4, 5}));
    const ReadArray wide = convertedNpy(
        npy(npyDictionary("<f4", "(2, 4)"), rawValues<float>({9, 1, 2, 3, 9, 4, 5, 6})), {{1, 2, 3}, {}});
    EXPECT_EQ(wide.positions.floats, rows);
    EXPECT_EQ(wide.taken, "columns 1, 2 and 3 of 4");
}

TEST(NpyReader, readsRecords)
{
    const std::string descr =
        "[('id', '<i4'), ('x', '<f4'), ('y', '>f4'), (('depth', 'z'), '<f4'), ('v', '<f4', (3,))]";
    const auto dictionary = [&](const std::string& fields, const std::string& shape) {
        return "{'descr': " + fields + ", 'fortran_order': False, 'shape': " + shape + ", }\n";
    };
    std::string values;
    for (int i = 0; i < 2; ++i) {
        const auto f = static_cast<float>(3 * i);
        values += rawValues<std::int32_t>({7}) + rawValues<float>({f + 1}) + rawValues<float>({f + 2}, true) +
                  rawValues<float>({f + 3, 8, 8, 8});
    }
    const ReadArray read = convertedNpy(npy(dictionary(descr, "(2,)"), values));
    EXPECT_EQ(read.positions.floats, (std::vector<float>{1, 2, 3, 4, 5, 6}));
    EXPECT_EQ(read.taken, "fields 'x', 'y' and 'z' of 5");
    EXPECT_EQ(convertedNpy(npy(dictionary(descr, "(2,)"), values), {{0, 1, 2}, {}}).positions.doubles,
              (std::vector<double>{7, 1, 2, 7, 4, 5}));
    EXPECT_ERROR(parsedNpy(npy(dictionary(descr, "(1, 2)"), values)), "not (N,); save positions.ravel()");
    EXPECT_ERROR(parsedNpy(npy(dictionary("[('a', '<f4'), ('b', '<f4')]", "(1,)"), std::string(8, '\0'))),
                 "no field 'x', but 'a' and 'b'; say which");
    EXPECT_ERROR(parsedNpy(npy(dictionary("[('x', '|S4'), ('y', '<f4'), ('z', '<f4')]", "(1,)"),
                               std::string(12, ' '))),
                 "dtype '|S4'");
    EXPECT_ERROR(parsedNpy(npy(dictionary("[('x', [('a', '<f4')])]", "(1,)"), std::string(4, ' '))),
                 "inside");
    EXPECT_THROW(convertedNpy(npy(dictionary(descr, "(2,)"), values), {{0, 1, 5}, {}}), InvalidInput);
    EXPECT_EQ(
        parsedNpy(npy(dictionary("[('X', '<f4'), ('Y', '<f4'), ('Z', '<f4')]", "(1,)"), std::string(12, ' ')))
            .count,
        1u);
    // Two of these make a packed row, and are used in place.
    EXPECT_EQ(
        parsedNpy(npy(dictionary("[('x', '<f8'), ('y', '<f8'), ('z', '<f8')]", "(2,)"), std::string(48, ' ')))
            .count,
        2u);
}

TEST(NpyReader, saysWhatToSaveInstead)
{
    const std::string values(24, '\0');
    for (const char* descr : {"<c8", "f4", "", "|O", "<M8[ns]", "<f16", "|b1", "|S4"}) {
        EXPECT_ERROR(parsedNpy(npy(npyDictionary(descr, "(2, 3)"), values)),
                     "dtype '" + std::string(descr) + "' is not supported");
    }
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(6,)"), values)), "save positions.reshape(-1, 3)");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(3, 2)"), values)), "save positions.T");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(2, 2)"), values)), "need three coordinates");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "()"), values)), "shape () is not (N, 3)");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(1, 2, 3)"), values)),
                 "save one frame, positions[0], or");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(1, 6)"), values)), "positions[0].reshape(-1, 3)");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(2,)"), values)), "column_stack");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(3, 1, 2)"), values)), "three coordinates each");
    EXPECT_ERROR(parsedNpy(npy(npyDictionary("<f4", "(1, 6)"), values)),
                 "(--columns 0,1,2), or save positions[:, :3]");
    EXPECT_THROW(convertedNpy(npy(npyDictionary("<f4", "(1, 6)"), values), {{0, 1, 6}, {}}), InvalidInput);
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

TEST(NpyReader, readsOneValueAPoint)
{
    const auto read = [](const std::string& file, std::uint64_t count) {
        return readAs("r.npy", bytesOf(file),
                      [&](const ArrayFile& array) { return parseNpyValues(array, count); });
    };
    for (const bool isBig : {false, true}) {
        const std::string order = isBig ? ">" : "<";
        EXPECT_EQ(read(npy(npyDictionary(order + "f4", "(2,)"), rawValues<float>({0.1f, -3}, isBig)), 2),
                  (std::vector<double>{0.1f, -3}));
        EXPECT_EQ(
            read(npy(npyDictionary(order + "f8", "(3, 1)"), rawValues<double>({0.1, 1e300, 0}, isBig)), 3),
            (std::vector<double>{0.1, 1e300, 0}));
    }
    EXPECT_TRUE(read(npy(npyDictionary("<f8", "(0,)"), ""), 0).empty());
    const auto refused = [&](const std::string& descr, const std::string& shape, const std::string& values,
                             const std::string& what) {
        const std::string error = errorOf([&] { read(npy(npyDictionary(descr, shape), values), 2); });
        EXPECT_NE(error.find(what), std::string::npos) << error;
    };
    const std::string two = rawValues<double>({1, 2}), three = rawValues<double>({1, 2, 3});
    refused("<f8", "(3,)", three,
            "has 3 values, shape (3,); expected are 2 floats of 4 or 8 bytes, shape (2,)");
    refused("<f8", "(1, 2)", two, "has the shape (1, 2)");
    refused("<f8", "()", two, "has the shape ()");
    refused("<i8", "(2,)", two, "holds the dtype '<i8'; expected are 2 floats");
    refused("<f2", "(2,)", "abcd", "holds the dtype '<f2'");
    refused("<f8", "(2,)", two.substr(1), "truncated");
    refused("<f8", "(2,)", three, "8 bytes too many");
}

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
