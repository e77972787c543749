// .vdb files of every kind that OpenVDB writes, made by it in memory. Shows nothing of OpenVDB.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns::testing {

// The named kinds. Those of large files are left out where only small ones are wanted (seeds of a fuzzer).
std::vector<std::string> vdbCaseNames();
std::vector<std::string> smallVdbCaseNames();

// The bytes of the file of that kind.
std::string makeVdbCase(const std::string& name);

// A file of some grids whose kinds, sizes, attributes and compression are drawn from the seed.
std::string makeRandomVdb(std::uint32_t seed);

// A stream of a grid and so many instances of it.
std::string makeManyInstances(std::uint32_t instances);

// A file of a few KB whose leaves have so many points each, all with one value of P.
std::string makeUniformVdb(std::uint32_t leaves, std::uint32_t pointsPerLeaf);

// So many points, or a few more or fewer, spread over many leaves.
std::string makeScatteredVdb(std::uint32_t points);

} // namespace vdb_nns::testing
