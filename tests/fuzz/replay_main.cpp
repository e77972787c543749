// Runs a fuzz target without libFuzzer: over seeds of its format, all their prefixes, and mutations of them
// from a fixed random sequence, for some seconds. A crash, a sanitizer's report or any exception but
// InputError ends it. Of a binary format the seeds are the files of a folder, without their prefixes.
//
//   replay npy|npz|ply|text|vtk|bgeo|FOLDER [SECONDS [FIRST_SEED]]
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include <zlib.h>

extern "C" int LLVMFuzzerTestOneInput(const unsigned char* data, std::size_t size);

namespace {

// SplitMix64 (Steele, Lea, Flood 2014): the same mutations on every machine.
class Random {
public:
    explicit Random(std::uint64_t seed) : mState(seed) {}

    std::uint64_t below(std::uint64_t limit)
    {
        std::uint64_t z = mState += 0x9E3779B97F4A7C15u;
        z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
        z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
        return (z ^ (z >> 31)) % limit;
    }

private:
    std::uint64_t mState;
};

std::string npySeed(const std::string& descr, const std::string& shape, std::size_t valueBytes)
{
    const std::string text = "{'descr': '" + descr + "', 'fortran_order': False, 'shape': " + shape + ", }\n";
    return std::string("\x93NUMPY\x01\x00", 8) + static_cast<char>(text.size()) + '\0' + text +
           std::string(valueBytes, '\x3f');
}

std::string littleEndian(std::uint64_t value, int bytes)
{
    std::string text;
    for (int i = 0; i < bytes; ++i) text += static_cast<char>(i < 8 ? value >> (8 * i) : 0);
    return text;
}

// A ZIP with stored members.
std::string npzSeed(const std::vector<std::string>& contents)
{
    std::string locals, entries;
    for (std::size_t i = 0; i < contents.size(); ++i) {
        const std::string& content = contents[i];
        const std::string name = std::string(1, static_cast<char>('a' + i)) + ".npy";
        const auto crc =
            crc32(0, reinterpret_cast<const Bytef*>(content.data()), static_cast<uInt>(content.size()));
        const std::string common = littleEndian(20, 2) + littleEndian(0, 4 + 4) + littleEndian(crc, 4) +
                                   littleEndian(content.size(), 4) + littleEndian(content.size(), 4) +
                                   littleEndian(name.size(), 2) + littleEndian(0, 2);
        entries += "PK\1\2" + littleEndian(20, 2) + common + littleEndian(0, 10) +
                   littleEndian(locals.size(), 4) + name;
        locals += "PK\3\4" + common + name + content;
    }
    return locals + entries + "PK\5\6" + littleEndian(0, 4) + littleEndian(contents.size(), 2) +
           littleEndian(contents.size(), 2) + littleEndian(entries.size(), 4) +
           littleEndian(locals.size(), 4) + littleEndian(0, 2);
}

std::vector<std::string> seedsOf(const std::string& format)
{
    if (format == "npz") {
        return {npzSeed({npySeed("<f4", "(2, 3)", 24)}), npzSeed({npySeed(">i8", "(1, 4)", 32)}),
                npzSeed({"no array"}),
                npzSeed({npySeed("<f4", "(2, 3)", 24), npySeed("|b1", "(2,)", 2),
                         npySeed("<u8", "(2, 1)", 16), npySeed("<f2", "(2, 3, 3)", 36)})};
    }
    if (format == "npy") {
        return {npySeed("<f4", "(2, 3)", 24), npySeed("<f8", "(2, 3)", 48), npySeed("<f4", "(0, 3)", 0),
                npySeed("<f4", "(18446744073709551615, 3)", 24), npySeed(">f4", "(2, 3)", 24)};
    }
    if (format == "ply") {
        const std::string elements =
            " 1.0\ncomment c\nelement vertex 2\nproperty float x\nproperty double y\n"
            "property float z\nproperty list uchar int l\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\n";
        const std::string rows = std::string(16, '\x3f') + '\1' + "abcd" + std::string(16, '\0') + '\0' +
                                 '\3' + std::string(12, 'i');
        return {"ply\nformat ascii" + elements + "1 2 3 1 7\n4e5 -6 nan 0\n3 0 1 2\n",
                "ply\nformat binary_little_endian" + elements + rows,
                "ply\nformat binary_big_endian" + elements + rows,
                "ply\r\nformat ascii 1.0\r\nelement vertex 1\r\nproperty float x\r\nproperty float y\r\n"
                "property float z\r\nend_header\r\n1 2 3\r\n",
                "ply\rcomment c\rformat ascii 1.0\relement a 1\rproperty list char int l\relement vertex 1\r"
                "property float x\rproperty uint y\rproperty short z\rend_header\r1 7\r1.#QNAN 2 -3\r",
                "ply\nformat binary_big_endian 1.0\nelement vertex 2\nproperty uchar x\nproperty short y\n"
                "property double z\nelement edge 2\nproperty int a\nend_header\n" +
                    std::string(30, '\x3f')};
    }
    if (format == "vtk") {
        const std::string head = "# vtk DataFile Version 4.2\ntitle\n";
        const std::string cells = "\nMETADATA\nINFORMATION 0\n\nVERTICES 1 2\n";
        return {head + "ASCII\nDATASET POLYDATA\nPOINTS 2 float\n1 2 3 4 5e3 nan" + cells + "1 0\n",
                head + "BINARY\nDATASET UNSTRUCTURED_GRID\nFIELD FieldData 2\nTIME 1 1 double\n" +
                    std::string(8, '\0') + "\nMETADATA\nINFORMATION 0\n\ns 1 2 string\n\xC3" +
                    "abc\xC0\nPOINTS 2 float\n" + std::string(24, '\x3f') + cells,
                head + "BINARY\nDATASET POLYDATA\nVERTICES 2 1\nOFFSETS vtktypeint64\n" +
                    std::string(16, '\0') + "\nCONNECTIVITY vtktypeint64\n" + std::string(8, '\0') +
                    "\nPOINTS 1 long\n" + std::string(12, '\0'),
                head + "ASCII\nDATASET STRUCTURED_GRID\nDIMENSIONS 1 1 1\nPOINTS 1 vtktypeuint64\n1 2 3\n"};
    }
    if (format == "bgeo") {
        const auto big = [](int value) {
            std::string bytes;
            for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift);
            return bytes;
        };
        const auto head = [&](int points, int attributes) {
            return "BgeoV" + big(5) + big(points) + big(0) + big(0) + big(0) + big(attributes) + big(0) +
                   big(0) + big(0);
        };
        const std::string id = std::string("\0\2id\0\1", 6) + big(1) + big(0);
        const std::string name = std::string("\0\1s\0\1", 5) + big(4) + big(1) + std::string("\0\2ab", 4);
        // A gzip file, to be mutated.
        const std::string packed("\x1f\x8b\x08\0\0\0\0\0\2\xff\xab\0\x83\x16\xdc\x8c\1\0\0\0", 20);
        return {head(2, 0) + std::string(32, '\x3f') + std::string("\0\xff", 2),
                head(1, 2) + id + name + std::string(24, '\x3f'), packed, "\x7fNSJb", "scf1"};
    }
    return {"\xEF\xBB\xBFid;x;y;z\r1;2;3;4\r5;6;7;8\r",
            "//X Y Z I\n2\n1,2,3,4\n5,6,7,8\n",
            "2\nProperties=species:S:1:pos:R:3\nH 1 2 3\n8 4 5 1.#QNAN\n1\n\nO 0 0 0\n",
            "1 2 3\n4 5 6\n",
            "# c\r\n 0.1\t+2 -3e400 x y\r\n\r\nnan inf -inf\n",
            "3\nH 1 2 3\n",
            "1 2\n",
            "1e-400 2 3"};
}

