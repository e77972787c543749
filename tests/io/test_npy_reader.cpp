// The .npy reader, byte by byte: what is read, and what every lie of a header gets.
#include "support/array_file.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <gtest/gtest.h>

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
