// The machine that a program with the emulated device layer finds itself on: VDB_NNS_EMULATED_DEVICES says how much memory each
// of its devices has, in MiB with commas between; VDB_NNS_EMULATED_SEED draws the order of what has none.
#include "cuda/launch.h"

#include <cuda_runtime_api.h>

#include <cstdlib>
#include <sstream>
#include <string>

namespace vdb_nns::cuda {

const char* buildDescription()
{
    return "emulated";
}

namespace {

const bool kIsReady = [] {
    const char* const sizes = std::getenv("VDB_NNS_EMULATED_DEVICES");
    const char* const seed = std::getenv("VDB_NNS_EMULATED_SEED");
    std::vector<std::size_t> bytes;
    std::istringstream list(sizes ? sizes : "1024");
    for (std::string size; std::getline(list, size, ',');) {
        bytes.push_back(std::size_t(std::strtoull(size.c_str(), nullptr, 10)) << 20);
    }
    simt::resetMachine(bytes, seed ? std::strtoull(seed, nullptr, 10) : 1);
    return true;
}();

} // namespace

} // namespace vdb_nns::cuda