std::vector<std::string> filesOf(const std::string& folder)
{
    std::vector<std::filesystem::path> paths;
    for (const auto& entry : std::filesystem::directory_iterator(folder)) paths.push_back(entry.path());
    std::sort(paths.begin(), paths.end());
    std::vector<std::string> files;
    for (const std::filesystem::path& path : paths) {
        std::ifstream in(path, std::ios::binary);
        files.emplace_back(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
    }
    return files;
}

std::string mutated(std::string text, const std::vector<std::string>& seeds, Random& random)
{
    static const char* const kTokens[] = {"0",       "-1",           "4294967295", "18446744073709551616",
                                          "1e999",   "nan",          "list",       "property",
                                          "element", "\n",           " ",          "(",
                                          "'",       "end_header\n", "{",          "\xff\xff\xff\xff"};
    for (std::uint64_t edits = 1 + random.below(6); edits > 0; --edits) {
        const std::size_t place = random.below(text.size() + 1);
        switch (random.below(5)) {
        case 0:
            text.insert(place, kTokens[random.below(sizeof kTokens / sizeof *kTokens)]);
            break;
        case 1:
            text.erase(place, 1 + random.below(8));
            break;
        case 2:
            if (place < text.size()) text[place] = static_cast<char>(random.below(256));
            break;
        case 3:
            if (place < text.size()) text[place] = static_cast<char>(text[place] ^ (1 << random.below(8)));
            break;
        default: {
            const std::string& other = seeds[random.below(seeds.size())];
            text = text.substr(0, place) + other.substr(random.below(other.size() + 1));
        }
        }
    }
    return text;
}

void run(const std::string& input)
{
    // A copy of exactly that size, so that a read past the end is seen.
    const std::vector<unsigned char> bytes(input.begin(), input.end());
    LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
}

} // namespace

int main(int argc, char** argv)
{
    if (argc < 2) {
        std::fprintf(stderr, "usage: replay npy|npz|ply|text|vtk|bgeo|FOLDER [SECONDS [FIRST_SEED]]\n");
        return 2;
    }
    const bool isFolder = std::filesystem::is_directory(argv[1]);
    const std::vector<std::string> seeds = isFolder ? filesOf(argv[1]) : seedsOf(argv[1]);
    if (seeds.empty()) {
        std::fprintf(stderr, "replay: no files in %s\n", argv[1]);
        return 2;
    }
    const double seconds = argc > 2 ? std::atof(argv[2]) : 3;
    std::uint64_t number = argc > 3 ? std::strtoull(argv[3], nullptr, 10) : 1;
    for (const std::string& seed : seeds) {
        for (std::size_t kept = isFolder ? seed.size() : 0; kept <= seed.size(); ++kept)
            run(seed.substr(0, kept));
    }
    const auto start = std::chrono::steady_clock::now();
    std::uint64_t runs = 0;
    for (; std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() < seconds;
         ++runs) {
        Random random(number++);
        run(mutated(seeds[random.below(seeds.size())], seeds, random));
    }
    std::printf("%s: %llu mutations, the last one of seed %llu\n", argv[1],
                static_cast<unsigned long long>(runs), static_cast<unsigned long long>(number - 1));
    return 0;
}
