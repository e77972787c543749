// Writes the seeds of fuzz_vdb: small files of every kind. Usage: make_vdb_seeds FOLDER
#include "support/vdb_cases.h"

#include <cstdint>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>

namespace {

// What is larger has long runs of zeros, and slows the fuzzer down.
constexpr std::size_t kMostBytes = 64000;

void write(const std::filesystem::path& path, const std::string& bytes)
{
    if (bytes.size() > kMostBytes) return;
    std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

} // namespace

int main(int argc, char** argv)
{
    if (argc != 2) {
        std::cerr << "usage: make_vdb_seeds FOLDER\n";
        return 2;
    }
    try {
        const std::filesystem::path folder = argv[1];
        std::filesystem::create_directories(folder);
        for (const std::string& name : vdb_nns::testing::smallVdbCaseNames())
            write(folder / name, vdb_nns::testing::makeVdbCase(name));
        for (std::uint32_t seed = 0; seed < 60; ++seed)
            write(folder / ("random_" + std::to_string(seed)), vdb_nns::testing::makeRandomVdb(seed));
    } catch (const std::exception& e) {
        std::cerr << "make_vdb_seeds: " << e.what() << "\n";
        return 1;
    }
    return 0;
}
